"""The events of a season as an Atom feed (RFC 4287): announcements, acts, and attempts that are over."""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import sha256
from typing import Final
from xml.etree import ElementTree

from experiment_runner.competition.board.forms import line_of, number
from experiment_runner.competition.season.board import SeasonBoard
from glue.console import one_line

_MOST: Final = 50
_NAMESPACE: Final = "http://www.w3.org/2005/Atom"
_NOT_IN_XML: Final = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def feed_of(board: SeasonBoard) -> bytes:
    """Return the newest entries of a board as a feed."""
    entries = sorted(_entries(board), reverse=True)[:_MOST]
    feed = ElementTree.Element("feed", xmlns=_NAMESPACE)
    _add(feed, "id", _id(board.competition))
    _add(feed, "title", board.competition)
    _add(feed, "updated", entries[0][0] if entries else board.opens)
    _add(_add(feed, "author", ""), "name", board.competition)
    ElementTree.SubElement(feed, "link", href="./")
    for time, title in entries:
        entry = ElementTree.SubElement(feed, "entry")
        _add(entry, "id", _id(board.competition, time, title))
        _add(entry, "title", title)
        _add(entry, "updated", time)
        ElementTree.SubElement(entry, "link", href="./")
    return bytes(ElementTree.tostring(feed, encoding="utf-8", xml_declaration=True))


def _entries(board: SeasonBoard) -> Iterator[tuple[str, str]]:
    """Yield the time and title of each event."""
    yield from board.announcements
    for act in board.acts:
        yield act.time, line_of(act)
    for entrant in board.entrants:
        for one in entrant.attempts:
            if one.ended and one.state in ("verified", "forfeited"):
                known = one.state == "verified" and board.tasks
                score = f", score {number(one.score)}" if known else ""
                yield one.ended, f"{entrant.shown}: attempt {one.number} {one.state}{score}"


def _id(*parts: str) -> str:
    return f"urn:sha256:{sha256(chr(0).join(parts).encode(errors='replace')).hexdigest()}"


def _add(parent: ElementTree.Element, name: str, text: str) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, name)
    element.text = _NOT_IN_XML.sub("?", one_line(text))
    return element

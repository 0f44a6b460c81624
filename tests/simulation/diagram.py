"""The events of a simulated run, as a sequence diagram in text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

from glue.wire.messages import Kind, Message

WIDTH: Final = 34
"""Characters of an arrow."""


def _short(message: Message) -> str:
    scalars = message.scalars
    detail = ""
    if message.kind is Kind.WELCOME:
        detail = " resumed" if scalars[1] else " new"
    elif message.kind in (Kind.ERROR, Kind.REFUSE, Kind.NOTICE):
        detail = f" {scalars[0]!s}" + (f" {scalars[1]!s}" if message.kind is Kind.NOTICE else "")
    return f"{message.session}:{message.kind.name}{detail} {message.seq or ''}".strip()


def diagram(trace: Iterable[tuple[Any, ...]]) -> Iterator[str]:
    """Yield the lines of the diagram: seconds, then an event; peers at the left, the hub at the right."""
    began: float | None = None
    for when, who, *what in trace:
        began = when if began is None else began
        if who == "hub" and len(what) > 2 and isinstance(what[2], Message):
            verb, name, message = what
            text = f" {_short(message)} ".center(WIDTH, "-")
            arrow = {"sends": f"<{text}-", "cannot send": f"x{text}-"}.get(verb, f"-{text}>")
            event = f"{name:.24}".rjust(24) + f" {arrow} hub"
        elif who == "fault":
            event = f"{'***':>24} {' '.join(map(str, what))}"
        else:
            event = f"{who:.24}".rjust(24) + f" {' '.join(map(str, what))}"
        yield f"{when - began:10.6f} {event}"

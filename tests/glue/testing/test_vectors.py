"""The program writes, reads and refuses the entries of glue/testing/vectors.json as stated there."""

from __future__ import annotations

import json
from typing import Any, Final

import pytest

from glue.errors import RemoteProtocolError
from glue.types import CUT_OFF
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.limits import MAX_BODY, MAX_HEADER
from glue.wire.messages import CALLS, CONTROL, OBSERVING, Kind
from tests.glue.testing.vectors import FILE, body_document, content, tagged

VECTORS: Final = json.loads(FILE.read_text(encoding="utf-8"))


def shapes_of(entry: dict[str, Any]) -> Any:
    return TO_HUB if entry["to"] == "hub" else FROM_HUB


def frames_of(entry: dict[str, Any]) -> list[bytes]:
    return [bytes.fromhex(frame) for frame in entry["frames"]]


def on_the_wire(entry: dict[str, Any]) -> list[bytes]:
    """Return the frames received when the bytes of `wire` arrive one by one."""
    decoder = zmtp.Decoder(zmtp.DEALER, 2 * MAX_BODY + MAX_HEADER)
    for part in ("greeting", "ready of the hub"):
        decoder.receive_data(bytes.fromhex(VECTORS["zmtp"][part]))
    while decoder.next_event() is not None:
        pass
    decoder.receive_data(bytes.fromhex(entry["wire"]))
    event = decoder.next_event()
    assert isinstance(event, list)
    return event


def test_the_file_is_what_the_program_makes() -> None:
    current = FILE.read_text(encoding="utf-8") == content()
    assert current, "the messages have changed: run `make vectors`"


@pytest.mark.parametrize("part", ["messages", "observe", "truncate", "outcome", "accepted"])
def test_every_entry_decodes_to_what_it_says(part: str) -> None:
    for entry in VECTORS[part]:
        shapes = shapes_of(entry)
        message = decode(on_the_wire(entry), shapes)
        assert on_the_wire(entry) == frames_of(entry)
        assert (message.kind.name, int(message.kind)) == (entry["kind"], entry["code"]), entry["name"]
        assert (message.session, str(message.seq)) == (entry["session"], entry["seq"]), entry["name"]
        assert [tagged(value) for value in message.scalars] == entry["scalars"], entry["name"]
        assert body_document(shapes[message.kind].body, message.body) == entry["body"], entry["name"]
        if part != "accepted":
            assert list(encode(message, shapes)) == frames_of(entry), entry["name"]


def test_every_kind_is_there_in_every_direction() -> None:
    there = {(entry["kind"], entry["to"] == "hub") for entry in VECTORS["messages"]}
    expected = {(kind.name, to_hub) for kind in CALLS for to_hub in (True, False)}
    assert expected <= there
    assert {kind.name for kind in CONTROL} <= {kind for kind, _ in there}
    assert {Kind[name] for name, _ in there} == set(Kind) - OBSERVING.keys()
    assert {entry["kind"] for entry in VECTORS["observe"]} == {kind.name for kind in OBSERVING}
    assert [entry["scalars"][0] for entry in VECTORS["outcome"]] == [tagged(True), tagged(CUT_OFF)]


def test_everything_to_be_refused_is_refused() -> None:
    for entry in VECTORS["refused"]:
        try:
            decode(frames_of(entry), shapes_of(entry))
        except RemoteProtocolError:
            continue
        pytest.fail(f"accepted: {entry['name']}")


def test_refused_streams_end_a_connection() -> None:
    for entry in VECTORS["zmtp"]["refused"]:
        decoder = zmtp.Decoder(zmtp.DEALER, 2 * MAX_BODY + MAX_HEADER)
        for part in ("greeting", "ready of the hub"):
            decoder.receive_data(bytes.fromhex(VECTORS["zmtp"][part]))
        while decoder.next_event() is not None:
            pass
        decoder.receive_data(bytes.fromhex(entry["hex"]))
        with pytest.raises(RemoteProtocolError):
            decoder.next_event()


def test_a_ping_is_answered_as_said() -> None:
    for name in ("ping", "ping with a context"):
        decoder = zmtp.Decoder(zmtp.DEALER, 1000)
        for part in ("greeting", "ready of the hub", name):
            decoder.receive_data(bytes.fromhex(VECTORS["zmtp"][part]))
        answers = []
        while (event := decoder.next_event()) is not None:
            answers.append(event)
        assert answers[-1] == bytes.fromhex(VECTORS["zmtp"][name.replace("ping", "pong")])

"""Our codec reads, writes and refuses the entries of glue/testing/vectors.json as stated there.

A client in any language checks its codec by this file; docs/clients.md says what each entry means.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pytest

import glue.testing
from glue.errors import RemoteProtocolError
from glue.extras import Extra, pack_extras, unpack_extras
from glue.types import Observation, beside_sizes, body_size
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import MAX_FRAME, Body, Message, Value
from tests.glue.wire.examples import EXAMPLES

FILE: Final = Path(glue.testing.__file__).with_name("vectors.json")
VECTORS: Final = json.loads(FILE.read_text(encoding="utf-8"))
READ: Final = ("messages", "observe", "truncate", "outcome", "beside", "pace", "late", "accepted")
"""Parts of the file whose entries are messages; only `messages` is for every client."""

Document = dict[str, Any]


def shapes_of(entry: dict[str, Any]) -> Any:
    return TO_HUB if entry["to"] == "hub" else FROM_HUB


def frames_of(entry: dict[str, Any]) -> list[bytes]:
    return [bytes.fromhex(frame) for frame in entry["frames"]]


def received(hexadecimal: str) -> zmtp.Decoder:
    """Return a hub's peer that has received bytes behind the handshake."""
    decoder = zmtp.Decoder(zmtp.DEALER, MAX_FRAME)
    for part in ("greeting", "ready of the hub"):
        decoder.receive_data(bytes.fromhex(VECTORS["zmtp"][part]))
    while decoder.next_event() is not None:
        pass
    decoder.receive_data(bytes.fromhex(hexadecimal))
    return decoder


def document(name: str, sender: str, receiver: str, message: Message, frames: Sequence[bytes]) -> Document:
    """Return the entry of a message."""
    shape = (TO_HUB if receiver == "hub" else FROM_HUB)[message.kind]
    return {
        "name": name,
        "from": sender,
        "to": receiver,
        "kind": message.kind.name,
        "code": int(message.kind),
        "session": message.session,
        "seq": str(message.seq),
        "scalars": [tagged(value) for value in message.scalars],
        "body": body_document(shape.body, message.body),
        "frames": [frame.hex() for frame in frames],
        "wire": zmtp.encode(frames).hex(),
    }


def tagged(value: Value | Extra) -> Document:
    """Return a scalar with its type; ints are in decimal and floats by their bits, which JSON would lose."""
    if value is None:
        return {"nil": True}
    if isinstance(value, bool):
        return {"bool": value}
    if isinstance(value, int):
        return {"int": str(value)}
    if isinstance(value, float):
        return {"float": bits(value)}
    if isinstance(value, str):
        return {"text": value}
    if isinstance(value, bytes):
        return {"binary": value.hex()}
    return {"array": [tagged(item) for item in value]}


def bits(value: float) -> str:
    return struct.pack(">d", value).hex()


def body_document(kind: Body, body: bytes) -> Document | None:
    if kind is Body.NONE:
        return None
    if kind is Body.TEXT:
        return {"text": body.decode()}
    if kind is Body.BLOB:
        return {"bytes": body.hex()}
    parts: list[Document] = []
    while body:
        size = body_size(body)
        value = Observation.from_body(body[:size])
        parts.append(
            {
                "ints": value.ints.tolist(),
                "doubles": [bits(double) for double in value.doubles.tolist()],
                "chars": value.chars.hex(),
            }
        )
        mask, extras = beside_sizes(value.body)
        if mask:
            parts[-1]["mask"] = value.packed_mask.hex()
        if extras:
            parts[-1]["extras"] = value.body[-extras:].hex()
        body = body[size:]
    return {"abstract": parts}


@pytest.mark.parametrize("part", READ)
def test_every_entry_decodes_to_what_it_says(part: str) -> None:
    for entry in VECTORS[part]:
        frames, shapes = received(entry["wire"]).next_event(), shapes_of(entry)
        assert isinstance(frames, list)
        message = decode(frames, shapes)
        assert document(entry["name"], entry["from"], entry["to"], message, frames) == entry
        if part != "accepted":
            assert list(encode(message, shapes)) == frames, entry["name"]


def test_every_example_of_the_protocol_is_there() -> None:
    there = [entry for part in READ for entry in VECTORS[part]]
    for example in EXAMPLES:
        message = decode(example.frames, example.shapes)
        entry = document(str(example), example.sender, example.receiver, message, example.frames)
        assert entry in there, f"its line in {FILE}: {json.dumps(entry)}"


def test_extras_are_read_and_refused_as_said() -> None:
    for entry in VECTORS["extras"]["accepted"]:
        found = unpack_extras(bytes.fromhex(entry["hex"]))
        assert {name: tagged(value) for name, value in found.items()} == entry["values"]
        assert pack_extras(found).hex() == entry["hex"] or "width" in entry["name"]
    for entry in VECTORS["extras"]["refused"]:
        with pytest.raises(RemoteProtocolError):
            unpack_extras(bytes.fromhex(entry["hex"]))


def test_everything_to_be_refused_is_refused() -> None:
    for entry in VECTORS["refused"]:
        try:
            decode(frames_of(entry), shapes_of(entry))
        except RemoteProtocolError:
            continue
        pytest.fail(f"accepted: {entry['name']}")


def test_refused_streams_end_a_connection() -> None:
    for entry in VECTORS["zmtp"]["refused"]:
        with pytest.raises(RemoteProtocolError):
            received(entry["hex"]).next_event()


def test_a_ping_is_answered_as_said() -> None:
    for end in ("", " with a context"):
        answer = received(VECTORS["zmtp"][f"ping{end}"]).next_event()
        assert answer == bytes.fromhex(VECTORS["zmtp"][f"pong{end}"])

"""Make glue/testing/vectors.json: messages and bytes with which a client in any language checks its codec.

`make vectors` runs this program. The messages are the examples of docs/protocol-reference.md, and others of
the same shapes; docs/clients.md says what each entry means. A test compares the file with this program's
output.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgpack
import numpy as np

import glue.testing
from glue.types import CUT_OFF, Action, Observation, body_size
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.limits import MAX_BODY, MAX_HEADER
from glue.wire.messages import OBSERVING, PROTOCOL_VERSION, Body, Kind, Message, Value
from tests.glue.wire.examples import EXAMPLES

FILE: Final = Path(glue.testing.__file__).with_name("vectors.json")

INF: Final = float("inf")
EXTREMES: Final = Observation(
    ints=[0, 1, -1, 2**31 - 1, -(2**31), 255, -256],
    doubles=[-0.0, 0.0, INF, -INF, float("nan"), 5e-324, 2.0**-1022, 1.7976931348623157e308, -0.1],
    chars=bytes(range(256)),
)
LARGE: Final = Observation(np.arange(-150, 150), np.arange(270) / 7, b"\xff\0" * 150)
TEXTS: Final = {
    "empty": "",
    "outside of ASCII": "größer als π: 走る 🏃",
    "with a NUL": "a\0b\0",
    "of two lines": "one\ntwo\n",
    "of 256 bytes": "x" * 256,
    "of 5000 bytes": "Straße " * 625,
}

Document = dict[str, Any]


# --- Messages -----------------------------------------------------------------------------------------


def documents() -> Iterator[Document]:
    """Yield every example of docs/protocol-reference.md, then the values that clients get wrong."""
    for example in EXAMPLES:
        message = decode(example.frames, example.shapes)
        yield message_document(str(example), example.sender, example.receiver, message, example.frames)
    for name, observation in {"extremes": EXTREMES, "empty": Observation(), "large": LARGE}.items():
        action = Action.from_body(observation.body)
        for message, sender, receiver in (
            (Message(Kind.AGENT_STEP, "walk", 7, (-0.0,), observation.body), "hub", "agent"),
            (Message(Kind.AGENT_STEP, "walk", 7, (), action.body), "agent", "hub"),
            (Message(Kind.ENV_STEP, "walk", 7, (INF, False), observation.body), "environment", "hub"),
            (Message(Kind.RL_STEP, "walk", 3, (-INF, True), observation.body + saw()), "hub", "experiment"),
            (Message(Kind.RL_STEP, "walk", 3, (0.1, False), saw() + action.body), "hub", "experiment"),
        ):
            yield made(f"{message.kind.name}: {name}", sender, receiver, message)
    for name, text in TEXTS.items():
        body = text.encode()
        yield made(f"text {name}", "hub", "agent", Message(Kind.AGENT_MESSAGE, "walk", 7, (), body))
        yield made(f"text {name}", "environment", "hub", Message(Kind.ENV_INIT, "walk", 7, (), body))
    for number in (0, 127, 128, 255, 256, 65535, 65536, 2**32 - 1, 2**32, 2**53 + 1, 2**63 - 1):
        yield made(f"seed {number}", "hub", "agent", Message(Kind.AGENT_SEED, "walk", number, (number,)))
        yield made(f"seq {number}", "agent", "hub", Message(Kind.AGENT_END, "walk", number))
    for reward in (-0.0, INF, -INF, float("nan"), 5e-324, 0.1, -1.0, 2.0**53):
        message = Message(Kind.AGENT_END, "walk", 7, (reward,))
        yield made(f"reward {reward!r}", "hub", "agent", message)
        message = Message(Kind.ENV_STEP, "walk", 7, (reward, True), saw())
        yield made(f"reward {reward!r}", "environment", "hub", message)
    for session in ("s", "x" * 31, "x" * 32, "x" * 255, "größe 走"):
        yield made("session", "hub", "environment", Message(Kind.ENV_START, session, 7))
    goodbye = Message(Kind.GOODBYE, "walk", 0, ("y" * 300,))
    yield made("reason of 300 bytes", "hub", "peer", goodbye)


def section(entry: Document) -> str:
    """Return the part of the file that a message belongs to; only `messages` is for every client."""
    if Kind[entry["kind"]] in OBSERVING:
        return "observe"  # never met by a client that takes part
    if len(entry["scalars"]) == 3 and entry["kind"] == "RL_EPISODE":
        return "outcome"
    return "truncate" if cuts(entry) else "messages"


def cuts(entry: Document) -> bool:
    """Return whether a message has the terminal 2, which peers that know `truncate` tell from true."""
    return tagged(CUT_OFF) in entry["scalars"] and entry["kind"] in ("ENV_STEP", "RL_STEP", "RL_EPISODE")


def saw() -> bytes:
    return Observation([11]).body


def made(name: str, sender: str, receiver: str, message: Message) -> Document:
    shapes = TO_HUB if receiver == "hub" else FROM_HUB
    return message_document(name, sender, receiver, message, encode(message, shapes))


def message_document(
    name: str, sender: str, receiver: str, message: Message, frames: Sequence[bytes]
) -> Document:
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
        **frames_document(frames),
    }


def tagged(value: Value) -> Document:
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
    parts = []
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
        body = body[size:]
    return {"abstract": parts}


def frames_document(frames: Sequence[bytes]) -> Document:
    return {"frames": [frame.hex() for frame in frames], "wire": zmtp.encode(frames).hex()}


# --- Other encodings of the same ----------------------------------------------------------------------


def accepted() -> Iterator[Document]:
    """Yield messages that a peer must understand although it would encode them differently."""
    step = Message(Kind.AGENT_STEP, "walk", 7, (1.0,), saw())
    head = "9406a477616c6b07"
    for name, header, reward in (
        ("kind of 8 bits", "94cc06a477616c6b07cb3ff0000000000000", 1.0),
        ("kind of 16 bits", "94cd0006a477616c6b07cb3ff0000000000000", 1.0),
        ("kind of 32 bits", "94ce00000006a477616c6b07cb3ff0000000000000", 1.0),
        ("kind of 64 bits", "94cf0000000000000006a477616c6b07cb3ff0000000000000", 1.0),
        ("kind of 8 bits, signed", "94d006a477616c6b07cb3ff0000000000000", 1.0),
        ("seq of 8 bits", "9406a477616c6bcc07cb3ff0000000000000", 1.0),
        ("seq of 16 bits", "9406a477616c6bcd0007cb3ff0000000000000", 1.0),
        ("seq of 32 bits", "9406a477616c6bce00000007cb3ff0000000000000", 1.0),
        ("seq of 64 bits", "9406a477616c6bcf0000000000000007cb3ff0000000000000", 1.0),
        ("seq of 8 bits, signed", "9406a477616c6bd007cb3ff0000000000000", 1.0),
        ("seq of 16 bits, signed", "9406a477616c6bd10007cb3ff0000000000000", 1.0),
        ("seq of 32 bits, signed", "9406a477616c6bd200000007cb3ff0000000000000", 1.0),
        ("seq of 64 bits, signed", "9406a477616c6bd30000000000000007cb3ff0000000000000", 1.0),
        ("session as str 8", "9406d90477616c6b07cb3ff0000000000000", 1.0),
        ("session as str 16", "9406da000477616c6b07cb3ff0000000000000", 1.0),
        ("session as str 32", "9406db0000000477616c6b07cb3ff0000000000000", 1.0),
        ("header as array 16", "dc000406a477616c6b07cb3ff0000000000000", 1.0),
        ("header as array 32", "dd0000000406a477616c6b07cb3ff0000000000000", 1.0),
        ("reward as float 32", head + "ca3f800000", 1.0),
        ("reward as float 32, negative zero", head + "ca80000000", -0.0),
        ("reward as float 32, infinite", head + "ca7f800000", INF),
        ("reward as fixint", head + "01", 1.0),
        ("reward as negative fixint", head + "ff", -1.0),
        ("reward as uint 8", head + "ccff", 255.0),
        ("reward as uint 16", head + "cdffff", 65535.0),
        ("reward as uint 32", head + "ceffffffff", 4294967295.0),
        ("reward as uint 64", head + "cf0020000000000000", 2.0**53),
        ("reward as int 8", head + "d080", -128.0),
        ("reward as int 16", head + "d18000", -32768.0),
        ("reward as int 32", head + "d280000000", -2147483648.0),
        ("reward as int 64", head + "d3ffe0000000000000", -(2.0**53)),
    ):
        frames = (bytes.fromhex(header), step.body)
        yield message_document(name, "hub", "agent", step._replace(scalars=(reward,)), frames)
    ended = Message(Kind.RL_STEP, "walk", 3, (1.0, True), saw() + saw())
    head = "9516a477616c6b03cb3ff0000000000000"
    for name, terminal, meant in (
        ("terminal 0", "00", False),
        ("terminal 1", "01", True),
        ("terminal 3", "03", True),
        ("terminal -1", "ff", True),
        ("terminal as uint 64", "cf0000000000000001", True),
        ("terminal as int 32", "d280000000", True),
        ("terminal as int 64, zero", "d30000000000000000", False),
    ):
        frames = (bytes.fromhex(head + terminal), ended.body)
        yield message_document(name, "hub", "experiment", ended._replace(scalars=(1.0, meant)), frames)
    error = Message(Kind.ERROR, "walk", 7, ("x", ""))
    for name, code in (
        ("str 8", "d90178"),
        ("str 16", "da000178"),
        ("str 32", "db0000000178"),
    ):
        frame = bytes.fromhex("9545a477616c6b07" + code + "a0")
        yield message_document(f"code as {name}", "hub", "peer", error, (frame,))
    welcome = Message(Kind.WELCOME, "walk", 0, (1, True, 1.0, 5.0, 65536))
    frame = bytes.fromhex("9841a477616c6b0001010105d300000000 00010000".replace(" ", ""))
    yield message_document("WELCOME in integers alone", "hub", "peer", welcome, (frame,))


# --- Refused frames -----------------------------------------------------------------------------------


def refused() -> Iterator[Document]:
    """Yield frames that are no message, each with the reason for people."""
    good = saw()
    step = msgpack.packb([Kind.AGENT_STEP, "walk", 7, 1.0])
    counts = struct.Struct("<4I")

    def header(*items: object) -> bytes:
        packed: bytes = msgpack.packb(list(items))
        return packed

    cases: dict[str, tuple[bytes, ...]] = {
        "an empty header": (b"",),
        "a header that is no msgpack": (b"\xc1",),
        "a header that is a map": (msgpack.packb({1: 2}),),
        "a header that is an integer": (b"\x06",),
        "a header that is cut short": (step[:-1], good),
        "a header with a byte too many": (step + b"\xc0", good),
        "a header of two items": (header(67, ""),),
        "a header that promises 4294967295 items": (b"\xdd\xff\xff\xff\xff\x06", good),
        "a header that promises a text of 4294967295 bytes": (b"\x93\x06\xdb\xff\xff\xff\xff",),
        "a header that promises a binary of 4294967295 bytes": (b"\x93\x06\xc6\xff\xff\xff\xff",),
        "a header of more than 64 items": (header(6, "walk", 7, *range(62)), good),
        f"a header of {MAX_HEADER + 1} bytes": (header(68, "walk", 0, "x" * (MAX_HEADER - 10)),),
        "a header of arrays in arrays": (b"\x91" * 4000 + b"\x90",),
        "a map in a header": (b"\x94\x06\xa4walk\x07\x80", good),
        "an extension in a header": (b"\x94\x06\xa4walk\x07\xd4\x01\x00", good),
        "a kind that is a float": (header(6.0, "walk", 7, 1.0), good),
        "a kind that is a text": (header("6", "walk", 7, 1.0), good),
        "a session that is binary": (header(6, b"walk", 7, 1.0), good),
        "a session that is not UTF-8": (b"\x94\x06\xa2\xc3\x28\x07\x01", good),
        "a session of 256 characters": (header(6, "x" * 256, 7, 1.0), good),
        "a seq that is negative": (header(6, "walk", -1, 1.0), good),
        "a seq of 2^63": (header(6, "walk", 2**63, 1.0), good),
        "a seq that is a float": (header(6, "walk", 7.0, 1.0), good),
        "a seq that is true": (header(6, "walk", True, 1.0), good),
        "a reward that is a text": (header(6, "walk", 7, "1.0"), good),
        "a reward that is nil": (header(6, "walk", 7, None), good),
        "a reward that is true": (header(6, "walk", 7, True), good),
        "a reward that is an integer beyond 2^53": (header(6, "walk", 7, 2**53 + 1), good),
        "no reward": (header(6, "walk", 7), good),
        "two rewards": (header(6, "walk", 7, 1.0, 1.0), good),
        "a seed that is negative": (header(80, "walk", 7, -1),),
        "a seed of 2^63": (header(80, "walk", 7, 2**63),),
        "a seed that is a float": (header(80, "walk", 7, 1.0),),
        "no body": (step,),
        "a body where there is none": (header(7, "walk", 7, 1.0), b""),
        "three frames": (step, good, b""),
        "an empty body where there is an observation": (step, b""),
        "a body of 15 bytes": (step, bytes(15)),
        "a body that is cut short": (step, good[:-1]),
        "a body with a byte too many": (step, good + b"\0"),
        "a body whose fourth word is not zero": (step, counts.pack(0, 0, 0, 1)),
        "a body that promises 4294967295 ints": (step, counts.pack(2**32 - 1, 0, 0, 0)),
        "a body that promises 4294967295 doubles": (step, counts.pack(0, 2**32 - 1, 0, 0)),
        "a body that promises 4294967295 chars": (step, counts.pack(0, 0, 2**32 - 1, 0)),
        "a body whose size is that of its counts only modulo 2^32": (step, counts.pack(0, 2**29, 0, 0)),
    }
    for name, frames in cases.items():
        yield {"name": name, "from": "hub", "to": "agent", **frames_document(frames)}
    both = header(22, "walk", 3, 1.0, False)
    for name, body in {
        "an observation without an action": good,
        "an observation and half an action": good + good[:10],
        "an observation, an action and a byte": good + good + b"\0",
        "an observation that promises more than there is": counts.pack(1000, 0, 0, 0) + good,
    }.items():
        yield {"name": name, "from": "hub", "to": "experiment", **frames_document((both, body))}


# --- ZMTP ---------------------------------------------------------------------------------------------


def streams() -> Document:
    """Return the vectors of bytes other than messages on a connection."""
    return {
        "greeting": zmtp.GREETING.hex(),
        "ready": "04290552454144590b536f636b65742d54797065000000064445414c4552084964656e7469747900000000",
        "ready of the hub": "041c0552454144590b536f636b65742d5479706500000006524f55544552",
        "ping": "040704" + b"PING".hex() + "0000",
        "pong": "040504" + b"PONG".hex(),
        "ping with a context": "040a04" + b"PING".hex() + "012c" + b"abc".hex(),
        "pong with a context": "040804" + b"PONG".hex() + b"abc".hex(),
        "refused": [
            {"name": "flags that do not exist", "hex": "0801"},
            {"name": "a command of two frames", "hex": "050101"},
            {"name": "a frame of 2^63 bytes", "hex": "028000000000000000"},
            {"name": "a frame of 2^64 - 1 bytes", "hex": "02ffffffffffffffff"},
            {"name": "a frame of 2^40 bytes", "hex": "020000010000000000"},
            {"name": "the command ERROR", "hex": "040a054552524f5203" + b"why".hex()},
        ],
    }


def content() -> str:
    """Return the file as text, one entry a line."""
    parts: dict[str, list[Document]] = {"messages": [], "observe": [], "truncate": [], "outcome": []}
    for entry in documents():
        parts[section(entry)].append(entry)
    parts |= {
        "accepted": list(accepted()),
        "refused": list(refused()),
    }
    limits = {"max_header": MAX_HEADER, "max_body": MAX_BODY}
    lines = [f'{{\n"version": {PROTOCOL_VERSION},\n"limits": {json.dumps(limits)},']
    lines.append(f'"zmtp": {json.dumps(streams())},')
    for name, entries in parts.items():
        lines.append(f'"{name}": [')
        lines.append(",\n".join(json.dumps(entry) for entry in entries))
        lines.append("]" if name == "refused" else "],")
    return "\n".join([*lines, "}\n"])


if __name__ == "__main__":
    FILE.write_text(content(), encoding="utf-8")

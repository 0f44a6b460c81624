"""Readers of untrusted bytes: each takes any bytes, and raises only the package's own errors."""

from __future__ import annotations

import gzip
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

from glue.errors import GlueError
from glue.extras import pack_extras, unpack_extras
from glue.legacy import codec as codec_of_originals
from glue.taskspec import parse_task_spec
from glue.trajectory import Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import Message
from glue.wire.stream import Stream

Target = Callable[[bytes], None]

ROOT: Final = Path(__file__).parents[2]

_LIMIT: Final = 2**16


def _pieces(data: bytes) -> Iterator[bytes]:
    """Yield pieces in which a network might deliver `data`, whose first byte decides their size."""
    size = 1 + (data[0] if data else 0)
    for at in range(1, len(data), size):
        yield data[at : at + size]


def codec(data: bytes) -> None:
    """Decode two frames, and encode the message that they hold."""
    size = 2 * data[0] if data else 0
    frames = [data[1 : 1 + size], data[1 + size :]]
    for direction in (TO_HUB, FROM_HUB):
        try:
            message = decode(frames, direction, _LIMIT)
        except GlueError:
            continue
        assert decode(encode(message, direction), direction, _LIMIT) == message


def extras(data: bytes) -> None:
    """Read the extras of an observation, and write them again."""
    try:
        found = unpack_extras(data)
    except GlueError:
        return
    again = unpack_extras(pack_extras(found))
    assert repr(again) == repr(found)  # a NaN is not equal to itself


def wire(data: bytes) -> None:
    """Read ZMTP, at both ends of a connection."""
    for own in (zmtp.ROUTER, zmtp.DEALER):
        stream = Stream(own, _LIMIT, _LIMIT)
        with suppress(GlueError):
            for piece in (zmtp.GREETING, *_pieces(data)):
                stream.receive_data(piece)
                while (event := stream.next_event()) is not None:
                    assert isinstance(event, Message | bytes)
            assert stream.buffered <= len(data) + len(zmtp.GREETING)


def curve(data: bytes) -> None:
    """Read a CURVE handshake with some bytes changed: each three bytes of `data` choose where, and how."""
    from glue.wire.curve import CurveClient, CurveServer, public_key

    secret = bytes(range(32))
    public = public_key(secret)
    hub = Stream(zmtp.ROUTER, _LIMIT, _LIMIT, CurveServer(secret, lambda client: True))
    peer = Stream(zmtp.DEALER, _LIMIT, _LIMIT, CurveClient(public, secret, public))
    sent = [zmtp.CURVE_CLIENT_GREETING, zmtp.CURVE_GREETING]
    changes = list(data)
    with suppress(GlueError):
        for turn in range(8):
            said = bytearray(sent[turn % 2])
            sent[turn % 2] = b""
            if said and len(changes) >= 3:
                where, low, change = changes[:3]
                del changes[:3]
                if where & 1:
                    said[(where * 256 + low) % len(said)] ^= change
                elif where & 2:
                    said = said[: low % (len(said) + 1)]
            side = (hub, peer)[turn % 2]
            side.receive_data(bytes(said))
            while (event := side.next_event()) is not None:
                if isinstance(event, bytes):
                    sent[(turn + 1) % 2] += event


def legacy(data: bytes) -> None:
    """Read what an original RL-Glue program might send."""
    for vocabulary in (codec_of_originals.HANDSHAKE, *codec_of_originals.FROM.values()):
        decoder = codec_of_originals.Decoder(vocabulary)
        with suppress(GlueError):
            for piece in _pieces(data):
                decoder.receive_data(piece)
                while decoder.next_event() is not None:
                    pass


def taskspec(data: bytes) -> None:
    """Parse a task spec; its text, parsed again, is the same."""
    try:
        spec = parse_task_spec(data.decode("utf-8", "replace"))
    except GlueError:
        return
    assert parse_task_spec(str(spec)) == spec


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="fuzzing-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))


def recording(data: bytes) -> None:
    """Read a recording of episodes, compressed as the writer does or not at all."""
    file = _folder() / "recording"
    file.write_bytes(gzip.compress(data[1:], 1) if data[:1] != b"\x1f" else data)
    with suppress(GlueError):
        for _ in TrajectoryReader(file):
            pass


def results(data: bytes) -> None:
    """Open a run's database with some bytes changed: each four bytes of `data` are a position and a value."""
    from experiment_runner.store.run_data import load_run
    from tests.system.runs import unpack_older_runs

    folder = _folder() / "run"
    if not folder.exists():
        unpack_older_runs(folder)
    where = folder / "undisturbed/results.sqlite"
    original = _original(where)
    for log in where.parent.glob("results.sqlite-*"):
        log.unlink()
    changed = bytearray(original)
    for at in range(0, len(data) - 3, 4):
        place = int.from_bytes(data[at : at + 3], "little") % len(changed)
        changed[place] = data[at + 3]
    where.write_bytes(changed)
    with suppress(GlueError):
        load_run(where.parent)


@cache
def _original(file: Path) -> bytes:
    return file.read_bytes()


TARGETS: Final[Mapping[str, Target]] = {
    "codec": codec,
    "extras": extras,
    "zmtp": wire,
    "curve": curve,
    "legacy": legacy,
    "taskspec": taskspec,
    "recording": recording,
    "results": results,
}


def examples(name: str) -> list[bytes]:
    """Return inputs to begin with: messages of well-behaved programs."""
    found = [b"", bytes(range(64)), b"\xff" * 40]
    vectors = json.loads((ROOT / "glue/testing/vectors.json").read_text(encoding="utf-8"))
    texts = [text for text in _strings(vectors) if len(text) > 8 and len(text) % 2 == 0]
    for text in texts[:60]:
        try:
            found.append((b"\xff" if name == "zmtp" else b"\x20") + bytes.fromhex(text))
        except ValueError:
            continue
    if name == "extras":
        found += [bytes.fromhex(entry["hex"]) for entries in vectors["extras"].values() for entry in entries]
    if name == "taskspec":
        found.append(
            b"VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (2 0 1) DOUBLES"
            b" (NEGINF 4.5) CHARCOUNT 3 ACTIONS INTS (0 3) REWARDS (-1 UNSPEC) EXTRA x"
        )
        found.append(b"2:e:2_[i,f]_[0,1]_[-1.0,1.0]:1_[i]_[0,3]:[-1,1]")
    if name == "recording":
        found.append(b"\0" + gzip.decompress(_recorded()))
    return found


def _recorded() -> bytes:
    file = _folder() / "written"
    file.unlink(missing_ok=True)
    with TrajectoryWriter(file) as writer:
        writer.run(Run("mines", {"random_start": True}, "a task", 7, b"state"))
        writer.message("hello")
        writer.start(Observation(ints=[1], doubles=[0.5], chars=b"x", mask=[True, False], extras={"a": 1}))
        writer.answer("how far?", "so far")
        for step in range(3):
            writer.step(Action(ints=[step]), 1.0, Observation(ints=[step]), step == 2)
    return file.read_bytes()


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value.replace(" ", "")
    elif isinstance(value, list):
        for each in value:
            yield from _strings(each)
    elif isinstance(value, dict):
        for each in value.values():
            yield from _strings(each)


def run(name: str, data: bytes) -> None:
    """Give a target its input."""
    TARGETS[name](data)

"""A mirror on a bare socket, right but for one fault: what a client's author gets wrong, one thing at a time.

It shares nothing with the clients of this project but the examples of docs/protocol.md.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import time
from typing import Any, Final

import msgpack

HELLO, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR, NOTICE = range(64, 71)

FAULTS: Final[dict[str, dict[str, str]]] = {
    "agent": {
        "says HELLO ahead of the hub's READY": "handshake",
        "takes another role": "hello",
        "says HELLO twice": "hello",
        "has the same instance for ever": "restart",
        "counts ints as unsigned": "ints",
        "writes big-endian doubles": "doubles",
        "loses negative zero": "doubles",
        "cuts chars at NUL": "chars",
        "leaves out an empty body": "empty",
        "has buffers of 64 KiB": "large",
        "reads texts as ASCII": "texts",
        "cuts texts at NUL": "texts",
        "knows no infinity": "rewards",
        "knows no float 32": "widths",
        "knows no array 16": "widths",
        "counts in 32 bits": "numbers",
        "carries out what comes again": "repeated",
        "answers twice what comes again": "repeated",
        "answers an outdated call": "outdated",
        "goes on counting after `resumed` false": "forgets",
        "forgets its answer after `resumed` false": "welcome-lost",
        "answers ahead of WELCOME": "silent-until-welcomed",
        "ignores unknown kinds": "unknown-kind",
        "answers an ERROR": "ignores",
        "ends at any ERROR": "ignores",
        "counts seeds in 32 bits": "seed",
        "saves half of itself": "save",
        "dies of a broken text": "broken-text",
        "ignores WELCOME's limits": "max-body",
        "dies without a word": "exception",
        "takes HEARTBEAT for a call": "heartbeats",
        "reconnects with a new instance": "instance",
        "loses the kept answer": "answer-lost",
        "keeps half a message over a break": "call-lost",
        "gives up when a handshake breaks": "handshakes-lost",
        "gives up when there is no hub": "absent",
        "stays unknown": "unknown-peer",
        "takes what it receives for one message": "torn",
        "deadlocks at a HEARTBEAT between its frames": "crossing",
        "answers no PING": "ping",
        "is silent": "silence",
        "waits busily": "idle",
        "makes room for any frame": "huge-frame",
        "takes a header cut short for a message": "malformed",
        "ignores GOODBYE": "goodbye",
        "is content to be refused": "refusal",
    },
    "environment": {
        "answers with the reward as a text": "doubles",
        "never ends an episode": "calls",
        "counts ints as unsigned": "ints",
        "loses the kept answer": "answer-lost",
        "ignores WELCOME's limits": "max-body",
        "offers to cut off, and ends": "truncate",
        "goes on where it was to cut off": "truncate",
    },
    "experiment": {
        "counts ints as unsigned": "ints",
        "takes an integer terminal for an error": "integer-terminal",
        "reads numbers of steps in 32 bits": "counters",
        "goes on after a cut-off": "truncate",
        "shows 2 for an episode that was cut off": "truncate",
        "offers to be told the outcome, and dies of it": "outcome",
        "counts requests from 0": "numbers",
        "takes any reply for its own": "other-replies",
        "asks ahead of WELCOME": "silent-until-welcomed",
        "asks twice over a new connection": "silent-until-welcomed",
        "goes on when it was forgotten": "forgotten",
        "gives up after `resumed` false": "welcome-lost",
        "drops a notice": "notices",
        "shows no code of an error": "errors",
        "dies of an unknown kind": "unknown-kind",
        "loses its request with the connection": "answer-lost",
        "ignores WELCOME's limits": "max-body",
        "leaves without GOODBYE": "end",
    },
}
"""For each role, faults, each with the one rule that it breaks."""

CODES: Final = {
    "agent": (4, 5, 6, 7, 8, 10, 80, 81, 82),
    "environment": (11, 12, 13, 14, 19, 83, 84, 85),
}
OFFERS: Final = {
    "agent": ["seed", "save"],
    "environment": ["seed", "save", "truncate"],
    "experiment": ["outcome"],
}
AGENT_NAMES: Final = ("INIT", "START", "STEP", "END", "CLEANUP", "MESSAGE", "SEED", "SAVE", "LOAD")
ENV_NAMES: Final = ("INIT", "START", "STEP", "CLEANUP", "MESSAGE", "SEED", "SAVE", "LOAD")


class Left(Exception):
    """The connection ended."""


class Quit(Exception):
    """The client ends with this exit code."""


class Asked(Exception):
    """The mirror's own failure."""


class Client:
    """The connection, and a mirror of any role."""

    def __init__(self, role: str, hub: str, session: str, fault: str) -> None:
        self.role, self.hub, self.session, self.fault = role, hub, session, fault
        self.instance = bytes(range(16)) if self.wrong("has the same instance for ever") else os.urandom(16)
        self.socket: socket.socket | None = None
        self.buffer = b""
        self.hellos = 0
        self.welcomed = False
        self.heartbeat, self.max_body = 1.0, 2**24
        self.last_seq = 0
        self.last_call: list[bytes] = []
        self.last_answer: list[bytes] = []
        self.answered_over = 0  # the connection
        self.count = self.seed = 0

    def wrong(self, fault: str) -> bool:
        return self.fault == fault

    # --- Bytes ----------------------------------------------------------------------------------------

    def read(self, size: int) -> bytes:
        """Return so many bytes."""
        since = time.monotonic()
        while len(self.buffer) < size:
            assert self.socket is not None
            busy = self.wrong("waits busily")
            self.socket.settimeout(0 if busy else self.heartbeat)
            try:
                more = self.socket.recv(65536)
            except (TimeoutError, BlockingIOError):
                if self.welcomed and not self.buffer and time.monotonic() >= since + self.heartbeat:
                    since = time.monotonic()
                    if not self.wrong("is silent"):
                        self.send([msgpack.packb([HEARTBEAT, self.session, 0])])
                continue
            except OSError:
                raise Left from None
            if not more:
                raise Left
            self.buffer += more
        taken, self.buffer = self.buffer[:size], self.buffer[size:]
        return taken

    def frame(self) -> tuple[int, bytes]:
        flags, size = self.read(2)
        if flags & 2:
            size = int.from_bytes(bytes([size]) + self.read(7), "big")
        if size > 2**26 and not self.wrong("makes room for any frame"):
            raise Left
        if size > 65536 and self.wrong("has buffers of 64 KiB"):
            raise Quit(1)
        return flags, self.read(size)

    def message(self) -> list[bytes]:
        frames = []
        while True:
            flags, data = self.frame()
            if flags & 4:
                if data[1:5] == b"PING" and not self.wrong("answers no PING"):
                    pong = b"\x04PONG" + data[7:]
                    self.send_bytes(bytes([4, len(pong)]) + pong)
                continue
            frames.append(data)
            beat = data[1:2] == b"\x43" and len(self.buffer) > 300
            if beat and self.wrong("takes what it receives for one message"):
                self.buffer = b""
            if not flags & 1:
                return frames

    def send(self, frames: list[bytes]) -> None:
        for at, frame in enumerate(frames):
            more = int(at < len(frames) - 1)
            short = len(frame) < 256
            head = bytes([more, len(frame)]) if short else bytes([more | 2]) + len(frame).to_bytes(8, "big")
            self.send_bytes(head + frame)
            if (
                more
                and self.wrong("deadlocks at a HEARTBEAT between its frames")
                and self.buffer[3:4] == b"\x43"
            ):
                time.sleep(60)

    def send_bytes(self, data: bytes) -> None:
        try:
            assert self.socket is not None
            self.socket.settimeout(60)
            self.socket.sendall(data)
        except OSError:
            raise Left from None

    # --- Connections ----------------------------------------------------------------------------------

    def connect(self) -> None:
        if self.socket is not None:
            self.socket.close()
        if not self.wrong("keeps half a message over a break") or not self.hellos:
            self.buffer = b""
        self.welcomed = False
        scheme, _, address = self.hub.partition("://")
        while True:
            self.socket = socket.socket(socket.AF_UNIX if scheme == "ipc" else socket.AF_INET)
            if scheme == "tcp":
                self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            host, _, port = address.rpartition(":")
            try:
                self.socket.connect(address if scheme == "ipc" else (host, int(port)))
            except OSError:
                self.socket.close()
                if self.wrong("gives up when there is no hub"):
                    raise Quit(1) from None
                time.sleep(0.02)
                continue
            try:
                self.shake_hands()
                return
            except Left:
                if self.wrong("gives up when a handshake breaks"):
                    raise Quit(1) from None
                self.buffer = b""
                self.socket.close()
                time.sleep(0.02)

    def shake_hands(self) -> None:
        kept, self.buffer = self.buffer, b""
        self.send_bytes(b"\xff" + bytes(8) + b"\x7f\x03\x01NULL" + bytes(48))
        self.read(64)
        ready = bytes.fromhex("04290552454144590b536f636b65742d54797065000000064445414c4552")
        self.send_bytes(ready + b"\x08Identity" + bytes(4))
        if self.wrong("says HELLO ahead of the hub's READY"):
            self.hello()
            self.frame()
        else:
            self.frame()
            self.hello()
        if self.wrong("says HELLO twice") and self.hellos == 1:
            self.hello()
        self.buffer = kept + self.buffer
        if self.wrong("answers ahead of WELCOME") and self.last_answer:
            self.send(self.last_answer)

    def hello(self) -> None:
        self.hellos += 1
        if self.wrong("reconnects with a new instance"):
            self.instance = os.urandom(16)
        role = "environment" if self.wrong("takes another role") else self.role
        offers = OFFERS[self.role]
        hello = [HELLO, self.session, self.hellos, [1], role, self.instance, "mirror", "a test", offers]
        self.send([msgpack.packb(hello)])

    # --- Messages -------------------------------------------------------------------------------------

    def next(self) -> tuple[list[bytes], int, int, list[Any]]:
        """Return the next message that is not about the connection: frames, kind, seq, scalars."""
        while True:
            try:
                if self.socket is None:
                    self.connect()
                frames = self.message()
                kind, seq, scalars = self.header(frames)
                if not self.controlled(kind, seq, scalars):
                    return frames, kind, seq, scalars
            except Left:
                self.lost()
                self.connect()

    def header(self, frames: list[bytes]) -> tuple[int, int, list[Any]]:
        data = frames[0]
        if self.wrong("takes a header cut short for a message") and len(frames) == 2:
            for padding in (b"", b"\0", b"\0\0"):
                try:
                    header = msgpack.unpackb(data + padding)
                    break
                except ValueError:
                    continue
        try:
            header = msgpack.unpackb(data, max_array_len=64) if "header" not in locals() else header
            kind, _, seq, *scalars = header
        except (ValueError, msgpack.UnpackException, TypeError) as error:
            print(f"this is not a header: {error}")
            raise Quit(1) from None
        if len(frames) > 2:
            raise Quit(1)
        if (self.wrong("knows no array 16") and data[0] == 0xDC) or (
            self.wrong("knows no float 32") and data[-5:-4] == b"\xca"
        ):
            raise Quit(1)
        return kind, seq, scalars

    def lost(self) -> None:
        """The connection was lost."""
        if self.wrong("loses the kept answer") and self.last_call:
            step = {"agent": 6, "environment": 13}[self.role]
            if msgpack.unpackb(self.last_call[0])[0] != step:
                self.last_seq -= 1
                self.last_call = []

    def controlled(self, kind: int, seq: int, scalars: list[Any]) -> bool:
        """Return whether it was about the connection, and has been acted on."""
        if kind == HEARTBEAT:
            if self.wrong("takes HEARTBEAT for a call") and seq == 0 and self.count % 2 and self.welcomed:
                raise Quit(1)
            return True
        if kind == WELCOME:
            if self.welcomed or seq != self.hellos:
                return True  # it answers no HELLO
            self.welcomed = True
            _, resumed, self.heartbeat, _, max_body = scalars
            self.max_body = 2**24 if self.wrong("ignores WELCOME's limits") else max_body
            self.was_welcomed(bool(resumed))
            return True
        if kind == GOODBYE and not self.wrong("ignores GOODBYE"):
            print(scalars[0])
            raise Quit(0)
        if kind == GOODBYE:
            return True
        if kind == REFUSE:
            print(scalars[1])
            raise Quit(0 if self.wrong("is content to be refused") else 1)
        if kind == ERROR and scalars[0] == "unknown-peer":
            if self.welcomed and not self.wrong("stays unknown"):
                self.welcomed = False
                self.hello()
            return True
        return False

    def was_welcomed(self, resumed: bool) -> None:
        if not resumed and not self.wrong("goes on counting after `resumed` false"):
            self.last_seq = 0
            if self.wrong("forgets its answer after `resumed` false"):
                self.last_call = []

    # --- A player -------------------------------------------------------------------------------------

    def play(self) -> int:
        try:
            while True:
                frames, kind, seq, scalars = self.next()
                try:
                    self.called(frames, kind, seq, scalars)
                except Left:
                    self.lost()
                    self.connect()
        except Quit as end:
            return int(end.args[0])

    def called(self, frames: list[bytes], kind: int, seq: int, scalars: list[Any]) -> None:
        if self.wrong("counts in 32 bits"):
            seq &= 2**32 - 1
        if kind in (ERROR, NOTICE):
            if kind == ERROR and self.wrong("answers an ERROR"):
                self.send([msgpack.packb([ERROR, self.session, seq, "exception", "I am sorry"])])
            if kind == ERROR and self.wrong("ends at any ERROR"):
                raise Quit(1)
            return
        anew = self.wrong("carries out what comes again") and self.answered_over == self.hellos
        again = seq == self.last_seq or frames == self.last_call
        if seq < self.last_seq and not self.wrong("answers an outdated call"):
            return
        if again and frames == self.last_call and not anew:
            self.last_seq = seq
            if self.wrong("answers twice what comes again") and self.hellos == 1:
                self.send(self.last_answer)
        elif again and seq == self.last_seq and not anew:
            pass
        else:
            self.last_answer = self.answer(kind, seq, scalars, frames[1] if len(frames) > 1 else b"")
            self.last_seq, self.last_call, self.answered_over = seq, frames, self.hellos
        if self.wrong("ignores unknown kinds") and kind in (62, 63):
            return
        self.send(self.last_answer)

    def answer(self, kind: int, seq: int, scalars: list[Any], body: bytes) -> list[bytes]:
        names = AGENT_NAMES if self.role == "agent" else ENV_NAMES
        codes = dict(zip(CODES[self.role], names, strict=True))
        if kind not in codes:
            return [msgpack.packb([ERROR, self.session, seq, "unknown-kind", "what?"])]
        try:
            replied, shown = self.mirror(codes[kind], scalars, body)
        except Asked as failure:
            if self.wrong("dies without a word"):
                raise Quit(1) from None
            return [msgpack.packb([ERROR, self.session, seq, "exception", str(failure)])]
        header = msgpack.packb([kind, self.session, seq, *replied])
        if shown is None or (self.wrong("leaves out an empty body") and shown == bytes(16)):
            return [header]
        if len(shown) > self.max_body:
            return [msgpack.packb([ERROR, self.session, seq, "exception", "that is too large"])]
        return [header, shown]

    def mirror(self, name: str, scalars: list[Any], body: bytes) -> tuple[list[Any], bytes | None]:
        self.count = 0 if name == "INIT" else self.count + (name in ("START", "STEP", "END"))
        if name == "INIT" and self.role == "environment":
            return [], "a mirror, größer than it is".encode()
        if name == "MESSAGE":
            return [], self.echo(body)
        if name == "SEED":
            self.seed = scalars[0] & 0xFFFFFFFF if self.wrong("counts seeds in 32 bits") else scalars[0]
        elif name == "SAVE":
            return [], f"{self.count} {self.seed}".encode()
        elif name == "LOAD":
            count, self.seed = map(int, body.split())
            self.count = self.count if self.wrong("saves half of itself") else count
        elif name == "START" and self.role == "environment":
            return [], self.write([self.count], [], b"")
        elif name in ("START", "STEP"):
            ints, doubles, chars = self.runs(body)
            empty = not ints and not doubles and not chars
            if self.role == "agent":
                reward = scalars[0] if scalars else 0.0
                if self.wrong("knows no infinity") and reward in (float("inf"), -float("inf")):
                    reward = 0.0
                added = [float(sum(ints)), float(reward)]
                replied: list[Any] = []
            else:
                added = [float(sum(ints))]
                reward = doubles[0] if doubles else 0.0
                if self.wrong("answers with the reward as a text") and doubles:
                    reward = str(reward)
                replied = [reward, self.terminal(chars[-1:])]
            if empty:
                return replied, bytes(16)
            return replied, self.write([*ints[::-1], self.count], [*doubles[::-1], *added], chars[::-1])
        return [], None

    def terminal(self, last: bytes) -> bool | int:
        if last == b"?" and not self.wrong("goes on where it was to cut off"):
            return True if self.wrong("offers to cut off, and ends") else 2
        return last == b"!" and not self.wrong("never ends an episode")

    def echo(self, body: bytes) -> bytes:
        if body == b"fail":
            raise Asked("asked to fail")
        if self.wrong("dies of a broken text"):
            try:
                body.decode()
            except UnicodeDecodeError:
                raise Quit(1) from None
        if self.wrong("reads texts as ASCII"):
            return body.decode("ascii", "replace").encode()
        return body.partition(b"\0")[0] if self.wrong("cuts texts at NUL") else body

    def runs(self, body: bytes) -> tuple[list[int], list[float], bytes]:
        i, d, _, _ = struct.unpack_from("<4I", body)
        ints = struct.unpack_from(
            f"<{i}{'I' if self.wrong('counts ints as unsigned') else 'i'}", body, 16 + 8 * d
        )
        order = ">" if self.wrong("writes big-endian doubles") else "<"
        doubles = list(struct.unpack_from(f"{order}{d}d", body, 16))
        if self.wrong("loses negative zero"):
            doubles = [double + 0.0 for double in doubles]
        chars = body[16 + 8 * d + 4 * i :]
        return list(ints), doubles, chars.partition(b"\0")[0] if self.wrong("cuts chars at NUL") else chars

    def write(self, ints: list[int], doubles: list[float], chars: bytes) -> bytes:
        order = ">" if self.wrong("writes big-endian doubles") else "<"
        return (
            struct.pack("<4I", len(ints), len(doubles), len(chars), 0)
            + struct.pack(f"{order}{len(doubles)}d", *doubles)
            + struct.pack(f"<{len(ints)}I", *(number & 0xFFFFFFFF for number in ints))
            + chars
        )


def run(role: str, hub: str, session: str, fault: str = "") -> int:
    """Be a client with one fault, or none; return the exit code."""
    if role == "experiment":
        from tests.glue.testing.conform.wrong_experiment import Asking

        return Asking(hub, session, fault).ask_on()
    return Client(role, hub, session, fault).play()


if __name__ == "__main__":
    sys.exit(run(sys.argv[1], os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"], *sys.argv[2:]))

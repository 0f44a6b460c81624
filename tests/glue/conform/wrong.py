"""A mirror with one fault: the mistakes of client authors, one at a time.

It shares only the examples of docs/protocol-reference.md with the clients of this project.
"""

from __future__ import annotations

import os
import select
import struct
import sys
import time
from typing import Any, Final

import msgpack

from tests.scripted.curve import METADATA, command
from tests.scripted.peer import GREETING, ScriptedPeer

HELLO, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR, NOTICE = range(64, 71)

FAULTS: Final[dict[str, dict[str, str]]] = {
    "agent": {
        "says HELLO ahead of the hub's READY": "handshake",
        "takes another role": "hello",
        "says HELLO twice": "hello-once",
        "says HELLO in place of HEARTBEAT": "hello-once",
        "has the same instance for ever": "restart",
        "counts ints as unsigned": "ints",
        "writes big-endian doubles": "doubles",
        "loses negative zero": "doubles",
        "cuts chars at NUL": "chars",
        "leaves out an empty body": "empty",
        "has buffers of 800 KiB": "large",
        "counts elements in 16 bits": "counts",
        "knows no call before INIT": "before-init",
        "knows session names in ASCII": "session-names",
        "reads texts as ASCII": "texts",
        "cuts texts at NUL": "texts",
        "knows no infinity": "rewards",
        "knows no float 32": "widths",
        "knows no array 16": "widths",
        "counts in 32 bits": "numbers",
        "carries out what comes again": "repeated",
        "answers twice what comes again": "repeated",
        "answers an outdated call": "outdated",
        "keeps no answer above 64 KiB": "large-repeated",
        "keeps no bytes of an answer": "repeated",
        "answers ahead of WELCOME a call of the last connection": "answer-delayed",
        "obeys a WELCOME that answers no HELLO": "welcome-unasked",
        "acts in any session": "other-sessions",
        "goes on counting after `resumed` false": "forgets",
        "forgets its answer after `resumed` false": "welcome-lost",
        "answers ahead of WELCOME": "silent-until-welcomed",
        "ignores unknown kinds": "unknown-kind",
        "answers an ERROR": "ignores",
        "ends at any ERROR": "ignores",
        "counts seeds in 32 bits": "seed",
        "saves half of itself": "save",
        "swaps its metrics": "metrics",
        "answers a batch with one action": "batch",
        "counts the actions of a batch by game": "batch",
        "has no room for last observations": "batch",
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
        "ignores WELCOME's heartbeat": "silence",
        "waits busily": "idle",
        "makes room for any frame": "huge-frame",
        "takes a header cut short for a message": "malformed",
        "takes a body that is too short": "malformed-bodies",
        "takes a body with a byte behind it": "malformed-bodies",
        "ignores the fourth word of a body": "malformed-bodies",
        "ignores GOODBYE": "goodbye",
        "is content to be refused": "refusal",
        "shows no reason": "reasons",
    },
    "environment": {
        "answers with the reward as a text": "doubles",
        "never ends an episode": "calls",
        "counts ints as unsigned": "ints",
        "loses the kept answer": "answer-lost",
        "ignores WELCOME's limits": "max-body",
        "offers to cut off, and ends": "truncate",
        "goes on where it was to cut off": "truncate",
        "ends a batch with one of its games": "batch",
        "rewards a batch as its first game": "batch",
        "shows no last observation of a batch": "batch",
        "rewards the start of a batch": "batch",
    },
    "experiment": {
        "counts ints as unsigned": "ints",
        "counts elements in 16 bits": "counts",
        "acts in any session": "other-sessions",
        "obeys a WELCOME that answers no HELLO": "welcome-unasked",
        "takes a body with a byte behind it": "malformed-bodies",
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
"""Faults of each role, each with the one rule that it breaks."""

ODDITIES: Final = (
    "sends a HEARTBEAT behind each answer",
    "numbers its HELLOs from 2^40",
    "gives up its first two attempts to connect",
    "is many games",
)
"""Unusual behaviour that breaks no rule; libzmq gives attempts up, too. Only environments are many games."""

BATCH_SPEC: Final = "VERSION RL-Glue-Batch-1 "
WALK: Final = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) "
    "REWARDS (-1 1)"
)

CODES: Final = {
    "agent": (4, 5, 6, 7, 8, 10, 80, 81, 82, 86),
    "environment": (11, 12, 13, 14, 19, 83, 84, 85),
}
OFFERS: Final = {
    "agent": ["seed", "save", "batch", "metrics"],
    "environment": ["seed", "save", "truncate"],
    "experiment": ["outcome"],
}
AGENT_NAMES: Final = ("INIT", "START", "STEP", "END", "CLEANUP", "MESSAGE", "SEED", "SAVE", "LOAD", "METRICS")
ENV_NAMES: Final = ("INIT", "START", "STEP", "CLEANUP", "MESSAGE", "SEED", "SAVE", "LOAD")


class Quit(Exception):
    """The client ends with this exit code."""


class Asked(Exception):
    """The mirror's own failure."""


class Client(ScriptedPeer):
    """A mirror of any role, with one fault or none."""

    def __init__(self, role: str, hub: str, session: str, fault: str) -> None:
        super().__init__(hub, session=session)
        self.role, self.fault = role, fault
        self.instance = bytes(range(16)) if self.wrong("has the same instance for ever") else os.urandom(16)
        self.connected = False
        self.hellos = 0
        self.welcomed = False
        self.heartbeat, self.max_body = 1.0, 2**24
        self.last_seq = 0
        self.last_call: list[bytes] = []
        self.last_answer: list[bytes] = []
        self.answered_over = 0  # number of the connection
        self.unsent = False
        self.count = self.seed = 0
        self.initialised = False
        self.games = 0  # in a batch
        self.steps = 0
        if role == "environment" and ("batch" in fault or fault == "is many games"):
            self.games = 2

    def wrong(self, fault: str) -> bool:
        return self.fault == fault

    # --- Bytes ----------------------------------------------------------------------------------------

    def fill(self) -> None:
        """Wait for bytes, with a HEARTBEAT whenever there are none for an interval."""
        since = time.monotonic()
        seconds = 0 if self.wrong("waits busily") else self.heartbeat
        while not select.select([self.socket], [], [], seconds)[0]:
            if self.welcomed and not self.buffer and time.monotonic() >= since + self.heartbeat:
                since = time.monotonic()
                if self.wrong("says HELLO in place of HEARTBEAT"):
                    self.greet_session()
                elif not self.wrong("is silent"):
                    self.beat()
        super().fill()

    def read_frame(self) -> tuple[int, bytes]:
        flags, size = self.read_head()
        if size > 2**26 and not self.wrong("makes room for any frame"):
            raise ConnectionAbortedError
        if size > 819_200 and self.wrong("has buffers of 800 KiB"):
            raise Quit(1)
        data = self.read(size)
        beat = not flags & 4 and data[1:2] == b"\x43" and len(self.buffer) > 300
        if beat and self.wrong("takes what it receives for one message"):
            self.buffer.clear()
        return flags, data

    def pinged(self, body: bytes) -> None:
        if not self.wrong("answers no PING"):
            super().pinged(body)

    def beat(self) -> None:
        self.send(msgpack.packb([HEARTBEAT, self.session, 0]))

    def send(self, *frames: bytes) -> None:
        # The body is sent by a call of its own, which notices a connection that has ended.
        whole = self.encoded(*frames)
        first = len(self.encoded(frames[0]))
        self.send_bytes(whole[:first])
        if len(frames) > 1:
            if self.wrong("deadlocks at a HEARTBEAT between its frames") and self.buffer[3:4] == b"\x43":
                time.sleep(60)
            self.send_bytes(whole[first:])

    # --- Connections ----------------------------------------------------------------------------------

    def connect_again(self) -> None:
        """Connect until a handshake is complete."""
        kept = b""
        if self.wrong("keeps half a message over a break") and self.hellos:
            kept = bytes(self.buffer)
        self.welcomed = False
        while True:
            try:
                for _ in range(3 if self.wrong("gives up its first two attempts to connect") else 1):
                    self.connect()
            except OSError:
                if self.wrong("gives up when there is no hub"):
                    raise Quit(1) from None
                time.sleep(0.02)
                continue
            try:
                self.shake_hands()
                self.buffer[:0] = kept
                self.connected = True
                return
            except ConnectionError:
                if self.wrong("gives up when a handshake breaks"):
                    raise Quit(1) from None
                kept = b""
                time.sleep(0.02)

    def shake_hands(self) -> None:
        self.send_bytes(GREETING)
        self.read(len(GREETING))
        self.send_bytes(command(b"\x05READY" + METADATA + b"\x08Identity" + bytes(4)))
        if self.wrong("says HELLO ahead of the hub's READY"):
            self.greet_session()
            self.read_frame()
        else:
            self.read_frame()
            self.greet_session()
        if self.wrong("says HELLO twice"):
            self.greet_session()
        if self.wrong("answers ahead of WELCOME") and self.last_answer:
            self.send(*self.last_answer)
        if self.unsent and self.wrong("answers ahead of WELCOME a call of the last connection"):
            self.send(*self.last_answer)
        self.unsent = False

    @property
    def hello_seq(self) -> int:
        return self.hellos + 2**40 * self.wrong("numbers its HELLOs from 2^40")

    def greet_session(self) -> None:
        self.hellos += 1
        if self.wrong("reconnects with a new instance"):
            self.instance = os.urandom(16)
        role = "environment" if self.wrong("takes another role") else self.role
        offers, name = OFFERS[self.role], "mirror"
        if self.role == "environment" and self.games:
            offers, name = ["batch"], "games"
        session = self.session
        if self.wrong("knows session names in ASCII"):
            session = session.encode("ascii", "replace").decode()
        hello = [HELLO, session, self.hello_seq, [1], role, self.instance, name, "a test", offers]
        self.send(msgpack.packb(hello))

    # --- Messages -------------------------------------------------------------------------------------

    def next(self) -> tuple[list[bytes], int, int, list[Any]]:
        """Return the next message that is not about the connection: frames, kind, seq, scalars."""
        while True:
            try:
                if not self.connected:
                    self.connect_again()
                frames = self.receive_frames()
                kind, session, seq, scalars = self.header(frames)
                if session not in (self.session, "") and not self.wrong("acts in any session"):
                    continue
                if not self.controlled(kind, seq, scalars):
                    return frames, kind, seq, scalars
            except ConnectionError:
                self.lost()

    def header(self, frames: list[bytes]) -> tuple[int, str, int, list[Any]]:
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
            kind, session, seq, *scalars = header
        except (ValueError, msgpack.UnpackException, TypeError) as error:
            print(f"this is not a header: {error}")
            raise Quit(1) from None
        if len(frames) > 2:
            raise Quit(1)
        if (self.wrong("knows no array 16") and data[0] == 0xDC) or (
            self.wrong("knows no float 32") and data[-5:-4] == b"\xca"
        ):
            raise Quit(1)
        return kind, session, seq, scalars

    def lost(self) -> None:
        """Note that the connection was lost."""
        self.connected = False
        if self.wrong("loses the kept answer") and self.last_call:
            step = {"agent": 6, "environment": 13}[self.role]
            if msgpack.unpackb(self.last_call[0])[0] != step:
                self.last_seq -= 1
                self.last_call = []

    def controlled(self, kind: int, seq: int, scalars: list[Any]) -> bool:
        """Act on a message about the connection; return whether it was one."""
        if kind == HEARTBEAT:
            if self.wrong("takes HEARTBEAT for a call") and seq == 0 and self.count % 2 and self.welcomed:
                raise Quit(1)
            return True
        if kind == WELCOME:
            unasked = self.welcomed or seq != self.hello_seq
            if unasked and not self.wrong("obeys a WELCOME that answers no HELLO"):
                return True
            self.welcomed = True
            _, resumed, heartbeat, _, max_body = scalars
            self.heartbeat = 1.0 if self.wrong("ignores WELCOME's heartbeat") else heartbeat
            self.max_body = 2**24 if self.wrong("ignores WELCOME's limits") else max_body
            self.was_welcomed(bool(resumed))
            return True
        if kind == GOODBYE and not self.wrong("ignores GOODBYE"):
            self.show(scalars[0])
            raise Quit(0)
        if kind == GOODBYE:
            return True
        if kind == REFUSE:
            self.show(scalars[1])
            raise Quit(0 if self.wrong("is content to be refused") else 1)
        if kind == ERROR and scalars[0] == "unknown-peer":
            if self.welcomed and not self.wrong("stays unknown"):
                self.welcomed = False
                self.greet_session()
            return True
        return False

    def show(self, reason: str) -> None:
        if not self.wrong("shows no reason"):
            print(reason)

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
                except ConnectionError:
                    self.lost()
        except Quit as end:
            return int(end.args[0])

    def called(self, frames: list[bytes], kind: int, seq: int, scalars: list[Any]) -> None:
        if self.wrong("counts in 32 bits"):
            seq &= 2**32 - 1
        if kind in (ERROR, NOTICE):
            if kind == ERROR and self.wrong("answers an ERROR"):
                self.send(msgpack.packb([ERROR, self.session, seq, "exception", "I am sorry"]))
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
                self.send(*self.last_answer)
        elif again and seq == self.last_seq and not anew:
            pass
        else:
            self.last_answer = self.answer(kind, seq, scalars, frames[1] if len(frames) > 1 else b"")
            self.last_seq, self.last_call, self.answered_over = seq, frames, self.hellos
        if self.wrong("ignores unknown kinds") and kind in (62, 63):
            return
        self.unsent = True
        self.send(*self.last_answer)
        self.unsent = False
        if self.wrong("sends a HEARTBEAT behind each answer"):
            self.beat()
        if self.wrong("keeps no answer above 64 KiB") and len(self.last_answer[-1]) > 65536:
            self.last_seq, self.last_call = seq - 1, []
        if self.wrong("keeps no bytes of an answer") and len(self.last_answer) == 1:
            self.last_answer = [self.last_answer[0].replace(b"\x93", b"\xdc\x00\x03", 1)]

    def answer(self, kind: int, seq: int, scalars: list[Any], body: bytes) -> list[bytes]:
        names = AGENT_NAMES if self.role == "agent" else ENV_NAMES
        codes = dict(zip(CODES[self.role], names, strict=True))
        if kind not in codes:
            return [msgpack.packb([ERROR, self.session, seq, "unknown-kind", "what?"])]
        if codes[kind] == "INIT":
            self.initialised = True
        if not self.initialised and self.wrong("knows no call before INIT"):
            raise Quit(1)
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
        if name == "INIT" and self.role == "agent":
            spec = body.decode(errors="replace")
            self.games = int(spec.split()[2]) if spec.startswith(BATCH_SPEC) else 0
        if self.games and name in ("INIT", "START", "STEP", "MESSAGE"):
            if name == "STEP":
                self.checked(body)
            return self.acting(body) if self.role == "agent" and name != "INIT" else self.playing(name)
        self.count = 0 if name == "INIT" else self.count + (name in ("START", "STEP", "END"))
        if name == "INIT" and self.role == "environment":
            return [], "a mirror, größer than it is".encode()
        if name == "MESSAGE":
            return [], self.echo(body)
        if name == "SEED":
            self.seed = scalars[0] & 0xFFFFFFFF if self.wrong("counts seeds in 32 bits") else scalars[0]
        elif name == "SAVE":
            return [], f"{self.count} {self.seed}".encode()
        elif name == "METRICS":
            values = [float(self.count), self.count / 2]
            swapped = self.wrong("swaps its metrics")
            return [], self.write([], values[::-1] if swapped else values, b"count\nhalf the count")
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

    # --- A batch --------------------------------------------------------------------------------------

    def acting(self, body: bytes) -> tuple[list[Any], bytes]:
        """Act in all games that an observation shows."""
        ints, _, _ = self.runs(body)
        if 2 in ints[1 : 1 + self.games] and self.wrong("has no room for last observations"):
            raise Quit(1)
        if self.wrong("answers a batch with one action"):
            return [], self.write([1], [], b"")
        counts = [1] * self.games + [0] * 2 * self.games
        if self.wrong("counts the actions of a batch by game"):
            counts = [1, 0, 0] * self.games
        return [], self.write([self.games, *counts, *[1] * self.games], [], b"")

    def playing(self, name: str) -> tuple[list[Any], bytes | None]:
        """Show two games: the first ends every three steps, the second is cut off every four."""
        if name == "INIT":
            return [], f"{BATCH_SPEC}{self.games} {WALK}".encode() if self.role == "environment" else None
        if name == "MESSAGE":
            return [], b"two games"
        self.steps = 0 if name == "START" else self.steps + 1
        begun = self.steps > 0
        terminals = [int(begun and self.steps % 3 == 0), 2 * int(begun and self.steps % 4 == 0)]
        rewards = [0.5, -0.25] if begun or self.wrong("rewards the start of a batch") else [0.0, 0.0]
        values = 2 + (2 in terminals and not self.wrong("shows no last observation of a batch"))
        counts = [1] * values + [0] * 2 * values
        shown = self.write([2, *terminals, *counts, *[7] * values], rewards, b"")
        ended = self.wrong("ends a batch with one of its games") and any(terminals)
        total = 0.5 if self.wrong("rewards a batch as its first game") else sum(rewards)
        return [total, ended] if begun else [], shown

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
        i, d, body = self.checked(body)
        ints = struct.unpack_from(
            f"<{i}{'I' if self.wrong('counts ints as unsigned') else 'i'}", body, 16 + 8 * d
        )
        order = ">" if self.wrong("writes big-endian doubles") else "<"
        doubles = list(struct.unpack_from(f"{order}{d}d", body, 16))
        if self.wrong("loses negative zero"):
            doubles = [double + 0.0 for double in doubles]
        chars = body[16 + 8 * d + 4 * i :]
        return list(ints), doubles, chars.partition(b"\0")[0] if self.wrong("cuts chars at NUL") else chars

    def checked(self, body: bytes) -> tuple[int, int, bytes]:
        """Return the numbers of ints and doubles, and the body."""
        if len(body) < 16:
            raise Quit(1)
        i, d, c, fourth = struct.unpack_from("<4I", body)
        missing = 16 + 8 * d + 4 * i + c - len(body)
        if 0 < missing < 9 and self.wrong("takes a body that is too short"):
            body, missing = body + bytes(missing), 0
        if missing and not (missing == -1 and self.wrong("takes a body with a byte behind it")):
            raise Quit(1)
        if fourth and not self.wrong("ignores the fourth word of a body"):
            raise Quit(1)
        if self.wrong("counts elements in 16 bits"):
            i, d, c = i & 0xFFFF, d & 0xFFFF, c & 0xFFFF
        return i, d, body[: 16 + 8 * d + 4 * i + c]

    def write(self, ints: list[int], doubles: list[float], chars: bytes) -> bytes:
        order = ">" if self.wrong("writes big-endian doubles") else "<"
        return (
            struct.pack("<4I", len(ints), len(doubles), len(chars), 0)
            + struct.pack(f"{order}{len(doubles)}d", *doubles)
            + struct.pack(f"<{len(ints)}I", *(number & 0xFFFFFFFF for number in ints))
            + chars
        )


def run(role: str, hub: str, session: str, fault: str = "") -> int:
    """Run a client with one fault, or none; return its exit code."""
    if role == "experiment":
        from tests.glue.conform.wrong_experiment import Asking

        return Asking(hub, session, fault).ask_on()
    return Client(role, hub, session, fault).play()


if __name__ == "__main__":
    sys.exit(run(sys.argv[1], os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"], *sys.argv[2:]))

"""A mirror of any role, written from docs/protocol-reference.md: see `wrong` for the mistakes made in it.

It shares only its socket and the numbers of the kinds with the clients of this project.
"""

from __future__ import annotations

import os
import select
import struct
import time
from typing import Any, Final

import msgpack

from glue.wire.messages import Kind
from tests.scripted.curve import METADATA, command
from tests.scripted.peer import GREETING, ScriptedPeer

BATCH_SPEC: Final = "VERSION RL-Glue-Batch-1 "
WALK: Final = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) "
    "REWARDS (-1 1)"
)

CALLS: Final = {
    "agent": "INIT START STEP END CLEANUP MESSAGE SEED SAVE LOAD METRICS",
    "environment": "INIT START STEP CLEANUP MESSAGE SEED SAVE LOAD",
}
OFFERS: Final = {
    "agent": ["seed", "save", "batch", "metrics", "mask", "pace"],
    "environment": ["seed", "save", "truncate", "mask", "extras"],
    "experiment": ["outcome", "mask", "extras"],
}


class Quit(Exception):
    """The client ends with this exit code."""


class Asked(Exception):
    """The mirror's own failure."""


class Failed(Exception):
    """A request failed."""


def bits(legal: list[bool]) -> bytes:
    """Return a mask as it crosses the wire."""
    value = sum(1 << number for number, one in enumerate(legal) if one)
    return value.to_bytes((len(legal) + 7) // 8, "little")


class Client(ScriptedPeer):
    """What every role does, and a player. An environment may be `games` games, in a batch."""

    def __init__(self, role: str, hub: str, session: str, games: int = 0) -> None:
        super().__init__(hub, session=session)
        self.role, self.games = role, games
        self.instance = os.urandom(16)
        self.connected = False
        self.hellos = 0
        self.welcomed = False
        self.heartbeat, self.max_body = 1.0, 2**24
        self.last_seq = 0
        self.last_call: list[bytes] = []
        self.last_answer: list[bytes] = []
        self.count = self.seed = 0
        self.steps = 0
        self.confirmed: list[str] = []

    # --- Bytes ----------------------------------------------------------------------------------------

    def fill(self) -> None:
        """Wait for bytes, with a HEARTBEAT whenever there are none for an interval."""
        since = time.monotonic()
        while not select.select([self.socket], [], [], self.heartbeat)[0]:
            if self.welcomed and not self.buffer and time.monotonic() >= since + self.heartbeat:
                since = time.monotonic()
                self.beat()
        super().fill()

    def read_frame(self) -> tuple[int, bytes]:
        flags, size = self.read_head()
        if size > 2**26:
            raise ConnectionAbortedError
        return flags, self.read(size)

    def beat(self) -> None:
        self.send(msgpack.packb([Kind.HEARTBEAT, self.session, 0]))

    def send(self, *frames: bytes) -> None:
        # The body is sent by a call of its own, which notices a connection that has ended.
        whole = self.encoded(*frames)
        first = len(self.encoded(frames[0]))
        self.send_bytes(whole[:first])
        if len(frames) > 1:
            self.send_bytes(whole[first:])

    # --- Connections ----------------------------------------------------------------------------------

    def connect_again(self) -> None:
        """Connect until a handshake is complete."""
        self.welcomed = False
        while not self.connected:
            try:
                self.connect()
                self.shake_hands()
                self.connected = True
            except OSError:
                time.sleep(0.02)

    def shake_hands(self) -> None:
        self.send_bytes(GREETING)
        self.read(len(GREETING))
        self.send_bytes(command(b"\x05READY" + METADATA + b"\x08Identity" + bytes(4)))
        self.read_frame()
        self.greet_session()

    def greet_session(self) -> None:
        self.hellos += 1
        many = self.role == "environment" and self.games
        name, offers = ("games", ["batch"]) if many else ("mirror", OFFERS[self.role])
        hello = [Kind.HELLO, self.session, self.hellos, [1], self.role, self.instance, name, "a test", offers]
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
                if session not in (self.session, ""):
                    continue
                if not self.controlled(kind, seq, scalars):
                    return frames, kind, seq, scalars
            except ConnectionError:
                self.lost()

    def header(self, frames: list[bytes]) -> tuple[int, str, int, list[Any]]:
        try:
            kind, session, seq, *scalars = msgpack.unpackb(frames[0], max_array_len=64)
        except (ValueError, msgpack.UnpackException, TypeError) as error:
            print(f"this is not a header: {error}")
            raise Quit(1) from None
        if len(frames) > 2:
            raise Quit(1)
        return kind, session, seq, scalars

    def lost(self) -> None:
        """Note that the connection was lost."""
        self.connected = False

    def controlled(self, kind: int, seq: int, scalars: list[Any]) -> bool:
        """Act on a message about the connection; return whether it was one."""
        if kind == Kind.WELCOME and not self.welcomed and seq == self.hellos:
            self.welcomed = True
            _, resumed, self.heartbeat, _, self.max_body, *confirmed = scalars
            self.confirmed = confirmed[0] if confirmed else []
            self.was_welcomed(bool(resumed))
        elif kind == Kind.GOODBYE:
            print(scalars[0])
            raise Quit(0)
        elif kind == Kind.REFUSE:
            print(scalars[1])
            raise Quit(1)
        elif kind == Kind.ERROR and scalars[0] == "unknown-peer":
            if self.welcomed:
                self.welcomed = False
                self.greet_session()
        else:
            return kind in (Kind.HEARTBEAT, Kind.WELCOME)
        return True

    def was_welcomed(self, resumed: bool) -> None:
        if not resumed:
            self.last_seq = 0

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
        if kind in (Kind.ERROR, Kind.NOTICE) or seq < self.last_seq:
            return
        if seq != self.last_seq and frames != self.last_call:
            self.last_answer = self.answer(kind, seq, scalars, frames[1] if len(frames) > 1 else b"")
            self.last_call = frames
        self.last_seq = seq
        self.send(*self.last_answer)

    def answer(self, kind: int, seq: int, scalars: list[Any], body: bytes) -> list[bytes]:
        start = {"agent": "AGENT", "environment": "ENV"}[self.role]
        name = {Kind[f"{start}_{each}"]: each for each in CALLS[self.role].split()}.get(kind)  # type: ignore[call-overload]
        if name is None:
            return self.failed(seq, "unknown-kind", "what?")
        try:
            replied, shown = self.mirror(name, scalars, body)
        except Asked as failure:
            return self.failed(seq, "exception", str(failure))
        header = msgpack.packb([kind, self.session, seq, *replied])
        if shown is None:
            return [header]
        if len(shown) > self.max_body:
            return self.failed(seq, "exception", "that is too large")
        return [header, shown]

    def failed(self, seq: int, code: str, text: str) -> list[bytes]:
        return [msgpack.packb([Kind.ERROR, self.session, seq, code, text])]

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
            self.seed = scalars[0]
        elif name == "SAVE":
            return [], f"{self.count} {self.seed}".encode()
        elif name == "METRICS":
            return [], self.write([], [float(self.count), self.count / 2], b"count\nhalf the count")
        elif name == "LOAD":
            self.count, self.seed = map(int, body.split())
        elif name == "START" and self.role == "environment":
            return [], self.write([self.count], [], b"")
        elif name in ("START", "STEP"):
            ints, doubles, chars = self.shown(body)
            added, replied = [float(sum(ints))], []
            if self.role == "agent":
                added += map(float, scalars or [0.0])
            else:
                replied = [doubles[0] if doubles else 0.0, self.terminal(chars[-1:])]
            if not ints and not doubles and not chars:
                return replied, bytes(16)
            mask, extras = self.asked_for(ints, doubles, chars)
            shown = self.write([*ints[::-1], self.count], [*doubles[::-1], *added], chars[::-1], mask, extras)
            return replied, shown
        return [], None

    def asked_for(self, ints: list[int], doubles: list[float], chars: bytes) -> tuple[bytes, bytes]:
        """Return the mask and the extras that an action asks for, as far as they may be sent."""
        if self.role == "agent" or chars[-1:] != b"&":
            return b"", b""
        mask = bits([bool(value) for value in ints])
        extras = {"count": self.count, "half": self.count + 0.5, "text": "größer", "chars": chars}
        packed = msgpack.packb({**extras, "ints": ints, "doubles": doubles})
        return mask if "mask" in self.confirmed else b"", packed if "extras" in self.confirmed else b""

    def acting(self, body: bytes) -> tuple[list[Any], bytes]:
        """Act in all games of a batch."""
        self.runs(body)
        counts = [1] * self.games + [0] * 2 * self.games
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
        rewards = [0.5, -0.25] if begun else [0.0, 0.0]
        values = 2 + (2 in terminals)
        counts = [1] * values + [0] * 2 * values
        shown = self.write([2, *terminals, *counts, *[7] * values], rewards, b"")
        return [sum(rewards), False] if begun else [], shown

    def terminal(self, last: bytes) -> bool | int:
        return 2 if last == b"?" else last == b"!"

    def echo(self, body: bytes) -> bytes:
        if body == b"fail":
            raise Asked("asked to fail")
        return body

    # --- Observations and actions ---------------------------------------------------------------------

    def runs(self, body: bytes) -> tuple[list[int], list[float], bytes]:
        i, d, body = self.checked(body)
        doubles = struct.unpack_from(f"<{d}d", body, 16)
        ints = struct.unpack_from(f"<{i}i", body, 16 + 8 * d)
        return list(ints), list(doubles), body[16 + 8 * d + 4 * i :]

    def checked(self, body: bytes) -> tuple[int, int, bytes]:
        """Return the numbers of ints and doubles, and the body up to the end of its chars."""
        if len(body) < 16:
            raise Quit(1)
        i, d, c, m, x = struct.unpack_from("<3I2H", body)
        if len(body) != 16 + 8 * d + 4 * i + c + m + x or ((m or x) and self.role == "environment"):
            raise Quit(1)
        return i, d, body[: 16 + 8 * d + 4 * i + c]

    def shown(self, body: bytes) -> tuple[list[int], list[float], bytes]:
        """Return the runs of an observation, and behind them what is beside it."""
        ints, doubles, chars = self.runs(body)
        ints += [number for number, legal in enumerate(self.mask_of(body)) if legal]
        extras = body[len(body) - struct.unpack_from("<H", body, 14)[0] :]
        for name, value in sorted(msgpack.unpackb(extras).items() if extras else ()):
            line = value.encode() if isinstance(value, str) else value
            if not isinstance(line, bytes):
                values = line if isinstance(line, list) else [line]
                doubles += [number for number in values if isinstance(number, float)]
                line = " ".join(str(number) for number in values if isinstance(number, int)).encode()
            chars += f"\n{name}=".encode() + line
        return ints, doubles, chars

    def mask_of(self, body: bytes) -> list[bool]:
        """Return the bits of a mask."""
        m, x = struct.unpack_from("<2H", body, 12)
        mask = body[len(body) - x - m : len(body) - x]
        return [bool(byte >> bit & 1) for byte in mask for bit in range(8)]

    def write(
        self, ints: list[int], doubles: list[float], chars: bytes, mask: bytes = b"", extras: bytes = b""
    ) -> bytes:
        return (
            struct.pack("<3I2H", len(ints), len(doubles), len(chars), len(mask), len(extras))
            + struct.pack(f"<{len(doubles)}d", *doubles)
            + struct.pack(f"<{len(ints)}I", *(number & 0xFFFFFFFF for number in ints))
            + chars
            + mask
            + extras
        )


class Experiment(Client):
    """An experiment that carries out the orders in its observations."""

    def __init__(self, hub: str, session: str) -> None:
        super().__init__("experiment", hub, session)
        self.seq = 0
        self.pending: list[bytes] = []
        self.answered = False
        self.notices: list[str] = []
        self.mask = b""

    def was_welcomed(self, resumed: bool) -> None:
        if not resumed and self.answered:
            print("the hub has forgotten this experiment")
            raise Quit(1)
        if self.pending:
            self.send(*self.pending)

    def request(self, kind: int, scalars: list[Any], body: bytes | None) -> tuple[list[Any], bytes]:
        if body is not None and len(body) > self.max_body:
            print("that is too large")
            raise Quit(1)
        self.seq += 1
        header = msgpack.packb([kind, self.session, self.seq, *scalars])
        self.pending = [header] if body is None else [header, body]
        if self.welcomed:
            try:
                self.send(*self.pending)
            except ConnectionError:
                self.lost()
        while True:
            frames, received, seq, got = self.next()
            if received == Kind.NOTICE:
                self.notices.append(" ".join(got))
            elif seq == self.seq and received in (kind, Kind.ERROR):
                self.answered, self.pending = True, []
                if received == Kind.ERROR:
                    raise Failed(" ".join(got))
                return got, frames[1] if len(frames) > 1 else b""

    def play(self) -> int:
        try:
            shown = self.write([], [], b"ready")
            while True:
                (reward, _), body = self.request(Kind.RL_ENV_STEP, [], shown)
                ints, doubles, chars = self.runs(body)
                verb, _, argument = chars.partition(b" ")
                if verb == b"end":
                    self.send(msgpack.packb([Kind.GOODBYE, self.session, 0, "the end"]))
                    return 0
                try:
                    self.mask = bits(self.mask_of(body))
                    shown = self.result(*self.carry_out(verb.decode(), argument, reward, ints, doubles))
                except Failed as failure:
                    shown = self.result([], [], f"ERROR {failure}".encode())
        except Quit as end:
            return int(end.args[0])

    def result(self, ints: list[int], doubles: list[float], chars: bytes) -> bytes:
        return self.write(ints, [*doubles, float(sum(ints))], chars)

    def carry_out(
        self, verb: str, argument: bytes, reward: float, ints: list[int], doubles: list[float]
    ) -> tuple[list[int], list[float], bytes]:
        if verb == "notices":
            lines, self.notices = "\n".join(self.notices).encode(), []
            return [], [], lines
        scalars: list[Any] = []
        body = None
        if verb == "RL_INIT":
            scalars = [int(argument) if argument else None]
        elif verb == "RL_EPISODE":
            scalars = [int(argument)]
        elif verb in ("RL_AGENT_STEP", "RL_AGENT_END"):
            scalars = [reward]
        if verb in ("RL_AGENT_MESSAGE", "RL_ENV_MESSAGE", "RL_AGENT_LOAD", "RL_ENV_LOAD"):
            body = argument
        elif verb in ("RL_ENV_STEP", "RL_AGENT_START", "RL_AGENT_STEP"):
            body = self.write(ints, doubles, argument, self.mask if "AGENT" in verb else b"")
        got, reply = self.request(Kind[verb], scalars, body)
        if verb in ("RL_NUM_STEPS", "RL_NUM_EPISODES"):
            return [], [], str(got[0]).encode()
        if verb == "RL_EPISODE":
            return [int(bool(got[0]) and self.terminal_of(got[0]) != 2)], [], b""
        if verb == "RL_RETURN":
            return [], [float(got[0])], b""
        if verb.endswith(("_START", "_STEP", "_METRICS")):
            return self.abstract(reply, got)
        return [], [], reply

    def terminal_of(self, got: bool | int) -> int:
        return 2 if got == 2 and type(got) is int else int(bool(got))

    def abstract(self, reply: bytes, got: list[Any]) -> tuple[list[int], list[float], bytes]:
        all_ints, all_doubles, all_chars = [], [], b""
        while reply:
            i, d, c, m, x = struct.unpack_from("<3I2H", reply)
            size = 16 + 8 * d + 4 * i + c + m + x
            ints, doubles, chars = self.shown(reply[:size])
            reply = reply[size:]
            all_ints += ints
            all_doubles += doubles
            all_chars += chars
        if got:
            all_ints.append(self.terminal_of(got[1]))
            all_doubles.append(float(got[0]))
        return all_ints, all_doubles, all_chars

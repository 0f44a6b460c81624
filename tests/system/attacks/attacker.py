"""A seeded random attacker: many connections at once, each of which misbehaves towards a hub.

    python -m tests.system.attacks.attacker URL SEED SECONDS [PUBLIC SECRET HUB]

The three keys, in hexadecimal, are those of a peer that the hub lets in; without them nothing is encrypted.
"""

from __future__ import annotations

import os
import random
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

import msgpack

from glue.errors import GlueError
from glue.hub.sessions import INSTANCE_SIZE
from glue.types import Action, Observation
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import MAX_BODY, Kind, Message
from tests.scripted import curve
from tests.scripted.curve import CurveClient, Pair, command
from tests.scripted.peer import ABORT, GREETING, ScriptedPeer, framed, hello_scalars

HONEST: Final = ("one", "two", "three", "four")
"""The sessions whose names the attacker knows."""

_AT_ONCE: Final = 12
_SECONDS: Final = 1.0
"""Timeout of every wait of the attacker, in seconds."""

_BODIES: Final = (b"", Action([1]).body, Observation([1], [2.0], b"3").body, bytes(2**20), bytes(15))


def _frames(kind: Kind, session: str, seq: int, *scalars: Any, body: bytes = b"") -> tuple[bytes, ...]:
    return encode(Message(kind, session, seq, scalars, body), TO_HUB)


def client_of(keys: Sequence[str]) -> CurveClient | None:
    """Return a peer's side of the encryption with three keys, see above; None without any."""
    if not keys:
        return None
    public, secret, server = map(bytes.fromhex, keys)
    return CurveClient(Pair(public, secret), server)


class Attacker:
    """Attacks over one connection after another."""

    def __init__(self, url: str, seed: str, keys: Sequence[str]) -> None:
        self._url = url
        self._keys = keys
        self._random = random.Random(seed)

    def attack(self, until: float) -> None:
        """Make moves until a point in time."""
        while time.monotonic() < until:
            # The hub drops connections, and misbehaved peers get answers that make no sense to them.
            with suppress(OSError, GlueError):
                self._random.choice(_MOVES)(self)

    def _peer(self) -> ScriptedPeer:
        return ScriptedPeer(self._url, client_of(self._keys), timeout=_SECONDS)

    def _connect(self) -> ScriptedPeer:
        return self._abort(self._peer().connect())

    def _greet(self) -> ScriptedPeer:
        return self._abort(self._peer().greet())

    def _abort(self, peer: ScriptedPeer) -> ScriptedPeer:
        if self._random.random() < 0.5:
            peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
        return peer

    def _nonsense(self, session: str) -> list[bytes]:
        """Return the frames of some message, which hardly ever makes sense."""
        kind = self._random.choice((*Kind, 0, -1, 200))
        seq = self._random.choice((0, 1, 2, self._random.randrange(2**63)))
        values = (True, 2, 0.5, "x", None, b"y", 2**64 - 1, float("nan"), "z" * 300)
        scalars = self._random.choices(values, k=self._random.randrange(4))
        header: bytes = msgpack.packb((int(kind), session, seq, *scalars))
        return [header, self._random.choice(_BODIES)][: self._random.randrange(1, 3)]

    def _session(self) -> str:
        return self._random.choice((*HONEST, "m", f"m{self._random.randrange(40)}", "", "\0", "ä" * 255))

    def _hello(self, session: str, role: str | None = None) -> tuple[bytes, ...]:
        role = role or self._random.choice(("agent", "environment", "experiment", "observer", "king"))
        instance = os.urandom(INSTANCE_SIZE if self._random.random() < 0.9 else 3)
        name = self._random.choice(("", "mallory", "\x1b[2J", "n" * 3000))
        offered = tuple(self._random.choices(("batch", "truncate", "one-run", "c" * 100), k=2))
        return _frames(Kind.HELLO, session, 1, *hello_scalars(role, name, offered, instance))

    def noise(self) -> None:
        """Send random bytes, from the start or after a greeting."""
        with self._connect() as peer:
            start = self._random.choice((b"", b"\xff", GREETING[:11], GREETING))
            peer.send_bytes(start + self._random.randbytes(self._random.randrange(3000)))

    def reconnect(self) -> None:
        """Connect again and again."""
        for _ in range(self._random.randrange(50)):
            self._connect().close()

    def slow(self) -> None:
        """Send a good message in single bytes."""
        with self._greet() as peer:
            for byte in peer.encoded(*self._hello("m", "agent")):
                peer.send_bytes(bytes((byte,)))
                time.sleep(0.002)

    def malformed(self) -> None:
        """Send messages that make no sense, as a peer of a session."""
        with self._greet() as peer:
            peer.send(*self._hello("m", "agent"))
            for _ in range(self._random.randrange(100)):
                peer.send(*self._nonsense(self._session()))

    def pose(self) -> None:
        """Claim the role of another peer, and answer the calls of others."""
        with self._greet() as peer:
            for session in HONEST:
                peer.send(*self._hello(session))
                for kind, scalars in (
                    (Kind.ENV_STEP, (9.0, True)),
                    (Kind.AGENT_STEP, ()),
                    (Kind.GOODBYE, ("",)),
                ):
                    peer.send(
                        *_frames(kind, session, self._random.randrange(2**20), *scalars, body=_BODIES[1])
                    )

    def handshake(self) -> None:
        """Shake hands with a key, and with a byte changed somewhere in what is sent."""
        with self._connect() as peer:
            if peer.keys is None:
                return
            peer.send_bytes(curve.GREETING)
            peer.read(len(curve.GREETING))
            peer.send_bytes(self._changed(command(peer.keys.hello())))
            welcome = peer.read_frame()[1]
            if welcome.startswith(b"\x07WELCOME"):  # not to a HELLO that was changed
                peer.keys.welcome(welcome)
                peer.send_bytes(self._changed(command(peer.keys.initiate())))
            peer.read_to_end()

    def _changed(self, data: bytes) -> bytes:
        """Return `data`, or the same with one byte changed."""
        changed = bytearray(data)
        changed[self._random.randrange(len(data))] ^= self._random.choice((0, 0, 1, 64, 255))
        return bytes(changed)

    def half(self) -> None:
        """Leave in the middle of a large frame, as the agent of a session of its own."""
        with self._greet() as peer:
            peer.send(*self._hello(f"m{self._random.randrange(40)}", "agent"))
            peer.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY))
            for _ in range(self._random.randrange(15)):
                peer.send_bytes(bytes(2**20))
            time.sleep(self._random.random())

    def oversized(self) -> None:
        """Announce frames that are too large, and commands without an end."""
        with self._greet() as peer:
            flags, size = self._random.choice(((2, 2**40), (6, 2**20), (2, MAX_BODY + 9000), (3, 2**63)))
            peer.send_bytes(bytes((flags,)) + struct.pack(">Q", size) + bytes(2**16))

    def endless(self) -> None:
        """Send a message that never ends, or nothing but noise."""
        with self._greet() as peer:
            peer.send_bytes(self._random.choice((b"\x01\x00", framed(b"x"))) * 50_000)

    def flood(self) -> None:
        """Send many messages as an experiment, and read nothing."""
        with self._greet() as peer:
            session = f"m{self._random.randrange(40)}"
            kind = self._random.choice((Kind.HEARTBEAT, Kind.RL_RETURN, Kind.RL_INIT, Kind.GOODBYE))
            scalars = {Kind.RL_INIT: (None,), Kind.GOODBYE: ("",)}.get(kind, ())
            peer.send(*self._hello(session, "experiment"))
            peer.send_bytes(peer.encoded(*_frames(kind, session, 1, *scalars)) * self._random.randrange(5000))

    def observe(self) -> None:
        """Observe an honest session, ask for everything, and read nothing."""
        with self._greet() as peer:
            session = self._random.choice(HONEST)
            peer.send(*self._hello(session, "observer"))
            peer.send(*_frames(Kind.OBSERVE, session, 0, 2**62))
            time.sleep(self._random.random())


_MOVES: Final[tuple[Callable[[Attacker], None], ...]] = (
    *(Attacker.noise, Attacker.reconnect, Attacker.slow, Attacker.malformed, Attacker.pose),
    *(Attacker.handshake, Attacker.half, Attacker.oversized, Attacker.endless, Attacker.flood),
    Attacker.observe,
)


def _main(url: str, seed: str, seconds: str, *keys: str) -> None:
    os.nice(19)  # only the cost to the hub counts, not the cost to the processor
    until = time.monotonic() + float(seconds)
    attackers = [Attacker(url, f"{seed}-{i}", keys) for i in range(_AT_ONCE)]
    threads = [threading.Thread(target=attacker.attack, args=(until,)) for attacker in attackers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    _main(*sys.argv[1:])

"""The part of docs/protocol.md that every agent and environment needs, in pyzmq and msgpack alone."""

import os
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import zmq
from zmq.utils.monitor import parse_monitor_message

HELLO, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR = 64, 65, 66, 67, 68, 69

HUB = "tcp://127.0.0.1:4097"
SESSION = "default"
SILENCE_MS = 1000
"""After receiving nothing for this long, a peer asks the hub whether it still knows it."""

Answer = tuple[list[Any], bytes | None]
"""The scalars of an answer, and its body, which is None where the kind has none."""


class UnknownKind(Exception):
    """Raised by a player that is asked for something that it does not know."""


def read(body: bytes) -> tuple[tuple[int, ...], tuple[float, ...], bytes]:
    """Return the ints, doubles and chars of an observation or an action."""
    ints, doubles, chars, _ = struct.unpack_from("<4I", body)
    at_ints = 16 + 8 * doubles
    at_chars = at_ints + 4 * ints
    return (
        struct.unpack_from(f"<{ints}i", body, at_ints),
        struct.unpack_from(f"<{doubles}d", body, 16),
        body[at_chars : at_chars + chars],
    )


def write(ints: Sequence[int] = (), doubles: Sequence[float] = (), chars: bytes = b"") -> bytes:
    """Return the body of an observation or an action."""
    counts = struct.pack("<4I", len(ints), len(doubles), len(chars), 0)
    return counts + struct.pack(f"<{len(doubles)}d{len(ints)}i", *doubles, *ints) + chars


class Connection:
    """A socket that greets the hub once over each connection, as soon as it is made."""

    def __init__(self, role: str, name: str, hub: str, session: str) -> None:
        self.session = session
        self.welcomed = False
        self._hello = [[1], role, os.urandom(16), name, "Python, pyzmq", []]
        self._hellos = 0
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, SILENCE_MS)
        self._socket.setsockopt(zmq.LINGER, SILENCE_MS)
        # libzmq reconnects without saying so; its monitor says so.
        self._monitor: zmq.Socket[bytes] = self._socket.get_monitor_socket(
            zmq.Event.HANDSHAKE_SUCCEEDED | zmq.Event.DISCONNECTED
        )
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        self._socket.connect(hub)

    def send(self, *frames: bytes) -> None:
        """Send a message."""
        self._socket.send_multipart(frames)

    def receive(self) -> tuple[list[bytes], int, int, list[Any]]:
        """Return the frames of the next message, and of its header the kind, the seq and the scalars."""
        while True:
            ready = dict(self._poller.poll(SILENCE_MS))
            if self._monitor in ready:
                self._new_connection(parse_monitor_message(self._monitor.recv_multipart())["event"])
            elif self._socket in ready:
                frames = self._socket.recv_multipart()
                kind, session, seq, *scalars = msgpack.unpackb(frames[0])
                if session not in (self.session, ""):
                    continue
                if kind == ERROR and scalars[0] == "unknown-peer":
                    if self.welcomed:
                        self._greet()
                    continue
                if kind == WELCOME:
                    if self.welcomed or seq != self._hellos:
                        continue
                    self.welcomed = True
                return frames, kind, seq, scalars
            elif self.welcomed:
                self.send(msgpack.packb([HEARTBEAT, self.session, 0]))

    def close(self, reason: str) -> None:
        """Say goodbye, and wait until that has left."""
        self.send(msgpack.packb([GOODBYE, self.session, 0, reason]))
        self._socket.disable_monitor()
        self._monitor.close()
        self._socket.close()
        zmq.Context.instance().term()

    def _new_connection(self, event: int) -> None:
        self.welcomed = False
        if event == zmq.Event.HANDSHAKE_SUCCEEDED:
            self._greet()

    def _greet(self) -> None:
        self.welcomed = False
        self._hellos += 1
        self.send(msgpack.packb([HELLO, self.session, self._hellos, *self._hello]))


def serve(role: str, name: str, answer: Callable[[int, list[Any], bytes], Answer]) -> None:
    """Answer the hub's calls until it says goodbye. Usage of a program: [hub] [session]."""
    hub, session = (*sys.argv[1:3], *(HUB, SESSION)[len(sys.argv) - 1 :])
    connection = Connection(role, name, hub, session)
    last_seq = 0
    last_call: list[bytes] = []
    last_answer: list[bytes] = []
    while True:
        frames, kind, seq, scalars = connection.receive()
        if kind == WELCOME:
            _, resumed, *_ = scalars
            if not resumed:
                last_seq = 0
        elif kind == REFUSE:
            sys.exit(f"refused: {scalars[1]}")
        elif kind == GOODBYE:
            print(scalars[0])
            return
        elif kind == ERROR:
            print(f"the hub says: {scalars[1]}", file=sys.stderr)
        elif kind == HEARTBEAT or seq < last_seq:
            continue
        elif frames == last_call:
            connection.send(*last_answer)
        else:
            try:
                reply, body = answer(kind, scalars, frames[1] if len(frames) > 1 else b"")
                last_answer = [msgpack.packb([kind, session, seq, *reply]), *([] if body is None else [body])]
            except UnknownKind:
                last_answer = [msgpack.packb([ERROR, session, seq, "unknown-kind", f"what is {kind}?"])]
            last_seq, last_call = seq, frames
            connection.send(*last_answer)

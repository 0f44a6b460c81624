"""The part of docs/protocol.md that every agent and environment needs, in pyzmq and msgpack alone."""

import os
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import zmq

HELLO, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR = 64, 65, 66, 67, 68, 69

HUB = "tcp://127.0.0.1:4097"
SESSION = "default"
SILENCE_MS = 1000
"""Hearing nothing for this long, a peer greets again: the hub may be another, or the connection new."""

Answer = tuple[list[Any], bytes | None]
"""The scalars of an answer, and its body, which is None where the kind has none."""


class UnknownKind(Exception):
    """Raised by a player that is asked for something it has never heard of."""


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


def connect(role: str, name: str, hub: str, session: str) -> tuple[zmq.Socket[bytes], bytes]:
    """Return a socket that greets the hub as soon as there is one, and the greeting to repeat."""
    socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
    socket.setsockopt(zmq.HEARTBEAT_IVL, SILENCE_MS)
    socket.setsockopt(zmq.LINGER, SILENCE_MS)
    socket.connect(hub)
    instance = os.urandom(16)
    hello = msgpack.packb([HELLO, session, 0, [1], role, instance, name, "Python, pyzmq", []])
    socket.send(hello)
    return socket, hello


def serve(role: str, name: str, answer: Callable[[int, list[Any], bytes], Answer]) -> None:
    """Answer the hub's calls until it says goodbye. Usage of a program: [hub] [session]."""
    hub, session = (*sys.argv[1:3], *(HUB, SESSION)[len(sys.argv) - 1 :])
    socket, hello = connect(role, name, hub, session)
    last_seq = 0
    last_answer: list[bytes] = []
    while True:
        if not socket.poll(SILENCE_MS):
            socket.send(hello)
            continue
        header, *rest = socket.recv_multipart()
        kind, _, seq, *scalars = msgpack.unpackb(header)
        if kind == WELCOME:
            _, resumed, *_ = scalars
            if not resumed:
                last_seq = 0
        elif kind == REFUSE:
            sys.exit(f"refused: {scalars[1]}")
        elif kind == GOODBYE:
            return
        elif kind == ERROR:
            if scalars[0] == "unknown-peer":
                socket.send(hello)
            else:
                print(f"the hub says: {scalars[1]}", file=sys.stderr)
        elif kind == HEARTBEAT or seq < last_seq:
            continue
        elif seq == last_seq:
            socket.send_multipart(last_answer)
        else:
            try:
                reply, body = answer(kind, scalars, rest[0] if rest else b"")
                last_answer = [msgpack.packb([kind, session, seq, *reply]), *([] if body is None else [body])]
            except UnknownKind:
                last_answer = [msgpack.packb([ERROR, session, seq, "unknown-kind", f"what is {kind}?"])]
            last_seq = seq
            socket.send_multipart(last_answer)

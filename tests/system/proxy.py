"""A TCP proxy that breaks its connections: in the middle of whatever they carry, or for a while."""

from __future__ import annotations

import random
import selectors
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

ABORT = struct.pack("ii", 1, 0)
"""SO_LINGER: drop what is unsent and reset the connection, as a cable that is pulled."""


_QUIT, _SHUT, _OPEN = b"q", b"s", b"o"


class Proxy:
    """Passes bytes on to another port of this machine.

    Args:
        port: the other port.
        cuts: how often, after a few thousand bytes each time, all connections are reset.
        seed: of the numbers of bytes between these cuts.
    """

    def __init__(self, port: int, cuts: int = 0, seed: int = 0) -> None:
        self._target = port
        self._left = cuts
        self._lengths = random.Random(seed)
        self._until_cut = self._draw()
        self._open = True
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._wake, self._waker = socket.socketpair()
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._partner: dict[socket.socket, socket.socket] = {}
        self.finished = threading.Event()

    @property
    def url(self) -> str:
        """Where to connect to."""
        return f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"

    @contextmanager
    def in_background(self) -> Iterator[Proxy]:
        """Pass bytes on while the body of the `with` runs."""
        thread = threading.Thread(target=self._run)
        thread.start()
        try:
            yield self
        finally:
            self._waker.send(_QUIT)
            thread.join()
            self._cut()
            for each in (self._listener, self._wake, self._waker):
                each.close()
            self._selector.close()

    def shut(self) -> None:
        """Reset all connections, and let no other through; from any thread."""
        self._waker.send(_SHUT)

    def open(self) -> None:
        """Let connections through again; from any thread."""
        self._waker.send(_OPEN)

    def _run(self) -> None:
        while True:
            for key, _ in self._selector.select():
                source = key.fileobj
                assert isinstance(source, socket.socket)
                if source is self._wake:
                    command = self._wake.recv(1)
                    if command == _QUIT:
                        return
                    self._open = command == _OPEN
                    if not self._open:
                        self._cut()
                elif source is self._listener:
                    self._accept()
                elif source in self._partner:
                    self._pass_on(source)

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        if not self._open:
            near.close()
            return
        far = socket.create_connection(("127.0.0.1", self._target))
        for one, other in ((near, far), (far, near)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._partner[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _pass_on(self, source: socket.socket) -> None:
        try:
            data = source.recv(4096)
            self._partner[source].sendall(data[: self._until_cut] if self._left else data)
        except OSError:
            data = b""
        if not data:
            self._close(source)
        elif self._left:
            self._until_cut -= len(data)
            if self._until_cut <= 0:
                self._cut()
                self._until_cut = self._draw()
                self._left -= 1
                if not self._left:
                    self.finished.set()

    def _draw(self) -> int:
        return self._lengths.randint(1, 6000)

    def _cut(self) -> None:
        for one in list(self._partner):
            if one in self._partner:
                self._close(one)

    def _close(self, one: socket.socket) -> None:
        for each in (one, self._partner[one]):
            self._selector.unregister(each)
            del self._partner[each]
            each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
            each.close()

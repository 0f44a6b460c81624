"""A TCP proxy that breaks its connections: in the middle of messages, or for a while."""

from __future__ import annotations

import random
import selectors
import socket
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from tests.scripted.peer import ABORT

_QUIT, _SHUT, _OPEN, _CUT = b"q", b"s", b"o", b"c"


class Proxy:
    """Passes bytes on to a hub of this machine.

    Args:
        hub: its TCP address.
        cuts: number of times that all connections are reset, each after a few thousand bytes.
        seed: seed of the numbers of bytes between these cuts.

    Attributes:
        accepted: number of connections since the last `cut`.
    """

    def __init__(self, hub: str, cuts: int = 0, seed: int = 0) -> None:
        self._target = int(hub.rpartition(":")[2])
        self._left = cuts
        self.accepted = 0
        self._limits: deque[int] = deque()
        self._may_say: dict[socket.socket, int] = {}
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
        """URL to connect to."""
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
        """Reset all connections, and let no others through; from any thread."""
        self._waker.send(_SHUT)

    def cut(self, *limits: int) -> None:
        """Reset all connections, and the next ones after so many bytes from the far end; from any thread."""
        self._limits = deque(limits)
        self.accepted = 0
        self._waker.send(_CUT)

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
                    self._open = command != _SHUT
                    if command != _OPEN:
                        self._cut()
                elif source is self._listener:
                    self._accept()
                elif source in self._partner:
                    self._pass_on(source)

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        self.accepted += 1
        limit = self._limits.popleft() if self._limits else None
        if not self._open or limit == 0:
            near.close()
            return
        try:
            far = socket.create_connection(("127.0.0.1", self._target))
        except OSError:  # the hub has ended
            near.close()
            return
        if limit is not None:
            self._may_say[far] = limit
        for one, other in ((near, far), (far, near)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._partner[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _pass_on(self, source: socket.socket) -> None:
        try:
            data = source.recv(4096)
        except OSError:
            self._close(source)
            return
        if not data:
            self._end(source)
            return
        may_say = self._may_say.get(source)
        if may_say is not None:
            self._may_say[source] = may_say - len(data)
        passed = data[: self._until_cut] if self._left else data[:may_say]
        with suppress(OSError):  # this direction has no reader any more; the other one is still passed on
            self._partner[source].sendall(passed)
        if may_say is not None and len(data) >= may_say:
            self._close(source)
        if self._left:
            self._until_cut -= len(data)
            if self._until_cut <= 0:
                self._cut()
                self._until_cut = self._draw()
                self._left -= 1
                if not self._left:
                    self.finished.set()

    def _end(self, source: socket.socket) -> None:
        """Pass on that a side sends no more; earlier bytes still arrive, as over a cable."""
        self._selector.unregister(source)
        partner = self._partner[source]
        with suppress(OSError):
            partner.shutdown(socket.SHUT_WR)
        if partner not in self._selector.get_map():
            self._close(source, abort=False)

    def _draw(self) -> int:
        return self._lengths.randint(1, 6000)

    def _cut(self) -> None:
        for one in list(self._partner):
            if one in self._partner:
                self._close(one)

    def _close(self, one: socket.socket, abort: bool = True) -> None:
        for each in (one, self._partner[one]):
            if each in self._selector.get_map():
                self._selector.unregister(each)
            del self._partner[each]
            self._may_say.pop(each, None)
            if abort:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
            each.close()

"""A judge of what the two ends of a connection read: what the other end has sent, in that order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from glue.wire.messages import Message

if TYPE_CHECKING:
    from tests.simulation.net import Socket


class Order:
    """Compares the messages that are read with those that were sent; a connection that breaks loses the last.

    Args:
        problem: called with a description of each difference.
    """

    def __init__(self, problem: Callable[[str], None]) -> None:
        self._problem = problem
        self._sent: dict[int, deque[Message]] = {}

    def sent(self, end: Socket, message: Message) -> None:
        """Note that the program at `end` sends a message."""
        self._sent.setdefault(end.fd, deque()).append(message)

    def repeated(self, end: Socket) -> None:
        """Judge this end no more: its bytes arrive twice."""
        self._sent[end.fd] = deque()
        end.judged = False

    def read(self, end: Socket, message: Message) -> None:
        """Judge (f): the program at `end` reads the next message of the other end."""
        sender = end.peer
        if sender is None or not sender.judged or sender.fd not in self._sent:
            return
        waiting = self._sent[sender.fd]
        sent = waiting.popleft() if waiting else None
        if message != sent:
            sender.judged = False
            self._problem(
                f"(f) {end.process.name} reads {message!r:.150}; {sender.process.name} sent {sent!r:.150}"
            )

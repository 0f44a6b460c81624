"""An experiment's end of a hub in its own process: messages are handed over, with no socket in between.

While a verb is carried out, the experiment's thread takes the turns of the hub's loop. So a verb costs no
switch between threads, which would take longer than a step.
"""

from __future__ import annotations

import time
from collections import deque

from glue.hub.server import Hub
from glue.protocol.messages import Message, Role

__all__ = ["InsideTransport"]


class InsideTransport:
    """A connection to a hub that runs in another thread of this process.

    Attributes:
        connected: always true.
        connections: always one.
    """

    connected = True
    connections = 1

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._wait = 1.0
        self._received: deque[Message] = deque()

    # The peer's side.

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive_message` waits, in seconds."""
        self._wait = seconds

    def send_message(self, message: Message) -> bool:
        """Hand the hub a message; return False if the hub is ending."""
        loop = self._hub.loop
        loop.ask()
        with loop.mutex:
            if loop.stopping is not None:
                return False
            self._hub.switchboard.receive(self, message, time.monotonic())
            return True

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; None if none is received in time."""
        loop, received = self._hub.loop, self._received
        loop.ask()
        try:
            with loop.mutex:
                until = time.monotonic() + self._wait
                while not received and loop.stopping is None and (left := until - time.monotonic()) > 0:
                    loop.turn(left)
        except BaseException:
            # The loop was interrupted in the middle of something.
            self._hub.stop("the experiment was interrupted in the middle of a verb")
            raise
        if not received and loop.stopping is not None:
            self._hub.join(self._wait)  # it says goodbye as it ends
        return received.popleft() if received else None

    def notice_connections(self) -> None:
        """Do nothing: there is one."""

    def close(self, linger: float | None = None) -> None:
        """Do nothing: nothing is left to deliver."""

    # The hub's side: it is a route of the switchboard.

    def deliver(self, message: Message) -> bool:
        """Hand the experiment a message."""
        self._received.append(message)
        return True

    def admits(self, role: Role, session: str) -> bool:
        """Return True: the process that runs a hub may take any role."""
        return True

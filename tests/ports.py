"""Ports in a row, for servers that have to be told theirs, or are started again."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Final

import pytest

_COUNT: Final = 8


@pytest.fixture
def ports() -> Iterator[int]:
    """The first of eight ports, which only servers of this user get until the test ends.

    A socket that does not listen has each of them. None is shared when it is taken; then our servers may
    listen there, also at an address that `glue.hub.io.listener.reserve` keeps (SO_REUSEPORT). Whoever asks
    for any port gets another.
    """
    with ExitStack() as stack:
        yield next(first for first in range(20_000, 32_000, _COUNT) if _keep(first, stack))


def _keep(first: int, stack: ExitStack) -> bool:
    with ExitStack() as taken:
        for port in range(first, first + _COUNT):
            one = taken.enter_context(socket.socket())
            try:
                one.bind(("127.0.0.1", port))
            except OSError:
                return False
            for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
                one.setsockopt(socket.SOL_SOCKET, option, 1)
        stack.push(taken.pop_all())
    return True

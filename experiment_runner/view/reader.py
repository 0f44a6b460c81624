"""A thread that reads stores for the event loop, one after the other: all pages together cost one core."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

__all__ = ["Reader"]

_T = TypeVar("_T")


class Reader:
    """Calls functions in a thread of its own, which does not keep the program from ending.

    Args:
        name: of the thread.
        prepare: called by the thread before anything else; must not raise.
    """

    def __init__(self, name: str, prepare: Callable[[], object] = object) -> None:
        self._prepare = prepare
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    async def __call__(self, function: Callable[[], _T]) -> _T:
        """Return the result of a function; if the caller is cancelled before its turn, it is not called."""
        future: Future[_T] = Future()
        self._calls.put((future, function))
        return await asyncio.wrap_future(future)

    def _work(self) -> None:
        self._prepare()
        while True:
            future, function = self._calls.get()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = function()
            except BaseException as error:  # of any kind: it is raised in the caller
                future.set_exception(error)
            else:
                future.set_result(result)

"""Reading stores for the event loop, at a bounded cost: in one thread, with no answer computed too often."""

from __future__ import annotations

import asyncio
import json
import queue
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Any, Final, NamedTuple, TypeVar

from starlette.responses import Response

_T = TypeVar("_T")

_MOST_ANSWERS: Final = 32
_REST: Final = 20
"""Multiple of its computing time for which an answer is kept: computing takes at most 5 % of a core."""


class Reader:
    """Calls functions in a daemon thread, which does not keep the program from ending.

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


class _Answer(NamedTuple):
    signs: object
    until: float
    value: Any


class Kept:
    """Cache of the newest answers, by question."""

    def __init__(self) -> None:
        self._answers: OrderedDict[Hashable, _Answer] = OrderedDict()

    def get(self, question: Hashable, signs: object, compute: Callable[[], Any]) -> Any:
        """Return the answer to a question; as long as `signs` are equal, it cannot have changed."""
        now = time.monotonic()
        found = self._answers.get(question)
        if found is None or (found.signs != signs and now >= found.until):
            value = compute()
            done = time.monotonic()
            found = self._answers[question] = _Answer(signs, done + _REST * (done - now), value)
            if len(self._answers) > _MOST_ANSWERS:
                self._answers.popitem(last=False)
        self._answers.move_to_end(question)
        return found.value


def json_response(content: object, status: int = 200) -> Response:
    """Return a response in JSON, in ASCII: a file name may hold bytes that are not UTF-8."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return Response(text, status, media_type="application/json")

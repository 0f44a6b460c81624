"""Reading stores for the event loop, at a bounded cost: in one thread, with no answer computed too often."""

from __future__ import annotations

import asyncio
import json
import queue
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import Future
from typing import Any, Final, NamedTuple, TypeVar

from starlette.responses import Response

from glue.console import printable

_T = TypeVar("_T")

_MOST_ANSWERS: Final = 32
_REST: Final = 20
"""Usual multiple of its computing time for which an answer is kept: computing takes at most 5 % of a core."""


class Reader:
    """Calls functions in a daemon thread, which does not keep the program from ending.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    async def __call__(self, function: Callable[[], _T]) -> _T:
        """Return the result of a function; if the caller is cancelled before its turn, it is not called."""
        future: Future[_T] = Future()
        self._calls.put((future, function))
        return await asyncio.wrap_future(future)

    def _work(self) -> None:
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


class Cache:
    """Cache of the newest answers, by question.

    Args:
        most: number of answers that are kept.
        rest: multiple of its computing time for which an answer is kept at least.
    """

    def __init__(self, most: int = _MOST_ANSWERS, rest: int = _REST) -> None:
        self._most = most
        self._rest = rest
        self._answers: OrderedDict[Hashable, _Answer] = OrderedDict()

    def get(self, question: Hashable, signs: object, compute: Callable[[], Any]) -> Any:
        """Return the answer to a question; as long as `signs` are equal, it cannot have changed."""
        now = time.monotonic()
        found = self._answers.get(question)
        if found is None or (found.signs != signs and now >= found.until):
            value = compute()
            done = time.monotonic()
            found = self._answers[question] = _Answer(signs, done + self._rest * (done - now), value)
            if len(self._answers) > self._most:
                self._answers.popitem(last=False)
        self._answers.move_to_end(question)
        return found.value


def as_json(content: object) -> str:
    """Return JSON in which every text is printable: names of files and players may hold any characters."""
    return json.dumps(_shown(content), allow_nan=False, separators=(",", ":"))


def json_response(content: object, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Return a response in JSON."""
    return Response(as_json(content), status, headers, media_type="application/json")


def _shown(value: object) -> object:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {printable(name): _shown(part) for name, part in value.items()}
    return [*map(_shown, value)] if isinstance(value, list | tuple) else value

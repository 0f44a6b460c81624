"""Changes, sent to pages as server-sent events: one stream for each page.

A topic holds values by key, and for each the number of the change that set it. A page that was away names the
last change that it has seen, and is sent everything that has changed since, each value once: nothing has to
be queued for a page that is slow, asleep or gone, and a value that was replaced before the page got it is
skipped.

Reading stores for the event loop, at a bounded cost: in one thread, with no answer computed too often.
"""

from __future__ import annotations

import asyncio
import json
import queue
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager, AsyncExitStack, suppress
from typing import Any, Final, NamedTuple, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import BaseRoute, Route

from glue.console import printable

_T = TypeVar("_T")

_WAIT_SECONDS: Final = "5"
_MOST_ANSWERS: Final = 32
_REST: Final = 20
"""Usual multiple of its computing time for which an answer is kept: computing takes at most 5 % of a core."""


class Reader:
    """Calls functions in a daemon thread, which does not keep the program from ending.

    Args:
        name: of the thread.
        most: maximum number of calls that wait or are carried out; None for no limit.
    """

    def __init__(self, name: str, most: int | None = None) -> None:
        self._most = most
        self._waiting = 0
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    async def __call__(self, function: Callable[[], _T]) -> _T:
        """Return the result of a function; if the caller is cancelled before its turn, it is not called.

        Raises:
            HTTPException: too many wait already.
        """
        if self._most is not None and self._waiting >= self._most:
            raise HTTPException(503, "others wait already: try again soon", {"Retry-After": _WAIT_SECONDS})
        future: Future[_T] = Future()
        self._calls.put((future, function))
        self._waiting += 1
        try:
            return await asyncio.wrap_future(future)
        finally:
            self._waiting -= 1

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


_HEARTBEAT_SECONDS: Final = 15.0
_LEAST_SECONDS: Final = 0.03  # between two events to a page
_MAX_TOPICS: Final = 8

Source = Callable[[str], "AbstractAsyncContextManager[Topic]"]
"""A function of the part of a topic's name after the colon, as `id` in `live:id`; it keeps the topic up to
date while the context is open, and raises `KeyError` if there is no such topic."""


class Pulse:
    """Numbers all changes, and wakes the streams at each."""

    def __init__(self) -> None:
        self.run: str = secrets.token_hex(4)  # distinguishes changes from those of another server
        self.change: int = 0
        self.closed: bool = False
        self._changed = asyncio.Event()

    def beat(self) -> int:
        """Return the number of a new change, and wake all streams."""
        self.change += 1
        self._wake()
        return self.change

    def close(self) -> None:
        """End all streams."""
        self.closed = True
        self._wake()

    async def wait(self, seconds: float) -> None:
        """Return after the next change, or after some seconds."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), seconds)

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()


class Topic:
    """Values by key, which can be represented in JSON; None for a value that is gone."""

    def __init__(self, pulse: Pulse) -> None:
        self._pulse = pulse
        self._values: dict[str, tuple[int, Any]] = {}

    def put(self, key: str, value: object) -> None:
        """Set a value; this is a change unless it is equal to the previous value."""
        if key not in self._values or self._values[key][1] != value:
            self._values[key] = (self._pulse.beat(), value)

    def since(self, change: int) -> dict[str, Any]:
        """Return the values that were changed after change number `change`."""
        return {key: value for key, (number, value) in self._values.items() if number > change}

    def values(self) -> dict[str, Any]:
        """Return all values that are not None."""
        return {key: value for key, (_, value) in self._values.items() if value is not None}


def routes(pulse: Pulse, sources: Mapping[str, Source]) -> list[BaseRoute]:
    """Return the route of the stream, `/api/stream?topic=NAME&topic=NAME:ARGUMENT`.

    Each event is a JSON object, by topic, of the values that have changed. Its id, sent back as
    Last-Event-ID or `?since=`, lets the stream continue from there.
    """

    async def stream(request: Request) -> Response:
        names = list(dict.fromkeys(request.query_params.getlist("topic")))
        since = request.headers.get("last-event-id") or request.query_params.get("since", "")
        if not 0 < len(names) <= _MAX_TOPICS or any(name.partition(":")[0] not in sources for name in names):
            raise HTTPException(404, "there is no such topic")
        events = _events(pulse, sources, names, _change(pulse, since))
        return StreamingResponse(events, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})

    return [Route("/api/stream", stream)]


async def _events(
    pulse: Pulse, sources: Mapping[str, Source], names: Sequence[str], change: int
) -> AsyncIterator[str]:
    async with AsyncExitStack() as stack:
        topics: dict[str, Topic | None] = {}
        for name in names:
            kind, _, argument = name.partition(":")
            try:
                topics[name] = await stack.enter_async_context(sources[kind](argument))
            except KeyError:
                topics[name] = None
        yield "retry: 1000\n\n"
        first, spoke = True, time.monotonic()
        while not pulse.closed:
            seen = pulse.change
            found = {name: topic and topic.since(change) for name, topic in topics.items()}
            # The first event also has topics that are empty or missing.
            changed = found if first else {name: values for name, values in found.items() if values}
            if changed:
                yield f"id: {pulse.run}-{seen}\ndata: {as_json(changed)}\n\n"
                first, spoke = False, time.monotonic()
                await asyncio.sleep(_LEAST_SECONDS)
            elif time.monotonic() - spoke >= _HEARTBEAT_SECONDS:
                # So that both ends notice when the other is gone; scripts do not see a comment.
                yield "data: {}\n\n"
                spoke = time.monotonic()
            change = seen
            if pulse.change == seen:
                await pulse.wait(_HEARTBEAT_SECONDS)


def _change(pulse: Pulse, since: str) -> int:
    """Return the number of the change that an event's id names; 0, before all, for another server's id."""
    run, _, number = since.partition("-")
    if run != pulse.run or not number.isascii() or not number.isdigit() or len(number) > 18:
        return 0
    return min(int(number), pulse.change)

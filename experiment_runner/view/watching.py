"""The topic of the runs: looks for changes, but only while somebody looks at the page."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from experiment_runner.view.catalog import Catalog
from experiment_runner.view.reader import Reader
from experiment_runner.view.stream import Pulse, Topic

__all__ = ["Watcher"]

_SECONDS: Final = 1.0
_SHARE: Final = 20  # of its time that the watcher rests, for each second that it looks


class Watcher:
    """Keeps the topic `runs` up to date, as long as at least one page listens to it."""

    def __init__(self, catalog: Catalog, pulse: Pulse) -> None:
        self._catalog = catalog
        self._topic = Topic(pulse)
        self._read = Reader("watcher")
        self._listeners = 0
        self._task: asyncio.Task[None] | None = None

    @asynccontextmanager
    async def open(self, argument: str) -> AsyncIterator[Topic]:
        """Yield the topic; see `experiment_runner.view.stream.Source`."""
        if argument:
            raise KeyError(argument)
        self._listeners += 1
        try:
            if self._task is None:
                await self._look()
                self._task = asyncio.create_task(self._watch())
            yield self._topic
        finally:
            self._listeners -= 1
            if not self._listeners and self._task is not None:
                self._task.cancel()
                self._task = None

    async def _watch(self) -> None:
        while True:
            began = time.monotonic()
            await self._look()
            took = time.monotonic() - began
            await asyncio.sleep(max(_SECONDS, _SHARE * took))

    async def _look(self) -> None:
        # The catalog names a change once: it must not be lost when the last page goes away meanwhile.
        await asyncio.shield(asyncio.create_task(self._take_changes()))

    async def _take_changes(self) -> None:
        changes = await self._read(self._catalog.changes)
        for run_id, summary in changes.items():
            self._topic.put(run_id, summary)

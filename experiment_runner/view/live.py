"""The topics `live:RUN`: a trial in progress, as an observer of its session sees it.

An observer (docs/protocol-reference.md) cannot change anything, and the hub never waits for it. All pages
that show the same trial share one observer, and without pages there is none. It requests one moment, a start
or a step, at a time, at most 30 a second, so moments in between are never sent; a slower page gets only the
newest.
"""

from __future__ import annotations

import asyncio
import base64
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

from experiment_runner.store.layout import LiveSession, live_sessions
from experiment_runner.view.catalog import Catalog
from experiment_runner.view.episodes import described, number
from experiment_runner.view.stream import Pulse, Topic
from glue.client.observer import AnswerSeen, Seen, StartSeen, StepSeen, TaskSpecSeen, observe
from glue.errors import GlueError
from glue.types import CUT_OFF, Action

_RATE: Final = 30.0  # moments per second
_LOOK_SECONDS: Final = 0.5  # between polls for a trial in progress
_WAIT_SECONDS: Final = 5.0  # for a hub to answer
_MOST_WATCHES: Final = 16
_MOST_BYTES: Final = 2**18  # of an observation and action
_MOST_TEXT: Final = 2000
_MOST_MESSAGES: Final = 50


class Live:
    """Opens the topics: `RUN` is a run's first trial in progress, `RUN/TRIAL` that trial.

    A topic has `trials`, the ids of those in progress; `trial`, the one that is shown, if any; `spec`, its
    task spec; `moment`, the newest start or step; and `answers`, the last answers of the agent, by message.
    """

    def __init__(self, catalog: Catalog, pulse: Pulse) -> None:
        self._catalog = catalog
        self._pulse = pulse
        self._watches: dict[str, _Watch] = {}

    @asynccontextmanager
    async def open(self, argument: str) -> AsyncIterator[Topic]:
        """Yield a topic; see `experiment_runner.view.stream.Source`."""
        run, _, trial = argument.partition("/")
        directory = self._catalog.entry(run).directory
        watch = self._watches.get(argument)
        if watch is None:
            if len(self._watches) >= _MOST_WATCHES:
                raise KeyError(argument)
            watch = self._watches[argument] = _Watch(directory, trial, Topic(self._pulse))
        watch.listeners += 1
        try:
            yield watch.topic
        finally:
            watch.listeners -= 1
            if not watch.listeners:
                del self._watches[argument]
                watch.over.set()


class _Watch:
    """A thread that observes a trial until `over` is set."""

    def __init__(self, directory: Path, trial: str, topic: Topic) -> None:
        self.topic = topic
        self.listeners = 0
        self.over = threading.Event()
        self._directory = directory
        self._trial = trial
        self._answers: dict[str, str] = {}
        self._loop = asyncio.get_running_loop()
        threading.Thread(target=self._work, name="observer", daemon=True).start()

    def _work(self) -> None:
        while not self.over.is_set():
            sessions = live_sessions(self._directory)
            self._put("trials", sorted(sessions))
            trial = self._trial or min(sessions, default="")
            if trial in sessions:
                # The trial may end at any time: the next poll shows whether it continues.
                with suppress(GlueError, OSError):
                    self._watch(trial, sessions[trial])
            self._put("trial", None)
            self.over.wait(_LOOK_SECONDS)

    def _watch(self, trial: str, live: LiveSession) -> None:
        with observe(live.hub, live.session, name="glue-view", wait=_WAIT_SECONDS) as observer:
            self._put("trial", trial)
            self._answers = {}
            self._put("answers", None)
            looked = asked = time.monotonic()
            observer.want(1)
            while not self.over.is_set():
                self._show(observer.receive())
                now = time.monotonic()
                if now - looked >= _LOOK_SECONDS:
                    looked = now
                    sessions = live_sessions(self._directory)
                    self._put("trials", sorted(sessions))
                    if sessions.get(trial) != live or not observer.connected:
                        return  # a hub that was killed sends no goodbye
                self.over.wait(max(0.0, asked + 1 / _RATE - now))
                asked = time.monotonic()
                observer.want(1)

    def _show(self, seen: Seen | None) -> None:
        match seen:
            case TaskSpecSeen(text):
                self._put("spec", described(text))
            case AnswerSeen(message, answer):
                if len(self._answers) < _MOST_MESSAGES or message in self._answers:
                    self._answers = {**self._answers, message[:_MOST_TEXT]: answer[:_MOST_TEXT]}
                    self._put("answers", [*self._answers.items()])
            case StartSeen(_, observation):
                self._put("moment", _moment(StepSeen(0, 1, 0.0, 0.0, False, observation, Action())))
            case StepSeen():
                self._put("moment", _moment(seen))

    def _put(self, key: str, value: object) -> None:
        try:
            self._loop.call_soon_threadsafe(self.topic.put, key, value)
        except RuntimeError:  # the server has ended
            self.over.set()


def _moment(step: StepSeen) -> dict[str, Any]:
    """Return a step as JSON; action and observation are concatenated, in base64."""
    seen = step.action.body + step.observation.body
    ending = "cut off" if step.terminal == CUT_OFF else "terminal" if step.terminal else ""
    return {
        # RL_num_steps counts the start, and not the last step.
        "step": step.num_steps if step.terminal else step.num_steps - 1,
        "reward": number(step.reward),
        "return": number(step.episode_return),
        "ending": ending,
        "seen": base64.b64encode(seen).decode() if len(seen) <= _MOST_BYTES else None,
    }

"""What a person sees while an experiment runs, and what a script reads.

Everything for people goes to standard error, so that standard output is free for `--json`.
"""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol, TextIO

from experiment_runner.plan import TrialSpec
from experiment_runner.store import EpisodeResult

__all__ = ["JsonLines", "Progress", "Reporter"]

_WINDOW: Final = 100
_TTY_SECONDS: Final = 0.2
_LOG_SECONDS: Final = 10.0


class Reporter(Protocol):
    """Is told what happens to the trials; an episode it hears of is stored already."""

    def begin(self, spec: TrialSpec, done: int) -> None:
        """A trial starts, or goes on after `done` episodes."""
        ...

    def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
        """An episode is finished."""
        ...

    def say(self, line: str) -> None:
        """Something that a person should know."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


class Progress:
    """One line on a terminal, rewritten in place; a line every ten seconds elsewhere.

    Args:
        stream: where to write.
        clock: returns seconds.
    """

    def __init__(self, stream: TextIO = sys.stderr, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._clock = clock
        self._live = stream.isatty()
        self._shown_at = -_LOG_SECONDS if self._live else clock()
        self._width = 0
        self._began = clock()
        self._steps = 0
        self._done = 0
        self._before = 0
        self._recent: deque[float] = deque(maxlen=_WINDOW)
        self._spec: TrialSpec | None = None

    def begin(self, spec: TrialSpec, done: int) -> None:
        self._began = self._clock()
        self._steps = 0
        self._done = self._before = done
        self._recent.clear()
        self._spec = spec

    def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
        self._done = result.episode
        self._steps += result.steps
        self._recent.append(result.episode_return)
        now = self._clock()
        last = result.episode == spec.episodes
        if last or now - self._shown_at >= (_TTY_SECONDS if self._live else _LOG_SECONDS):
            self._shown_at = now
            self._show(self._line(spec, now))

    def say(self, line: str) -> None:
        self._clear()
        print(line, file=self._stream, flush=True)

    def close(self) -> None:
        if self._live and self._width:
            print(file=self._stream, flush=True)
            self._width = 0

    def _line(self, spec: TrialSpec, now: float) -> str:
        elapsed = max(now - self._began, 1e-9)
        left = elapsed / max(self._done - self._before, 1) * (spec.episodes - self._done)
        mean = sum(self._recent) / len(self._recent)
        return (
            f"{spec.id}  episode {self._done}/{spec.episodes}  {self._steps / elapsed:,.0f} steps/s  "
            f"return {self._recent[-1]:.2f}  mean of last {len(self._recent)} {mean:.2f}  "
            f"{_duration(left)} left"
        )

    def _show(self, line: str) -> None:
        if not self._live:
            print(line, file=self._stream, flush=True)
            return
        print(f"\r{line:<{self._width}}", end="", file=self._stream, flush=True)
        self._width = len(line)

    def _clear(self) -> None:
        if self._live and self._width:
            print(f"\r{'':<{self._width}}\r", end="", file=self._stream)
            self._width = 0


class JsonLines:
    """An object a line on standard output for every episode; for people, what `inner` shows."""

    def __init__(self, inner: Reporter, stream: TextIO = sys.stdout) -> None:
        self._inner = inner
        self._stream = stream

    def begin(self, spec: TrialSpec, done: int) -> None:
        self._inner.begin(spec, done)

    def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
        self.write(
            {
                "trial": spec.id,
                "episode": result.episode,
                "return": result.episode_return,
                "steps": result.steps,
                "terminal": result.terminal,
            }
        )
        self._inner.episode(spec, result)

    def say(self, line: str) -> None:
        self._inner.say(line)

    def close(self) -> None:
        self._inner.close()

    def write(self, value: dict[str, Any]) -> None:
        """Write one object."""
        print(json.dumps(value), file=self._stream, flush=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"

"""Reporting the progress of an experiment: for people, and as JSON lines for scripts.

Output for people goes to standard error, since standard output is for `--json`.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, TextIO

from experiment_runner.plan.plan import TrialSpec
from experiment_runner.report.tables import counted, decimal, format_table, wrap
from experiment_runner.store.database import reported
from experiment_runner.store.records import EpisodeResult, TrialRecord
from experiment_runner.store.run_data import finite
from glue.console import for_terminal

_WINDOW: Final = 100
_TTY_SECONDS: Final = 0.2
_LOG_SECONDS: Final = 10.0
_COLUMNS: Final = ("trial", "episode", "steps/s", "return", f"mean of last {_WINDOW}", "left")

_DISPENSABLE: Final = (2, 3, 4, 5)
"""Columns that are omitted on a narrow terminal, in this order."""

_BAR_WIDTH: Final = 60
_FULL, _EMPTY = "#", "."
_GREEN, _PLAIN = "\x1b[32m", "\x1b[0m"

_UP: Final = "\x1b[{}A\r"
_CLEAR_LINE: Final = "\x1b[K"
_CLEAR_BELOW: Final = "\x1b[J"


class Progress:
    """Shows a table of running trials, redrawn in place on a terminal; elsewhere a line every few seconds.

    On a terminal there is also a progress bar, in color if `color` is true. An episode is stored before it is
    reported.

    Args:
        stream: the output stream; None for standard error.
        clock: returns the time in seconds.
        color: draw the bar in color.
    """

    def __init__(
        self,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        *,
        color: bool = False,
    ) -> None:
        self._stream = stream or sys.stderr
        self._clock = clock
        self._live = self._stream.isatty()
        self._color = self._live and color
        self._every = _TTY_SECONDS if self._live else _LOG_SECONDS
        self._shown_at = clock() - (self._every if self._live else 0)
        self._drawn = 0  # number of lines on the terminal that the next drawing replaces
        self._rows: dict[str, _Row] = {}
        self._total = _Total([], clock())

    def start(self, trials: Sequence[TrialRecord]) -> None:
        """Report the start of a run; `trials` are all of its trials."""
        self._total = _Total(trials, self._clock())

    def begin(self, spec: TrialSpec, done: int, steps: int) -> None:
        """Report that a trial starts, or continues after `done` episodes, of `steps` steps in all."""
        self._rows[spec.id] = _Row(spec, done, steps)
        self._total.done[spec.id] = steps if spec.steps else done

    def rename(self, spec: TrialSpec, name: str) -> None:
        """Show a trial by this name from now on: a player from outside joined it."""
        self._rows[spec.id].name = name

    def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
        """Report a finished episode."""
        now = self._clock()
        self._rows[spec.id].add(result, now)
        self._total.add(spec, result)
        if now - self._shown_at >= self._every:
            self._show(now)

    def playing(self, spec: TrialSpec, episode: int, steps: int | None) -> None:
        """Report that an episode has not ended for a while, after so many steps; None if not known."""
        self._rows[spec.id].play(episode, steps)
        now = self._clock()
        if now - self._shown_at >= self._every:
            self._show(now)

    def end(self, spec: TrialSpec) -> None:
        """Report that a trial is finished, or has failed."""
        row = self._rows[spec.id]
        if self._live:
            self._show(self._clock())
        elif row.recent:
            self.say(row.line(self._clock()))
        del self._rows[spec.id]

    def say(self, line: str) -> None:
        """Show a line of text."""
        self._erase()
        print(for_terminal(line), file=self._stream, flush=True)

    def close(self) -> None:
        """End the report: the run is over."""
        self._erase()
        self._stream.flush()

    def _show(self, now: float) -> None:
        self._shown_at = now
        begun = [row for row in self._rows.values() if row.recent]
        if self._live:
            self._draw(now, begun)
        elif self._total.trials > 1:
            self.say(self._total.line(now))
        else:
            for row in begun:
                self.say(row.line(now))
        if not self._live:
            for line in self._under_way():
                self.say(line)

    def _under_way(self) -> list[str]:
        """Return a line for each trial whose episode does not end."""
        return [f"{row.name}: {row.under_way}" for row in self._rows.values() if row.under_way]

    def _draw(self, now: float, begun: Sequence[_Row]) -> None:
        width, height = shutil.get_terminal_size()
        room = max(height - 5, 1)
        lines = _table([row.cells(now) for row in begun[:room]], width - 1) if begun else []
        under_way = [part for line in self._under_way() for part in wrap(line, width - 1).splitlines()]
        lines += under_way[: max(room - len(begun), 0)]
        if len(begun) > room:
            lines.append(f"and {len(begun) - room} more")
        if self._total.trials > 1:
            lines.append(self._total.line(now))
        lines = [line[: width - 1] for line in lines]
        lines.append(_bar(self._total.share, min(width - 1, _BAR_WIDTH), self._color))
        back = _UP.format(self._drawn) if self._drawn else ""
        text = "".join(f"{line}{_CLEAR_LINE}\n" for line in lines)
        print(f"{back}{text}{_CLEAR_BELOW}", end="", file=self._stream, flush=True)
        self._drawn = len(lines)

    def _erase(self) -> None:
        if self._drawn:
            print(f"{_UP.format(self._drawn)}{_CLEAR_BELOW}", end="", file=self._stream)
            self._drawn = 0


class _Row:
    """A running trial.

    Attributes:
        name: the first column.
        recent: the returns of the newest episodes.
        under_way: a line about an episode that does not end; empty if there is none.
    """

    def __init__(self, spec: TrialSpec, done: int, steps: int) -> None:
        self.name: str = spec.id
        self._spec = spec
        self._before = self._done = done
        self._steps_before = steps
        self._steps = 0
        self._began = 0.0
        self.under_way: str = ""
        self.recent: deque[float] = deque(maxlen=_WINDOW)

    def play(self, episode: int, steps: int | None) -> None:
        so_far = "has not ended yet" if steps is None else f"has {counted(steps, 'step')} so far"
        limited = self._spec.max_steps or self._spec.steps
        remedy = "" if limited else "; --max-steps N (max_steps in a plan) cuts such episodes off"
        self.under_way = f"episode {episode} {so_far}{remedy}"

    def add(self, result: EpisodeResult, now: float) -> None:
        self.under_way = ""
        if not self.recent:
            self._began = now - result.wall_time  # excluding the time in which the players started
        self._done = result.episode
        self._steps += result.steps
        self.recent.append(result.episode_return)

    def cells(self, now: float) -> tuple[str, ...]:
        """Return the trial's row of the table, `_COLUMNS`."""
        elapsed = _at_least_an_instant(now - self._began)
        spec, steps = self._spec, self._steps_before + self._steps
        if spec.steps:
            left = elapsed / max(self._steps, 1) * (spec.steps - steps)
        else:
            left = elapsed / (self._done - self._before) * (spec.episodes - self._done)
        return (
            self.name,
            TrialRecord(spec, self._done, 0, None, steps).progress,
            f"{self._steps / elapsed:,.0f}",
            decimal(self.recent[-1]),
            decimal(sum(self.recent) / len(self.recent)),
            _duration(left),
        )

    def line(self, now: float) -> str:
        """Return the row as one line."""
        trial, episode, rate, latest, mean, left = self.cells(now)
        return (
            f"{trial}  episode {episode}  {rate} steps/s  return {latest}  "
            f"mean of last {len(self.recent)} {mean}  {left} left"
        )


class _Total:
    """The sum over all trials of a run.

    Attributes:
        trials: number of trials.
        done: episodes done in each trial, or its steps if it has a budget of steps, by its id.
    """

    def __init__(self, trials: Sequence[TrialRecord], now: float) -> None:
        self.trials = len(trials)
        self.done = {trial.spec.id: trial.steps if trial.spec.steps else trial.done for trial in trials}
        self._planned = {trial.spec.id: trial.spec.steps or trial.spec.episodes for trial in trials}
        self._unit = "step" if any(trial.spec.steps for trial in trials) else "episode"
        self._began = now
        self._steps = 0
        self._run = 0  # episodes, or steps, run in this process

    def add(self, spec: TrialSpec, result: EpisodeResult) -> None:
        more = result.steps if spec.steps else result.episode - self.done[spec.id]
        self.done[spec.id] += more
        self._steps += result.steps
        self._run += more

    @property
    def share(self) -> float:
        """The share of the planned episodes or steps that is done, 0 to 1."""
        return sum(self.done.values()) / max(sum(self._planned.values()), 1)

    def line(self, now: float) -> str:
        elapsed = _at_least_an_instant(now - self._began)
        done, planned = sum(self.done.values()), sum(self._planned.values())
        finished = sum(self.done[trial] == self._planned[trial] for trial in self.done)
        left = elapsed / max(self._run, 1) * (planned - done)
        return (
            f"{finished} of {self.trials} trials finished  {self._unit} {done}/{planned}  "
            f"{self._steps / elapsed:,.0f} steps/s  {_duration(left)} left"
        )


class JsonLines(Progress):
    """Also writes a JSON object for each episode, one on each line.

    Args:
        lines: stream for the objects.
        stream, settings: as in `Progress`.
    """

    def __init__(self, lines: TextIO, stream: TextIO | None = None, **settings: Any) -> None:
        super().__init__(stream, **settings)
        self._lines = lines

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
        super().episode(spec, result)

    def write(self, value: dict[str, Any]) -> None:
        """Write one object on a line; numbers that are infinite or NaN are null.

        Raises:
            StorageError: it cannot be written.
        """
        numbers = {name: finite(number) for name, number in value.items()}
        with reported("cannot write the results"):
            print(json.dumps(numbers), file=self._lines, flush=True)


def _table(rows: Sequence[tuple[str, ...]], width: int) -> list[str]:
    """Return the lines of a table no wider than `width`, without `_DISPENSABLE` columns if necessary."""
    names = list(range(len(_COLUMNS)))
    for column in (*_DISPENSABLE, None):
        header = [_COLUMNS[number] for number in names]
        lines = format_table(header, [[row[number] for number in names] for row in rows]).splitlines()
        if column is None or max(map(len, lines)) <= width:
            break
        names.remove(column)
    return lines


def _bar(share: float, width: int, color: bool) -> str:
    """Return a bar of `width` characters with a percentage at its end."""
    room = max(width - 5, 1)
    done = int(share * room)
    full, rest = _FULL * done, _EMPTY * (room - done)
    if color:
        full = f"{_GREEN}{full}{_PLAIN}"
    return f"{full}{rest} {int(share * 100):3d}%"


def _at_least_an_instant(seconds: float) -> float:
    return max(seconds, 1e-9)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"

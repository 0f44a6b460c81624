"""`glue-replay`: show recorded episodes, and compare them with the environment they were made with."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from glue import __version__
from glue.cli.shared import FILE
from glue.console import one_line, say
from glue.errors import ConfigError
from glue.installed import needing
from glue.options import parse_assignments
from glue.plugins.loading import find, make
from glue.plugins.naming import complete_names
from glue.wire.messages import Role

if TYPE_CHECKING:
    from env_server.replay.episodes import GoldenReader, Moment, RecordedRun
    from glue.roles import Environment
    from glue.trajectory import TrajectoryReader
    from glue.types import Observation


@click.command(name="glue-replay")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path))
@click.option(
    "--check/--no-check",
    default=None,
    help="Only compare, or only show; the default is both on a terminal, and --check elsewhere.",
)
@click.option("--episode", type=click.IntRange(1), help="Show only this one, counted from 1 in its file.")
@click.option(
    "--steps",
    type=click.IntRange(0),
    nargs=2,
    metavar="FIRST LAST",
    help="Show only these steps of an episode.",
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 1000),
    default=10.0,
    show_default=True,
    help="Steps shown per second; the original game made about 5.",
)
@click.option(
    "--gif", type=click.Path(path_type=Path), help="Show in an animated GIF; see --episode, --steps."
)
@click.option("--mp4", type=click.Path(path_type=Path), help="The same in a film, larger and smoother.")
@click.option("--png", type=click.Path(path_type=Path), help="Show the first of the steps in a PNG.")
@click.option(
    "--minari",
    "dataset",
    metavar="ID",
    help="Write all FILEs to a new dataset of Minari, as mines/sarsa-v0, and show nothing.",
)
@click.option("--parquet", type=FILE, metavar="OUT", help="Write all FILEs to a table, and show nothing.")
@click.option(
    "--env",
    "name",
    metavar="NAME",
    shell_complete=complete_names(Role.ENVIRONMENT),
    help="Compare with this environment, in place of the recorded one.",
)
@click.option(
    "--env-option",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Its option, in place of the recorded one; may be repeated.",
)
@click.version_option(__version__, prog_name="glue-replay")
def replay(
    files: tuple[Path, ...],
    check: bool | None,
    episode: int | None,
    steps: tuple[int, int] | None,
    speed: float,
    gif: Path | None,
    mp4: Path | None,
    png: Path | None,
    dataset: str | None,
    parquet: Path | None,
    name: str | None,
    assignments: tuple[str, ...],
) -> None:
    """Show recorded episodes, and compare them with the environment they were made with.

    FILE is a recording of an experiment or of the original Infinite Mario (docs/trajectories.md).
    Every observation, reward and end must equal the recorded one, bit for bit, and so must every level
    in a recording of the original. The first difference is reported, and the exit code is 1.

    \b
    Examples:
      glue-replay run.traj
      glue-replay --check run.traj other.traj
      glue-replay run.traj --episode 5 --steps 14 110 --gif mario.gif
      glue-replay run.traj --minari mario/sample-v0
    """
    from env_server.replay.episodes import open_recording, recorded_moments, replayed_moments
    from glue.trajectory import TrajectoryError, TrajectoryReader

    saves = any((gif, mp4, png))
    if dataset is not None or parquet is not None:
        if saves or check is not None or episode is not None or steps is not None or name is not None:
            raise ConfigError("a dataset holds all episodes, as recorded: leave out the other options")
        _write_datasets(files, dataset, parquet)
        return
    if saves and (len(files) > 1 or check):
        raise ConfigError("--gif, --mp4 and --png show a part of one FILE: give one, and no --check")
    if saves and episode is None:
        episode = 1
    first, last = steps or (0, sys.maxsize)

    def is_chosen(moment: Moment) -> bool:
        return episode in (None, moment.episode) and first <= moment.step <= last

    build = _builder(name, assignments)
    for file in files:
        reader = open_recording(file)
        moments = recorded_moments(reader) if check is False else replayed_moments(reader, build)
        counted = _Counted(moments, reader)
        shown = []
        if saves:
            shown = [moment.observation for moment in counted if is_chosen(moment)]
        elif check or not sys.stdout.isatty():
            deque(counted, maxlen=0)
        else:
            _show(filter(is_chosen, counted), speed)
        if not (counted.episodes or counted.levels):
            raise TrajectoryError(f"{file} holds no whole episode")
        if episode is not None and episode > counted.episodes:
            raise ConfigError(f"{file} has no episode {episode}: its episodes are 1 to {counted.episodes}")
        if saves:
            _save(shown, speed, gif, mp4, png)
        if isinstance(reader, TrajectoryReader) and reader.torn:
            say(f"{file} was not closed: its last, incomplete episode is left out")
        print(one_line(f"{file}: {counted}: {'not compared' if check is False else 'no difference'}"))


class _Counted:
    """Iterates over moments and counts them; adds the file to a reported difference."""

    def __init__(self, moments: Iterator[Moment], reader: TrajectoryReader | GoldenReader) -> None:
        self._moments = moments
        self._reader = reader
        self.runs = self.episodes = self.steps = 0

    @property
    def levels(self) -> int:
        from env_server.replay.episodes import GoldenReader

        return self._reader.levels if isinstance(self._reader, GoldenReader) else 0

    def __iter__(self) -> Iterator[Moment]:
        from env_server.replay.episodes import Difference

        try:
            for moment in self._moments:
                self.runs = moment.run
                self.episodes = moment.episode
                self.steps += moment.step > 0
                yield moment
        except Difference as error:
            raise Difference(f"{self._reader.path}: {error} (before it, {self} agree)") from None

    def __str__(self) -> str:
        counts = {"level": self.levels} if self.levels else {}
        if self.runs or not self.levels:
            counts |= {"run": self.runs, "episode": self.episodes, "step": self.steps}
        return ", ".join(_number_of(count, name) for name, count in counts.items())


def _builder(name: str | None, assignments: tuple[str, ...]) -> Callable[[RecordedRun], Environment]:
    """Return a function that makes the environment of a run: the recorded one, or the requested one."""
    if name is None:
        if assignments:
            raise ConfigError("--env-option needs --env: name the environment too")
        return _build_recorded
    options = parse_assignments(find(Role.ENVIRONMENT, name), assignments)
    return lambda run: make(name, **{**run.options, **options})


def _build_recorded(run: RecordedRun) -> Environment:
    from env_server.replay.episodes import NotInstalled, build_environment

    try:
        return build_environment(run)
    except NotInstalled as error:
        hint = f"if you trust it, add --env {error.name}" if error.name else "name it with --env"
        raise ConfigError(f"{error}: {hint}") from None


def _show(moments: Iterable[Moment], speed: float) -> None:
    from env_server.render.text import draw_text
    from glue.cli.screen import TerminalScreen

    with TerminalScreen(sys.stdout, draw_text) as screen:
        for moment in moments:
            screen.show(moment.observation, moment.reward, moment.step, moment.episode_return, moment.place)
            time.sleep(1 / speed)


def _write_datasets(files: Sequence[Path], dataset: str | None, parquet: Path | None) -> None:
    from env_server.replay.episodes import open_recording
    from glue.trajectory import TrajectoryError, TrajectoryReader

    readers = [reader for file in files if isinstance(reader := open_recording(file), TrajectoryReader)]
    if len(readers) < len(files):
        raise TrajectoryError("recordings of the original Mario cannot be datasets: some have only hashes")
    if parquet is not None:
        with needing("parquet", "Parquet needs pyarrow"):
            from env_server.datasets.parquet import write_parquet

        say(f"wrote {parquet}: {_number_of(write_parquet(readers, parquet), 'episode')}")
    if dataset is not None:
        with needing("minari", "datasets of Minari need it"):
            from env_server.datasets.minari import write_minari

        say(f"wrote the dataset {dataset}: {_number_of(write_minari(readers, dataset), 'episode')}")


def _number_of(count: int, name: str) -> str:
    return f"{count} {name}{'' if count == 1 else 's'}"


def _save(
    shown: Sequence[Observation], speed: float, gif: Path | None, mp4: Path | None, png: Path | None
) -> None:
    from env_server.render.drawing import save_gif, save_mp4, save_png

    if not shown:
        raise ConfigError("the episode has no such steps")
    if gif:
        save_gif(gif, shown, speed)
        say(f"wrote {gif}")
    if mp4:
        save_mp4(mp4, shown, speed)
        say(f"wrote {mp4}")
    if png:
        save_png(png, shown[0])
        say(f"wrote {png}")

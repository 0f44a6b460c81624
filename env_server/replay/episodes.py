"""Replay recordings: in the environment they were made with, or as recorded.

An environment is deterministic, so the recorded actions of a run, replayed from its first episode, must
give the recorded observations, rewards and ends, bit for bit.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from env_server.render.scene import element_name, is_scene
from env_server.replay.golden import Digest, GoldenEpisode, GoldenLevel, GoldenReader, GoldenRun, digest
from glue.errors import ConfigError, GlueError
from glue.files import open_regular
from glue.options import Value, build
from glue.plugins.loading import find, names
from glue.roles import Environment, SaveableEnvironment, SeedableEnvironment, offers
from glue.trajectory import Episode, Run, TrajectoryError, TrajectoryReader
from glue.trajectory.comparison import Outcomes, compare, unequal
from glue.types import Action, Observation, Step, beside_sizes, step_of
from glue.wire.messages import Role

Recorded: TypeAlias = Episode | GoldenEpisode | GoldenLevel
RecordedEpisode: TypeAlias = Episode | GoldenEpisode
RecordedRun: TypeAlias = Run | GoldenRun

Seen: TypeAlias = Observation | Digest | None
"""Recording of an observation: all of it, its hash, or None."""

_Array: TypeAlias = npt.NDArray[Any]


class Difference(GlueError):
    """The environment deviated from the recording; the message says where and how."""


class Moment(NamedTuple):
    """An observation of an episode, and the state of the episode.

    Attributes:
        run: number of the run in the recording, from 1.
        episode: number of the episode in the recording, from 1.
        step: number of actions taken; 0 is the start.
        observation: the observation.
        reward: for the last action; 0.0 at the start.
        terminal: whether the episode has reached its end.
        episode_return: sum of the rewards so far.
        place: run, episode and step in words.
    """

    run: int
    episode: int
    step: int
    observation: Observation
    reward: float
    terminal: bool
    episode_return: float
    place: str


def open_recording(path: str | os.PathLike[str]) -> TrajectoryReader | GoldenReader:
    """Return the reader for the file: of glue.trajectory's format, or of the original's recordings.

    Raises:
        TrajectoryError: it is neither, or cannot be read.
    """
    try:
        with open_regular(Path(path)) as file:
            head = file.read(4096)
        first = zlib.decompressobj(31).decompress(head, 1)
    except IsADirectoryError:
        raise TrajectoryError(f"{path} is a directory: name the recordings, which are files") from None
    except (OSError, zlib.error):
        first = b""  # the reader will say what is wrong
    return GoldenReader(path) if first == b"{" else TrajectoryReader(path)


class NotInstalled(ConfigError):
    """A recording, which is not trusted, names no installed environment.

    Args:
        name: of the environment; empty if the recording names none.
    """

    def __init__(self, name: str) -> None:
        super().__init__(
            f"the recording is of {name!r}, and a recording can only name installed environments"
            if name
            else "the recording does not name its environment"
        )
        self.name = name


def build_environment(run: RecordedRun) -> Environment:
    """Return the environment a run was recorded with.

    A recording is untrusted, so it can only name installed environments, never a module, a file or another
    library's environment.

    Raises:
        NotInstalled: it names another, or none.
        ConfigError: the options do not fit.
    """
    if run.environment not in names(Role.ENVIRONMENT):
        raise NotInstalled(run.environment)
    return build_named(run.environment, run.options)


def build_named(name: str, options: Mapping[str, Value]) -> Environment:
    """Return the environment called `name`, made with `options`.

    Raises:
        ConfigError: there is none, or the options do not fit.
    """
    environment: Environment = build(find(Role.ENVIRONMENT, name), options)
    return environment


def replayed_moments(
    recorded: Iterable[Recorded], build: Callable[[RecordedRun], Environment]
) -> Iterator[Moment]:
    """Yield every moment of all episodes from the environment of each run, once compared.

    Recorded levels are compared with the simulator's.

    Raises, while iterating:
        Difference: the first deviation from the recording.
        GlueError: the environment refuses an action or option of the recording.
    """
    run: RecordedRun | None = None
    environment: Environment | None = None
    runs = 0
    try:
        for number, episode in enumerate(_compare_levels(recorded), 1):
            if environment is None or episode.run is not run:
                if environment is not None:
                    environment.env_cleanup()
                run, environment = episode.run, build(episode.run)
                runs += 1
                _initialise(environment, episode)
            yield from _replay_episode(environment, episode, runs, number)
    finally:
        if environment is not None:
            environment.env_cleanup()


def recorded_moments(recorded: Iterable[Recorded]) -> Iterator[Moment]:
    """Yield every moment of all episodes as recorded, without an environment.

    Raises, while iterating:
        ConfigError: an observation was not recorded, or only its hash.
    """
    run: RecordedRun | None = None
    runs = 0
    episodes = (part for part in recorded if not isinstance(part, GoldenLevel))
    for number, episode in enumerate(episodes, 1):
        if episode.run is not run:
            run = episode.run
            runs += 1
        total = 0.0
        for step, (_, reward, seen, terminal) in enumerate(_outcomes(episode)):
            place = _place(episode, number, step)
            if not isinstance(seen, Observation):
                only = "actions and rewards were" if seen is None else "a hash was"
                raise ConfigError(f"{place}: only {only} recorded; replay it with its environment")
            total += reward
            yield Moment(runs, number, step, seen, reward, terminal, total, place)


def _compare_levels(recorded: Iterable[Recorded]) -> Iterator[RecordedEpisode]:
    """Yield the episodes; between them, check that the simulator makes the same levels."""
    for part in recorded:
        if isinstance(part, GoldenLevel):
            difference = part.difference()
            if difference:
                raise Difference(difference)
        else:
            yield part


def _outcomes(episode: RecordedEpisode) -> Iterator[tuple[Action | None, float, Seen, bool]]:
    """Yield the start of an episode, which has no action, and every step: action, reward, seen, terminal."""
    yield None, 0.0, episode.start, False
    yield from episode.steps


def _place(episode: RecordedEpisode, number: int, step: int) -> str:
    run = episode.run
    name = f"run {run.name}, " if isinstance(run, GoldenRun) else ""
    late = ", late" if isinstance(episode, Episode) and episode.is_late(step) else ""
    return f"{name}episode {number}, " + (f"step {step}{late}" if step else "start")


def _initialise(environment: Environment, first: RecordedEpisode) -> None:
    """Bring the environment to the start of the first episode of its run."""
    if isinstance(first, GoldenEpisode):
        first.begin_run(environment)
        return
    run = first.run
    if run.seed is not None and offers(environment, SeedableEnvironment):
        environment.env_seed(run.seed)
    task_spec = environment.env_init()
    if task_spec != run.task_spec:
        raise Difference(f"the task spec: expected {run.task_spec!r}, got {task_spec!r}")
    if run.state:
        if not offers(environment, SaveableEnvironment):
            raise ConfigError("the recording begins with a saved state, which this environment cannot load")
        environment.env_load(run.state)


def _replay_episode(
    environment: Environment, episode: RecordedEpisode, run: int, number: int
) -> Iterator[Moment]:
    if isinstance(episode, Episode):
        for message in episode.messages:
            environment.env_message(message)
    elif difference := episode.difference_before(environment):
        raise Difference(f"{_place(episode, number, 0)}: {difference}")
    total = 0.0
    for step, (action, reward, seen, terminal) in enumerate(_outcomes(episode)):
        place = _place(episode, number, step)
        try:
            if action is None:
                got = Step(0.0, environment.env_start(), False)
            else:
                got = step_of(environment, environment.env_step(action))
        except GlueError as error:
            raise Difference(f"{place}: the environment refused: {error}") from error
        difference = _difference((reward, seen, terminal), got)
        if difference:
            raise Difference(f"{place}: {difference}")
        total += reward
        yield Moment(run, number, step, got.observation, reward, terminal, total, place)


def _difference(expected: tuple[float, Seen, bool], got: Step) -> str:
    """Return how two outcomes differ, in words; "" if they do not."""
    reward, seen, terminal = expected
    again = Outcomes(np.array([got.reward]), got.terminal and not got.truncated)
    if (difference := compare(Outcomes(np.array([reward]), terminal), again)) is not None:
        return difference[1]
    if isinstance(seen, Digest):
        found = digest(got.observation, reward, terminal)
        return "" if found == seen else f"the observation: expected {seen!r}, got {found!r}"
    if seen is None:
        return ""
    # What the recording lacks beside the numbers, an older version or another hub may have left out.
    mask, extras = beside_sizes(seen.body)
    observation = got.observation.without(mask=not mask, extras=not extras)
    return "" if seen == observation else _observation_difference(seen, observation)


def _observation_difference(expected: Observation, got: Observation) -> str:
    if expected.counts != got.counts:
        counts = ["{} ints, {} doubles, {} chars".format(*seen.counts) for seen in (expected, got)]
        return f"the observation: expected {counts[0]}, got {counts[1]}"
    pairs: tuple[tuple[str, _Array, _Array], ...] = (
        ("int", expected.ints, got.ints),
        ("double", expected.doubles, got.doubles),
        ("char", np.frombuffer(expected.chars, "S1"), np.frombuffer(got.chars, "S1")),
    )
    differing = ((name, old, new, where) for name, old, new in pairs if (where := unequal(old, new)).size)
    first = next(differing, None)
    if first is None:
        beside = [f"mask 0x{seen.packed_mask.hex()} and extras {seen.extras}" for seen in (expected, got)]
        return f"beside the observation: expected {beside[0]:.200}, got {beside[1]:.200}"
    name, old, new, where = first
    index = int(where[0])
    what = f" ({element_name(name, index)})" if is_scene(expected) else ""
    return f"{name} {index}{what}: expected {old[index].item()!r}, got {new[index].item()!r}"

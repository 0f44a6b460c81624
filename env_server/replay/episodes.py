"""Replay recordings: in the environment they were made with, or as recorded.

An environment is deterministic, so the recorded actions of a run, replayed from its first episode, must
give the recorded observations, rewards and ends, bit for bit.

Read recordings of the original Infinite Mario, and compare the parts that only they contain.

A file is gzip, one JSON object per line, whose `kind` says what it is. A run, one process of the original
on one level, is a line `run`, then for every episode a `start`, its `step`s and an `end`; lines of kind
`tick` are ignored. A line `level` is a level on its own. In a run with `obs` = `hash`, lines have a hash
instead of the observation; other lines have both, which must agree. docs/trajectories.md has the fields.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from env_server.mario.game import Level, Spawn, level_difference
from env_server.render.scene import element_name, is_scene
from glue.errors import ConfigError, GlueError
from glue.files import open_regular
from glue.options import Value, build, parameters
from glue.plugins.loading import find, make, names
from glue.roles import Environment, SaveableEnvironment, SeedableEnvironment, offers
from glue.trajectory import MAX_EPISODE, MAX_STEPS, Episode, Run, TrajectoryError, TrajectoryReader
from glue.trajectory.comparison import Outcomes, compare, unequal
from glue.types import Action, Observation, Step, beside_sizes, step_of
from glue.wire.messages import Role

_MAX_LINE: Final = 2**20  # bytes of one line
_DIGEST_SIZE: Final = 8
_LONGEST_NAME: Final = 100  # characters
_KEYS: Final = 4
_SPAWN: Final = 4  # numbers of a spawn point
_REWARD: Final = struct.Struct(">d")


class _Line:
    """One JSON object, and its place in the file."""

    def __init__(self, fields: dict[str, Any], where: str, size: int) -> None:
        self._fields = fields
        self._where = where
        self.size = size

    def wrong(self, what: str) -> TrajectoryError:
        return TrajectoryError(f"{self._where}: {what}")

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def get(self, name: str, *kinds: type) -> Any:
        """Return a required field, of one of the types `kinds`."""
        value = self._fields.get(name)
        if type(value) not in kinds:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be {wanted}, not {value!r:.60}")
        return value

    def number(self, name: str) -> float:
        return float(self.get(name, float, int))

    def list_of(self, name: str, *kinds: type) -> list[Any]:
        values: list[Any] = self.get(name, list)
        if not all(type(value) in kinds for value in values):
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be a list of {wanted}")
        return values


def _lines_of(path: Path) -> Iterator[_Line]:
    """Yield the lines of a file.

    Raises, while iterating:
        TrajectoryError: the file cannot be read, or a line is too long or is not a JSON object.
    """
    try:
        with open_regular(path) as packed, gzip.open(packed) as file:
            number = 0
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                where = f"{path}, line {number}"
                if len(line) > _MAX_LINE:
                    raise TrajectoryError(f"{where} has more than {_MAX_LINE} bytes")
                try:
                    fields = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise TrajectoryError(f"{where} is not JSON: {error}") from None
                if not isinstance(fields, dict):
                    raise TrajectoryError(f"{where} is not a JSON object")
                yield _Line(fields, where, len(line))
    except gzip.BadGzipFile:
        raise TrajectoryError(f"{path} is not a recording: it is not a gzip file") from None
    except (EOFError, zlib.error) as error:
        raise TrajectoryError(f"{path} is damaged after line {number}: {error}") from None
    except OSError as error:
        raise TrajectoryError(f"cannot read {path}: {error.strerror}") from None


class Digest(bytes):
    """The first 8 bytes of the SHA-256 of an observation with its reward and terminal; see `digest`."""

    def __repr__(self) -> str:
        return f"hash {self.hex()}"


def digest(observation: Observation, reward: float, terminal: bool) -> Digest:
    """Return the hash of a step as the recordings define it; for a start, the reward is 0.0.

    The hash covers, without counts, the ints, the doubles (both big-endian), the chars, the reward
    (big-endian) and one byte for terminal.
    """
    whole = hashlib.sha256(observation.ints.astype(">i4").tobytes())
    whole.update(observation.doubles.astype(">f8").tobytes())
    whole.update(observation.chars)
    whole.update(_REWARD.pack(reward))
    whole.update(bytes((terminal,)))
    return Digest(whole.digest()[:_DIGEST_SIZE])


@runtime_checkable
class _Buttoned(Protocol):
    """An environment whose buttons at the start of the next episode can be read and set."""

    buttons: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class GoldenRun:
    """A process of the original: its name, and the options that make our environment the same."""

    environment: ClassVar[str] = "mario"

    name: str
    options: Mapping[str, Value]


class GoldenStep(NamedTuple):
    """An action and its outcome: the observation, or only its hash."""

    action: Action
    reward: float
    observation: Observation | Digest
    terminal: bool


@dataclass(frozen=True, slots=True)
class GoldenEpisode:
    """One episode.

    Attributes:
        run: the run it belongs to.
        keys: whether left, right, jump and run are held when its first tick begins.
        start: its first observation, or only its hash.
        steps: its steps in order, read from the file as they are iterated over, once.
    """

    run: GoldenRun
    keys: tuple[bool, ...]
    start: Observation | Digest
    steps: Iterator[GoldenStep]


@dataclass(frozen=True, slots=True)
class GoldenLevel:
    """One level; our environment makes it with `options`."""

    options: Mapping[str, Value]
    level: Level

    def check(self) -> None:
        """Raise Difference if the level that our environment makes differs from this one."""
        from env_server.mario.environment import InfiniteMario  # here, as the simulator loads slowly

        mario: InfiniteMario = build(InfiniteMario, self.options)
        mario.env_init()
        mario.env_start()
        if difference := level_difference(self.level, mario.game.level):
            task = " ".join(f"{name}={value}" for name, value in self.options.items())
            raise Difference(f"{task}: {difference}")


class GoldenReader:
    """The episodes and levels of a file, one after the other; iterate over it.

    Attributes:
        path: the file.
        levels: number of levels read so far.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message has the line.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        self.levels: int = 0

    def __iter__(self) -> Iterator[GoldenEpisode | GoldenLevel]:
        run: GoldenRun | None = None
        self.levels = 0
        lines = _lines_of(self.path)
        for line in lines:
            kind = line.get("kind", str)
            if kind == "tick":
                continue
            if kind == "level":
                yield _level(line)
                self.levels += 1
            elif kind == "run":
                run = _run(line)
            elif kind == "start" and run is not None:
                steps = self._steps(lines, line, run)
                yield GoldenEpisode(run, _keys(line), _seen(line, 0.0, False), steps)
                deque(steps, maxlen=0)  # skip the steps that were not read
            else:
                raise line.wrong(f"a line {kind!r} cannot stand here")

    def _steps(self, lines: Iterator[_Line], start: _Line, run: GoldenRun) -> Iterator[GoldenStep]:
        """Yield the steps of the episode that `start` begins, up to its end."""
        size, steps = start.size, 0
        for line in lines:
            size += line.size
            kind = line.get("kind", str)
            if kind == "step":
                steps += 1
                if steps > MAX_STEPS or size > MAX_EPISODE:
                    raise line.wrong(f"more than {MAX_STEPS} steps or {MAX_EPISODE} bytes in an episode")
                yield _step(line)
            elif kind == "end":
                return
            elif kind != "tick":
                raise line.wrong(f"a line {kind!r} cannot stand here")
        raise TrajectoryError(f"{self.path} ends in the middle of an episode of {run.name}")


def _run(line: _Line) -> GoldenRun:
    options: dict[str, Value] = {}
    for name, value in line.get("params", dict).items():
        if type(value) not in (int, float) or not math.isfinite(value):
            raise line.wrong(f"parameter {name!r} must be a number, not {value!r:.60}")
        options[name] = value
    for name in ("level_seed", "level_type", "level_difficulty", "start_ticks"):
        options[name] = line.get(name, int)
    for name in ("render", "velocity"):
        options[name] = line.get(name, str)
    options["alpha"] = line.number("alpha")
    # The original's instance is a set of values for `params`, which are all there.
    name = line.get("id", str)
    if not name.isprintable() or len(name) > _LONGEST_NAME:
        raise line.wrong(f"field 'id' must be a name of at most {_LONGEST_NAME} letters")
    return GoldenRun(name, options)


def _level(line: _Line) -> GoldenLevel:
    names = ("level_seed", "level_type", "level_difficulty", "level_width")
    rows = line.list_of("rows", str)
    spawns = line.list_of("sprites", list)
    if not all(len(spawn) == _SPAWN and set(map(type, spawn)) <= {int, bool} for spawn in spawns):
        raise line.wrong("field 'sprites' must be a list of [column, row, kind, winged]")
    level = Level(
        line.get("width", int),
        (line.get("xExit", int), line.get("yExit", int)),
        tuple(rows),
        tuple(Spawn(column, row, kind, winged == 1) for column, row, kind, winged in spawns),
    )
    return GoldenLevel({name: line.get(name, int) for name in names}, level)


def _keys(line: _Line) -> tuple[bool, ...]:
    keys = line.list_of("keys", int)
    if len(keys) != _KEYS or not set(keys) <= {0, 1}:
        raise line.wrong(f"field 'keys' must be {_KEYS} times 0 or 1, not {keys!r:.60}")
    return tuple(key == 1 for key in keys)


def _step(line: _Line) -> GoldenStep:
    reward = line.number("r")
    end = line.get("end", int)
    if end not in (0, 1):
        raise line.wrong(f"field 'end' must be 0 or 1, not {end}")
    terminal = end == 1
    try:
        action = Action(line.list_of("a", int))
    except GlueError as error:
        raise line.wrong(str(error)) from None
    return GoldenStep(action, reward, _seen(line, reward, terminal), terminal)


def _seen(line: _Line, reward: float, terminal: bool) -> Observation | Digest:
    """Return the observation of a start or a step, or its hash if only that was recorded."""
    try:
        recorded = Digest.fromhex(line.get("h", str))
    except ValueError:
        recorded = Digest()
    if len(recorded) != _DIGEST_SIZE:
        raise line.wrong(f"field 'h' must be {2 * _DIGEST_SIZE} hexadecimal digits")
    if "i" not in line:
        return recorded
    try:
        observation = Observation(
            line.list_of("i", int), line.list_of("d", float, int), line.get("c", str).encode("latin-1")
        )
    except (GlueError, UnicodeEncodeError, OverflowError) as error:
        raise line.wrong(str(error)) from None
    if digest(observation, reward, terminal) != recorded:
        raise line.wrong("its hash is not that of its observation, reward and end")
    return observation


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
    library's environment. A file that an environment reads must be the one with the recorded digest.

    Raises:
        NotInstalled: it names another, or none.
        ConfigError: the options do not fit, or lack the digest of a file.
    """
    if run.environment not in names(Role.ENVIRONMENT):
        raise NotInstalled(run.environment)
    known = parameters(find(Role.ENVIRONMENT, run.environment))
    for name in run.options:
        if (digest := f"{name}_digest") in known and digest not in run.options:
            raise ConfigError(
                f"the recording names a file as {name}, but not its SHA-256 as {digest}: name both "
                "environment and file yourself"
            )
    return make(run.environment, **run.options)


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
            part.check()
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
        environment.env_init()
        if isinstance(environment, _Buttoned):
            environment.buttons = first.keys
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
    elif isinstance(environment, _Buttoned) and environment.buttons != episode.keys:
        expected, held = (list(map(int, keys)) for keys in (episode.keys, environment.buttons))
        raise Difference(f"{_place(episode, number, 0)}: the keys held: expected {expected}, got {held}")
    total = 0.0
    for step, (action, reward, seen, terminal) in enumerate(_outcomes(episode)):
        place = _place(episode, number, step)
        try:
            if action is None:
                got = Step(0.0, environment.env_start(), False)
            else:
                got = step_of(environment.env_step(action))
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

"""Read recordings of the original Infinite Mario, and compare the parts that only they contain.

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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Protocol, runtime_checkable

from env_server.mario.level import Level, Spawn, level_difference
from glue.errors import GlueError
from glue.files import open_regular
from glue.options import Value, build
from glue.roles import Environment
from glue.trajectory import MAX_EPISODE, MAX_STEPS, TrajectoryError
from glue.types import Action, Observation

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

    def begin_run(self, environment: Environment) -> None:
        """Bring a fresh environment to the start of this episode, the first of its run."""
        environment.env_init()
        if isinstance(environment, _Buttoned):
            environment.buttons = self.keys

    def difference_before(self, environment: Environment) -> str:
        """Return how the buttons held now differ from those recorded for the start; "" if they do not."""
        if not isinstance(environment, _Buttoned) or environment.buttons == self.keys:
            return ""
        expected, got = (list(map(int, keys)) for keys in (self.keys, environment.buttons))
        return f"the keys held: expected {expected}, got {got}"


@dataclass(frozen=True, slots=True)
class GoldenLevel:
    """One level; our environment makes it with `options`."""

    options: Mapping[str, Value]
    level: Level

    def difference(self) -> str:
        """Return how the level that our environment makes differs from this one; "" if it does not."""
        from env_server.mario.environment import InfiniteMario  # here, as the simulator loads slowly

        mario: InfiniteMario = build(InfiniteMario, self.options)
        mario.env_init()
        mario.env_start()
        difference = level_difference(self.level, mario.game.level)
        task = " ".join(f"{name}={value}" for name, value in self.options.items())
        return difference and f"{task}: {difference}"


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
            line.list_of("i", int),
            line.list_of("d", float, int),
            line.get("c", str).encode("latin-1"),
        )
    except (GlueError, UnicodeEncodeError, OverflowError) as error:
        raise line.wrong(str(error)) from None
    if digest(observation, reward, terminal) != recorded:
        raise line.wrong("its hash is not that of its observation, reward and end")
    return observation

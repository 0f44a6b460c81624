"""Read recordings of the original Infinite Mario.

A file is gzip, one JSON object a line, of which `kind` says what it is. A run, one process of the
original on one level, is a line `run`, then for every episode a `start`, its `step`s and an `end`; lines
of the kind `tick` are passed over. A line `level` is a level by itself. Lines of a run whose `obs` is
`hash` have, in place of the observation, its hash; lines of the others have both, and must agree with
themselves. docs/trajectories.md has the fields.
"""

from __future__ import annotations

import hashlib
import math
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from env_server.mario.level import Level, Spawn
from env_server.replay.golden_lines import Line, lines_of
from glue.errors import GlueError
from glue.options import Value
from glue.trajectory import MAX_EPISODE, MAX_STEPS, TrajectoryError
from glue.types import Action, Observation

__all__ = [
    "Digest",
    "GoldenEpisode",
    "GoldenLevel",
    "GoldenReader",
    "GoldenRun",
    "GoldenStep",
    "digest",
]

_DIGEST_SIZE: Final = 8
_LONGEST_NAME: Final = 100  # characters
_KEYS: Final = 4
_SPAWN: Final = 4  # numbers of a spawn point
_REWARD: Final = struct.Struct(">d")


class Digest(bytes):
    """The first 8 bytes of the SHA-256 of an observation with its reward and terminal; see `digest`."""

    def __repr__(self) -> str:
        return f"hash {self.hex()}"


def digest(observation: Observation, reward: float, terminal: bool) -> Digest:
    """Return the hash of a step as the recordings define it; of a start, the reward is 0.0.

    Hashed are, without counts, the ints, the doubles (both big-endian), the chars, the reward
    (big-endian) and one byte for terminal.
    """
    whole = hashlib.sha256(observation.ints.astype(">i4").tobytes())
    whole.update(observation.doubles.astype(">f8").tobytes())
    whole.update(observation.chars)
    whole.update(_REWARD.pack(reward))
    whole.update(bytes((terminal,)))
    return Digest(whole.digest()[:_DIGEST_SIZE])


@dataclass(frozen=True, slots=True)
class GoldenRun:
    """A process of the original: its name, and the options that make our environment the same."""

    name: str
    options: Mapping[str, Value]


class GoldenStep(NamedTuple):
    """An action, and what came of it: the observation or only its hash."""

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
        steps: its steps, in their order.
    """

    run: GoldenRun
    keys: tuple[bool, ...]
    start: Observation | Digest
    steps: tuple[GoldenStep, ...]


@dataclass(frozen=True, slots=True)
class GoldenLevel:
    """One level; `options` are those with which our environment makes it."""

    options: Mapping[str, Value]
    level: Level


class GoldenReader:
    """The episodes and levels of a file, one after the other; iterate over it.

    Attributes:
        path: the file.
        levels: how many levels were passed so far.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message has the line.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.levels = 0

    def __iter__(self) -> Iterator[GoldenEpisode | GoldenLevel]:
        run: GoldenRun | None = None
        start: tuple[GoldenRun, tuple[bool, ...], Observation | Digest] | None = None
        steps: list[GoldenStep] = []
        size = 0
        self.levels = 0
        for line in lines_of(self.path):
            size += line.size
            kind = line.get("kind", str)
            if kind == "tick":
                continue
            if kind == "level" and start is None:
                yield _level(line)
                self.levels += 1
            elif kind == "run" and start is None:
                run = _run(line)
            elif kind == "start" and start is None and run is not None:
                start, steps = (run, _keys(line), _seen(line, 0.0, False)), []
                size = line.size
            elif kind == "step" and start is not None:
                if len(steps) == MAX_STEPS or size > MAX_EPISODE:
                    raise line.wrong(f"more than {MAX_STEPS} steps or {MAX_EPISODE} bytes in an episode")
                steps.append(_step(line))
            elif kind == "end" and start is not None:
                yield GoldenEpisode(*start, tuple(steps))
                start = None
            else:
                raise line.wrong(f"a line {kind!r} cannot stand here")
        if start is not None:
            raise TrajectoryError(f"{self.path} ends in the middle of an episode of {start[0].name}")


def _run(line: Line) -> GoldenRun:
    options: dict[str, Value] = {}
    for name, value in line.get("params", dict).items():
        if type(value) not in (int, float) or not math.isfinite(value):
            raise line.wrong(f"parameter {name!r} must be a number; {value!r:.60} came")
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


def _level(line: Line) -> GoldenLevel:
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


def _keys(line: Line) -> tuple[bool, ...]:
    keys = line.list_of("keys", int)
    if len(keys) != _KEYS or not set(keys) <= {0, 1}:
        raise line.wrong(f"field 'keys' must be {_KEYS} times 0 or 1; {keys!r:.60} came")
    return tuple(key == 1 for key in keys)


def _step(line: Line) -> GoldenStep:
    reward = line.number("r")
    end = line.get("end", int)
    if end not in (0, 1):
        raise line.wrong(f"field 'end' must be 0 or 1; {end} came")
    terminal = end == 1
    try:
        action = Action(line.list_of("a", int))
    except GlueError as error:
        raise line.wrong(str(error)) from None
    return GoldenStep(action, reward, _seen(line, reward, terminal), terminal)


def _seen(line: Line, reward: float, terminal: bool) -> Observation | Digest:
    """Return the observation of a start or a step, or its hash if there is no more."""
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

"""Read recordings of the original Infinite Mario.

A file is gzip, one JSON object a line, of which `kind` says what it is. A run, one process of the
original on one level, is a line `run`, then for every episode a `start`, its `step`s and an `end`; lines
of the kinds `tick` and `level` are passed over. Lines of a run whose `obs` is `hash` have, in place of
the observation, its hash; lines of the others have both, and must agree with themselves.
docs/trajectories.md has the fields.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from glue.errors import GlueError
from glue.options import Value
from glue.trajectory import MAX_EPISODE, MAX_STEPS, TrajectoryError
from glue.types import Action, Observation

__all__ = [
    "MAX_LINE",
    "Digest",
    "GoldenEpisode",
    "GoldenReader",
    "GoldenRun",
    "GoldenStep",
    "digest",
]

MAX_LINE: Final = 2**20  # bytes of one line
_DIGEST_SIZE: Final = 8
_LONGEST_NAME: Final = 100  # characters
_KEYS: Final = 4
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


class GoldenReader:
    """The episodes of a file, one after the other; iterate over it.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message has the line.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    def __iter__(self) -> Iterator[GoldenEpisode]:
        run: GoldenRun | None = None
        start: tuple[GoldenRun, tuple[bool, ...], Observation | Digest] | None = None
        steps: list[GoldenStep] = []
        size = 0
        for line in _lines(self.path):
            size += line.size
            kind = line.get("kind", str)
            if kind in ("tick", "level"):
                continue
            if kind == "run" and start is None:
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


class _Line:
    """One JSON object, and where it stands."""

    def __init__(self, fields: dict[str, Any], where: str, size: int) -> None:
        self._fields = fields
        self._where = where
        self.size = size

    def wrong(self, what: str) -> TrajectoryError:
        return TrajectoryError(f"{self._where}: {what}")

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def get(self, name: str, *kinds: type) -> Any:
        """Return a field that has to be there and of one of `kinds`."""
        value = self._fields.get(name)
        if type(value) not in kinds:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be {wanted}; {value!r:.60} came")
        return value

    def number(self, name: str) -> float:
        return float(self.get(name, float, int))

    def numbers(self, name: str, *kinds: type) -> list[Any]:
        values: list[Any] = self.get(name, list)
        if not all(type(value) in kinds for value in values):
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be a list of {wanted}")
        return values


def _lines(path: Path) -> Iterator[_Line]:
    try:
        with gzip.open(path, "rb") as file:
            number = 0
            while line := file.readline(MAX_LINE + 1):
                number += 1
                where = f"{path}, line {number}"
                if len(line) > MAX_LINE:
                    raise TrajectoryError(f"{where} has more than {MAX_LINE} bytes")
                try:
                    fields = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise TrajectoryError(f"{where} is not JSON: {error}") from None
                if not isinstance(fields, dict):
                    raise TrajectoryError(f"{where} is not a JSON object")
                yield _Line(fields, where, len(line))
    except gzip.BadGzipFile:
        raise TrajectoryError(f"{path} is no recording: it is not a gzip file") from None
    except (EOFError, zlib.error) as error:
        raise TrajectoryError(f"{path} is damaged after line {number}: {error}") from None
    except OSError as error:
        raise TrajectoryError(f"cannot read {path}: {error.strerror}") from None


def _run(line: _Line) -> GoldenRun:
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


def _keys(line: _Line) -> tuple[bool, ...]:
    keys = line.numbers("keys", int)
    if len(keys) != _KEYS or not set(keys) <= {0, 1}:
        raise line.wrong(f"field 'keys' must be {_KEYS} times 0 or 1; {keys!r:.60} came")
    return tuple(key == 1 for key in keys)


def _step(line: _Line) -> GoldenStep:
    reward = line.number("r")
    end = line.get("end", int)
    if end not in (0, 1):
        raise line.wrong(f"field 'end' must be 0 or 1; {end} came")
    terminal = end == 1
    try:
        action = Action(line.numbers("a", int))
    except GlueError as error:
        raise line.wrong(str(error)) from None
    return GoldenStep(action, reward, _seen(line, reward, terminal), terminal)


def _seen(line: _Line, reward: float, terminal: bool) -> Observation | Digest:
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
            line.numbers("i", int),
            line.numbers("d", float, int),
            line.get("c", str).encode("latin-1"),
        )
    except (GlueError, UnicodeEncodeError, OverflowError) as error:
        raise line.wrong(str(error)) from None
    if digest(observation, reward, terminal) != recorded:
        raise line.wrong("its hash is not that of its observation, reward and end")
    return observation

"""Gymnasium's spaces as task specs, and back; their values as ints, doubles and chars, and back.

A space becomes a run of ints, one of doubles and one of chars, its leaves one after the other: those of a
Dict in the order of its keys, those of a Tuple in order.

    Discrete, MultiDiscrete, MultiBinary    ints
    Box of integers other than uint8        ints, if they fit 32 bits
    Box of uint8                            chars
    Box of float16, float32 or float64      doubles

Properties that the ranges of a task spec do not state (shapes, types, names, the bounds of chars) are the
*layout*: JSON after the word LAYOUT in the task spec's EXTRA. A space read back from text and layout is equal
to the original.

Masks of the legal actions in Gymnasium's form, as the `sample` of an action space takes them.

Discrete        an array of int8, 1 for each legal value
MultiDiscrete   a tuple of such arrays, one for each number; in tuples if the space has several axes
MultiBinary     an array of the shape of the space: the only legal value, or 2 if both are
Box of ints     as MultiDiscrete, from the space's bounds on
Dict, Tuple     a dict or tuple of masks; None for a Box of floats or of uint8
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from glue.errors import ConfigError, SimulatorError
from glue.taskspec import RL_GLUE_3, Range, Ranges, Space, TaskSpec, legal_values, mask_sizes
from glue.taskspec.parser import MASKS
from glue.taskspec.space import equal_runs
from glue.types import AbstractType, BoolArray, Observation

SpaceLike: TypeAlias = "spaces.Space[Any]"

INT, DOUBLE, CHAR = range(3)
"""The runs of an abstract type."""

INT32: Final = np.iinfo(np.int32)
FLOATS: Final = ("float16", "float32", "float64")
_MAX_DEPTH: Final = 16


class Leaf(NamedTuple):
    """A space without parts: its run, and the shape and type of its values."""

    space: SpaceLike
    run: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Number of elements in the leaf."""
        return int(np.prod(self.shape, dtype=np.int64))


def leaves_of(space: SpaceLike, depth: int = 0) -> Iterator[Leaf]:
    """Yield the leaves of a space, those of a Dict in the order of its keys.

    Raises:
        ConfigError: the space is not of the kinds named at the top of `glue.gym.spaces`.
    """
    if depth > _MAX_DEPTH:
        raise ConfigError(f"a space nests more than {_MAX_DEPTH} deep")
    if isinstance(space, spaces.Dict):
        for key in space.spaces:
            if not isinstance(key, str):
                raise ConfigError(f"the keys of a Dict space are texts, not {key!r:.80}")
        for key in sorted(space.spaces):
            yield from leaves_of(space.spaces[key], depth + 1)
    elif isinstance(space, spaces.Tuple):
        for part in space.spaces:
            yield from leaves_of(part, depth + 1)
    elif isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary | spaces.Box):
        yield _leaf(space)
    else:
        raise ConfigError(
            f"a task spec cannot describe {type(space).__name__}: only Discrete, MultiDiscrete, MultiBinary, "
            "Box, and Dict and Tuple of these"
        )


def ends_of(leaf: Leaf) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the smallest and the largest value of each number of a leaf, flat."""
    space = leaf.space
    if isinstance(space, spaces.Discrete):
        return np.array([space.start]), np.array([space.start + space.n - 1])
    if isinstance(space, spaces.MultiDiscrete):
        return space.start.reshape(-1), (space.start + space.nvec - 1).reshape(-1)
    if isinstance(space, spaces.MultiBinary):
        return np.zeros(leaf.size, np.int64), np.ones(leaf.size, np.int64)
    return space.low.reshape(-1), space.high.reshape(-1)


def _leaf(space: SpaceLike) -> Leaf:
    dtype = np.dtype(space.dtype)
    if dtype == np.uint8 and isinstance(space, spaces.Box):
        run = CHAR
    elif dtype.name in FLOATS:
        run = DOUBLE
    elif dtype.kind in "iu":
        run = INT
    else:
        raise ConfigError(
            f"a task spec cannot describe a Box of {dtype}: only of integers and floats of 64 bits"
        )
    leaf = Leaf(space, run, tuple(space.shape), dtype)
    low, high = ends_of(leaf)
    if run == INT and leaf.size and (low.min() < INT32.min or high.max() > INT32.max):
        raise ConfigError(f"the ints of RL-Glue have 32 bits; {space!r:.200} needs more")
    return leaf


_TYPES: Final = (np.int32, np.float64, np.uint8)
"""The type of the numbers of each run."""


class Codec:
    """Values of a space as the ints, doubles and chars of an abstract type.

    Raises:
        ConfigError: the space is not of the kinds named at the top of `glue.gym.spaces`.
    """

    def __init__(self, space: SpaceLike) -> None:
        self.space = space
        self.leaves: list[Leaf] = [*leaves_of(space)]
        self._clips = [leaf.run == DOUBLE and bool(np.isfinite(ends_of(leaf)).any()) for leaf in self.leaves]

    @property
    def ranges(self) -> Space:
        """The space as a task spec describes it."""
        runs: list[list[tuple[int, Range]]] = [[], []]
        chars = 0
        for leaf in self.leaves:
            if leaf.run == CHAR:
                chars += leaf.size
            else:
                ends = equal_runs(*ends_of(leaf))
                runs[leaf.run] += [(count, Range(low, high)) for count, low, high in ends]
        return Space(Ranges(tuple(runs[INT])), Ranges(tuple(runs[DOUBLE])), chars)

    def pack(self, value: Any) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], bytes]:
        """Return a value of the space as ints, doubles and chars.

        Doubles may be outside their bounds, by rounding for example, and axes of length one may be missing.

        Raises:
            SimulatorError: the value has other parts, shapes or kinds of numbers than the space, or an int or
                char is outside its bounds.
        """
        parts: tuple[list[npt.NDArray[Any]], ...] = ([], [], [])
        for leaf, part in zip(self.leaves, parts_of(self.space, value), strict=True):
            parts[leaf.run].append(_numbers(leaf, part))
        ints, doubles, chars = (
            np.concatenate(run) if run else np.empty(0, dtype)
            for run, dtype in zip(parts, _TYPES, strict=True)
        )
        return ints, doubles, chars.tobytes()

    def unpack(self, value: AbstractType) -> Any:
        """Return the value of the space that ints, doubles and chars encode.

        Doubles outside their bounds are clipped.

        Raises:
            SimulatorError: the counts are wrong, a number is NaN, or a value is not in the space.
        """
        counts = [sum(leaf.size for leaf in self.leaves if leaf.run == run) for run in (INT, DOUBLE, CHAR)]
        if value.counts != tuple(counts):
            raise SimulatorError(
                f"expected {counts[INT]} ints, {counts[DOUBLE]} doubles and {counts[CHAR]} chars for "
                f"{self.space!r:.200}; received {value!r:.200}"
            )
        if np.isnan(value.doubles).any():
            raise SimulatorError(f"a number is NaN: {value!r:.200}")
        runs: tuple[npt.NDArray[Any], ...] = (value.ints, value.doubles, np.frombuffer(value.chars, np.uint8))
        at = [0, 0, 0]
        found = []
        for leaf, clips in zip(self.leaves, self._clips, strict=True):
            start = at[leaf.run]
            at[leaf.run] = start + leaf.size
            numbers = runs[leaf.run][start : at[leaf.run]]
            if clips:
                low, high = ends_of(leaf)
                # NumPy's clip could turn a legal 0.0 into -0.0.
                numbers = np.where(numbers < low, low, np.where(numbers > high, high, numbers))
            one = numbers.astype(leaf.dtype).reshape(leaf.shape)
            part = one[()] if isinstance(leaf.space, spaces.Discrete) else one
            if not leaf.space.contains(part):
                raise SimulatorError(f"{part!r:.80} is not in {leaf.space!r:.200}")
            found.append(part)
        return build(self.space, iter(found))


def _numbers(leaf: Leaf, part: Any) -> npt.NDArray[Any]:
    """Return the value of a leaf as a flat array of its run's type.

    Raises:
        SimulatorError: the value is not in the leaf's space.
    """
    try:
        given = np.asarray(part)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)
    if given.dtype.kind not in "biuf":
        raise SimulatorError(f"expected numbers of {leaf.space!r:.200}, not {part!r:.80}")
    if given.shape != leaf.shape and _long_axes(given.shape) != _long_axes(leaf.shape):
        raise SimulatorError(f"expected the shape {leaf.shape} of {leaf.space!r:.200}, not {given.shape}")
    flat = given.reshape(-1)
    if leaf.run == DOUBLE:
        return flat.astype(np.float64, copy=False)
    low, high = ends_of(leaf)
    wrong = (flat < low) | (flat > high)
    if given.dtype.kind == "f":
        wrong |= flat != np.floor(flat)
    if wrong.any():
        index = int(wrong.argmax())
        place = f" at {[*map(int, np.unravel_index(index, given.shape))]}" if given.shape else ""
        raise SimulatorError(f"{flat[index]}{place} is not in {leaf.space!r:.200}")
    return flat.astype(_TYPES[leaf.run], copy=False)


def _long_axes(shape: tuple[int, ...]) -> list[int]:
    return [length for length in shape if length != 1]


def parts_of(space: SpaceLike, value: Any) -> Iterator[Any]:
    """Yield the parts of a value, one for each leaf.

    Raises:
        SimulatorError: the value does not have the parts of the space.
    """
    if isinstance(space, spaces.Dict):
        if not isinstance(value, Mapping) or value.keys() != space.spaces.keys():
            raise SimulatorError(f"expected a dict of {', '.join(space.spaces)}, not {value!r:.80}")
        for key in sorted(space.spaces):
            yield from parts_of(space.spaces[key], value[key])
    elif isinstance(space, spaces.Tuple):
        if not isinstance(value, Sequence | np.ndarray) or len(value) != len(space.spaces):
            raise SimulatorError(f"expected a tuple of {len(space.spaces)} parts, not {value!r:.80}")
        for part, one in zip(space.spaces, value, strict=True):
            yield from parts_of(part, one)
    else:
        yield value


def build(space: SpaceLike, parts: Iterator[Any]) -> Any:
    """Return the value of a space with these parts, one for each leaf."""
    if isinstance(space, spaces.Dict):
        return {key: build(space.spaces[key], parts) for key in sorted(space.spaces)}
    if isinstance(space, spaces.Tuple):
        return tuple(build(part, parts) for part in space.spaces)
    return next(parts)


class MaskCodec:
    """Masks in Gymnasium's form as masks of observations, and back.

    Raises:
        ConfigError: the space is not of the kinds named at the top of `glue.gym.spaces`.
        TaskSpecError: an integer of the space has no bounds, or too many values for a mask.
    """

    def __init__(self, space: SpaceLike) -> None:
        self._space = space
        codec = Codec(space)
        self._leaves = codec.leaves
        self._sizes = mask_sizes(codec.ranges)

    def pack(self, mask: Any) -> npt.NDArray[np.bool_]:
        """Return a mask in Gymnasium's form as one of an observation.

        Raises:
            SimulatorError: it does not fit the space.
        """
        rows: list[npt.NDArray[Any]] = []
        with suppress(TypeError, ValueError):  # not a sequence where one is expected, or a ragged one
            for leaf, part in zip(self._leaves, parts_of(self._space, mask), strict=True):
                rows += map(np.asarray, _rows(leaf, part))
        if rows and [row.shape for row in rows] == [(size,) for size in self._sizes]:
            bits = np.concatenate(rows)
            if bits.dtype == np.bool_ or ((bits == 0) | (bits == 1)).all():
                return bits.astype(np.bool_)
        raise SimulatorError(
            f"this is no mask of {self._space}, which has 1 for each legal value: {mask!r:.200}"
        )

    def unpack(self, observation: Observation) -> Any:
        """Return the mask of an observation in Gymnasium's form; every action is legal if it has none.

        Raises:
            RemoteProtocolError: it does not fit the space.
        """
        rows = iter(legal_values(observation, self._sizes))
        return build(self._space, (_leaf_mask(leaf, rows) for leaf in self._leaves))

    def flat(self, observation: Observation) -> BoolArray:
        """Return whether each value of each number of an action is legal, concatenated, shape (bits,).

        Raises:
            RemoteProtocolError: the mask of the observation does not fit the space.
        """
        return np.concatenate(legal_values(observation, self._sizes))


def _rows(leaf: Leaf, mask: Any) -> Iterator[Any]:
    """Yield from a mask in Gymnasium's form a row of truth values for each number of a leaf."""
    if leaf.run != INT:
        return
    if isinstance(leaf.space, spaces.Discrete):
        yield mask
    elif isinstance(leaf.space, spaces.MultiBinary):
        yield from ((one != 1, one != 0) for one in np.ravel(mask) if one in (0, 1, 2))
    else:
        yield from _flattened(mask, len(leaf.shape))


def _leaf_mask(leaf: Leaf, rows: Iterator[BoolArray]) -> Any:
    """Return the mask of a leaf in Gymnasium's form, from a row of truth values for each of its numbers."""
    if leaf.run != INT:
        return None
    mine = [row.astype(np.int8) for row in islice(rows, leaf.size)]
    if isinstance(leaf.space, spaces.MultiBinary):
        return np.array([2 if row.all() else row[1] for row in mine], np.int8).reshape(leaf.shape)
    return _nested(iter(mine), leaf.shape)


def _flattened(value: Any, depth: int) -> Iterator[Any]:
    if depth == 0:
        yield value
    else:
        for part in value:
            yield from _flattened(part, depth - 1)


def _nested(items: Iterator[Any], shape: tuple[int, ...]) -> Any:
    return tuple(_nested(items, shape[1:]) for _ in range(shape[0])) if shape else next(items)


_MARK: Final = "LAYOUT "


def task_spec(observations: Codec, actions: Codec, masks: bool = False) -> str:
    """Return the task spec of an environment with these spaces, and perhaps masks of the legal actions.

    Raises:
        TaskSpecError: the task spec would be too long.
    """
    layout = json.dumps(
        {"observation": _layout(observations.space), "action": _layout(actions.space)}, separators=(",", ":")
    )
    extra = f"{MASKS} {_MARK}{layout}" if masks else f"{_MARK}{layout}"
    spec = TaskSpec(RL_GLUE_3, "episodic", 1.0, observations.ranges, actions.ranges, Range(), extra)
    return str(spec)


def read_spaces(spec: TaskSpec) -> tuple[SpaceLike, SpaceLike]:
    """Return the spaces of observations and actions that a task spec describes.

    Without a layout, one bounded int is a Discrete, several are a MultiDiscrete, other ints, doubles and
    chars are Boxes, and numbers of more than one kind a Dict of `ints`, `doubles` and `chars`. A space that
    is not stated is a Dict of sequences of any length.

    Raises:
        ConfigError: the layout is damaged or does not fit the ranges.
    """
    _, mark, text = spec.extra.partition(_MARK)
    if not mark:
        return _plain(spec.observations), _plain(spec.actions)
    try:
        layout = json.loads(text)
        return (_read(layout["observation"], spec.observations), _read(layout["action"], spec.actions))
    except Exception as error:  # of any kind: NumPy and Gymnasium raise many for what is no space
        raise ConfigError(
            f"the layout in the task spec's EXTRA cannot be read ({type(error).__name__}): {text:.60}"
        ) from None


def _layout(space: SpaceLike) -> Any:
    if isinstance(space, spaces.Dict):
        return {"Dict": {key: _layout(space.spaces[key]) for key in sorted(space.spaces)}}
    if isinstance(space, spaces.Tuple):
        return {"Tuple": [_layout(part) for part in space.spaces]}
    kind = type(space).__name__
    if isinstance(space, spaces.Discrete):
        return {kind: np.dtype(space.dtype).name}
    described: list[Any] = [[*space.shape], np.dtype(space.dtype).name]
    if isinstance(space, spaces.Box) and space.dtype == np.uint8 and (space.low.any() or (~space.high).any()):
        described += [_shortened(space.low), _shortened(space.high)]
    return {kind: described}


def _shortened(bounds: npt.NDArray[np.uint8]) -> int | list[int]:
    """Return bounds, as one number if they are equal."""
    flat: list[int] = bounds.reshape(-1).tolist()
    return flat[0] if len(set(flat)) == 1 else flat


class _Reader:
    """Reader of the ranges in a task spec's runs, in order."""

    def __init__(self, space: Space) -> None:
        self._ends = tuple(
            np.array([range_.ends for _, range_ in ranges.runs], np.float64)
            .reshape(-1, 2)
            .repeat([repeat for repeat, _ in ranges.runs], axis=0)
            for ranges in (space.ints, space.doubles)
        )
        self._chars = space.chars
        self._at = [0, 0, 0]

    def take(self, run: int, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
        """Return the next bounds of a run, shape (2, *shape)."""
        size = int(np.prod(shape, dtype=np.int64))
        start = self._at[run]
        available = self._chars if run == CHAR else len(self._ends[run])
        if not 0 <= size <= available - start:
            raise ValueError(f"{size} numbers are taken, and {available - start} are left")
        self._at[run] = start + size
        if run == CHAR:
            return np.empty((2, 0))
        return self._ends[run][start : start + size].T.reshape(2, *shape)

    def finish(self) -> None:
        if self._at != [len(self._ends[INT]), len(self._ends[DOUBLE]), self._chars]:
            raise ValueError("it describes fewer numbers than the ranges")


def _read(layout: Any, space: Space) -> SpaceLike:
    if not np.isfinite([range_.ends for _, range_ in space.ints.runs]).all():
        raise ValueError("an int of a layout has both bounds")
    reader = _Reader(space)
    found = _read_part(layout, reader)
    reader.finish()
    return found


def _read_part(layout: Any, reader: _Reader) -> SpaceLike:
    ((kind, described),) = layout.items()
    match kind:
        case "Dict":
            return spaces.Dict({key: _read_part(described[key], reader) for key in sorted(described)})
        case "Tuple":
            return spaces.Tuple([_read_part(part, reader) for part in described])
        case "Discrete":
            low, high = reader.take(INT, ()).astype(np.int64).tolist()
            dtype = _integers(described)
            # Gymnasium 1.0 has no other dtype.
            other: dict[str, Any] = {} if dtype == np.int64 else {"dtype": dtype}
            return spaces.Discrete(high - low + 1, start=low, **other)
        case "MultiDiscrete":
            low, high = reader.take(INT, _shape(described)).astype(np.int64)
            dtype = _integers(described[1])
            return spaces.MultiDiscrete(_cast(high - low + 1, dtype), dtype=dtype, start=_cast(low, dtype))
        case "MultiBinary":
            shape = _shape(described)
            reader.take(INT, shape)
            return spaces.MultiBinary(shape if len(shape) != 1 else shape[0])
        case "Box":
            return _read_box(described, reader)
    raise ValueError(f"there is no kind {kind!r:.40}")


def _shape(described: Any) -> tuple[int, ...]:
    shape = tuple(described[0])
    if any(type(length) is not int or length < 0 for length in shape):
        raise ValueError(f"a shape is whole numbers, not {described[0]!r:.40}")
    return shape


def _read_box(described: Any, reader: _Reader) -> SpaceLike:
    shape, name = _shape(described), described[1]
    if name == "uint8":
        reader.take(CHAR, shape)
        low, high = described[2:] or (0, 255)
        return spaces.Box(*(_bytes(bound, shape) for bound in (low, high)), shape, np.uint8)
    run, dtype = (DOUBLE, np.dtype(name)) if name in FLOATS else (INT, _integers(name))
    low, high = reader.take(run, shape)
    if run == INT:
        return spaces.Box(_cast(low, dtype), _cast(high, dtype), shape, dtype.type)
    return spaces.Box(low.astype(dtype), high.astype(dtype), shape, dtype.type)


def _cast(numbers: npt.NDArray[Any], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return whole numbers as another type, which has to hold them."""
    cast = numbers.astype(np.int64).astype(dtype)
    if (cast != numbers).any():
        raise ValueError(f"{dtype} holds other numbers than the ranges")
    return cast


def _bytes(bound: Any, shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
    return np.broadcast_to(
        np.array(bound, np.uint8).reshape(shape if isinstance(bound, list) else ()), shape
    ).copy()


def _integers(name: Any) -> np.dtype[Any]:
    dtype = np.dtype(str(name))
    if dtype.kind not in "iu":
        raise ValueError(f"{name!r:.40} is not a type of integers")
    return dtype


def _plain(space: Space) -> SpaceLike:
    """Return the space of a task spec without a layout."""
    if not space.stated:
        kinds = {"ints": np.int32, "doubles": np.float64, "chars": np.uint8}
        return spaces.Dict({name: _any_length(dtype) for name, dtype in kinds.items()})
    reader = _Reader(space)
    ints, doubles, chars = space.counts
    found: dict[str, SpaceLike] = {}
    if ints:
        found["ints"] = _plain_ints(reader.take(INT, (ints,)))
    if doubles:
        low, high = reader.take(DOUBLE, (doubles,))
        found["doubles"] = spaces.Box(low, high, dtype=np.float64)
    if chars or not found:
        found["chars"] = spaces.Box(0, 255, (chars,), np.uint8)
    return next(iter(found.values())) if len(found) == 1 else spaces.Dict(found)


def _plain_ints(ends: npt.NDArray[np.float64]) -> SpaceLike:
    low, high = ends
    if np.isfinite(ends).all():
        start, last = low.astype(np.int64), high.astype(np.int64)
        if len(start) == 1:
            return spaces.Discrete(int(last[0] - start[0]) + 1, start=int(start[0]))
        return spaces.MultiDiscrete(last - start + 1, start=start)
    bounds = [np.clip(end, INT32.min, INT32.max).astype(np.int32) for end in (low, high)]
    return spaces.Box(*bounds, dtype=np.int32)


def _any_length(dtype: type) -> SpaceLike:
    low, high = (-np.inf, np.inf) if dtype is np.float64 else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    return spaces.Sequence(spaces.Box(low, high, (), dtype), stack=True)

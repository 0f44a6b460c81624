"""Gymnasium's spaces as task specs, and back.

A space becomes a run of ints, one of doubles and one of chars, its leaves one after the other: those of a
Dict in the order of its keys, those of a Tuple in order.

    Discrete, MultiDiscrete, MultiBinary    ints
    Box of integers other than uint8        ints, if they fit 32 bits
    Box of uint8                            chars
    Box of float16, float32 or float64      doubles

Properties that the ranges of a task spec do not state (shapes, types, names, the bounds of chars) are the
*layout*: JSON after the word LAYOUT in the task spec's EXTRA. A space read back from text and layout is equal
to the original.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from glue.errors import ConfigError
from glue.gym.codec import CHAR, DOUBLE, FLOATS, INT, INT32, Codec, SpaceLike
from glue.taskspec import RL_GLUE_3, Range, Space, TaskSpec
from glue.taskspec.parser import MASKS

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
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
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
    reader = _Reader(space)
    found = _read_part(layout, reader)
    reader.finish()
    return found


def _read_part(layout: Any, reader: _Reader) -> SpaceLike:
    ((kind, described),) = layout.items()
    if kind == "Dict":
        return spaces.Dict({key: _read_part(described[key], reader) for key in sorted(described)})
    if kind == "Tuple":
        return spaces.Tuple([_read_part(part, reader) for part in described])
    read = _KINDS.get(kind)
    if read is None:
        raise ValueError(f"there is no kind {kind!r:.40}")
    return read(described, reader)


def _shape(described: Any) -> tuple[int, ...]:
    shape = tuple(described[0])
    if any(type(length) is not int or length < 0 for length in shape):
        raise ValueError(f"a shape is whole numbers, not {described[0]!r:.40}")
    return shape


def _read_discrete(described: Any, reader: _Reader) -> SpaceLike:
    low, high = reader.take(INT, ()).astype(np.int64).tolist()
    dtype = _integers(described)
    # Gymnasium 1.0 has no other dtype.
    other: dict[str, Any] = {} if dtype == np.int64 else {"dtype": dtype}
    return spaces.Discrete(high - low + 1, start=low, **other)


def _read_multi_discrete(described: Any, reader: _Reader) -> SpaceLike:
    low, high = reader.take(INT, _shape(described)).astype(np.int64)
    return spaces.MultiDiscrete(high - low + 1, dtype=_integers(described[1]), start=low)


def _read_multi_binary(described: Any, reader: _Reader) -> SpaceLike:
    shape = _shape(described)
    reader.take(INT, shape)
    return spaces.MultiBinary(shape if len(shape) != 1 else shape[0])


def _read_box(described: Any, reader: _Reader) -> SpaceLike:
    shape, name = _shape(described), described[1]
    if name == "uint8":
        reader.take(CHAR, shape)
        low, high = described[2:] or (0, 255)
        return spaces.Box(*(_bytes(bound, shape) for bound in (low, high)), shape, np.uint8)
    if name in FLOATS:
        dtype = np.dtype(name)
        low, high = reader.take(DOUBLE, shape)
        return spaces.Box(low.astype(dtype), high.astype(dtype), shape, dtype.type)
    dtype = _integers(name)
    low, high = reader.take(INT, shape)
    return spaces.Box(low.astype(dtype), high.astype(dtype), shape, dtype.type)


def _bytes(bound: Any, shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
    return np.broadcast_to(
        np.array(bound, np.uint8).reshape(shape if isinstance(bound, list) else ()), shape
    ).copy()


def _integers(name: Any) -> np.dtype[Any]:
    dtype = np.dtype(str(name))
    if dtype.kind not in "iu":
        raise ValueError(f"{name!r:.40} is not a type of integers")
    return dtype


_KINDS: Final[dict[str, Callable[[Any, _Reader], SpaceLike]]] = {
    "Discrete": _read_discrete,
    "MultiDiscrete": _read_multi_discrete,
    "MultiBinary": _read_multi_binary,
    "Box": _read_box,
}


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

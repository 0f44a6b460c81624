"""Many environments in one session: observations, rewards and terminals of N games in one message.

An ordinary abstract type carries a batch; docs/protocol-reference.md has its layout, byte for byte.
Environment and agent both offer the capability `batch`: see `BatchEnvironment` and `BatchAgent` in
`glue.roles`. A game that is over begins its next episode at once, and shows its first observation. For a game
that was cut off, the last observation is in the batch as well, after all others.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.errors import RemoteProtocolError
from glue.types import CUT_OFF, PREFIX_SIZE, AbstractType, Action, Observation

_VERSION: Final = "VERSION RL-Glue-Batch-1 "
_HEAD: Final = re.compile(rf"{_VERSION}0*([1-9][0-9]{{0,8}})(?: |$)")
"""The start of a batch's task spec. N has at most 9 digits: more games would not fit into a message."""

_COUNTS: Final = 3
_PREFIX: Final = struct.Struct("<4I")
_INT: Final = np.dtype("<i4")
_DOUBLE: Final = np.dtype("<f8")
_CHAR: Final = np.dtype(np.uint8)
_UNSIGNED: Final = np.dtype("<u4")
"""The type that makes a negative number larger than any allowed one, so one comparison checks both limits."""

_NO_REWARDS: Final = np.empty(0, _DOUBLE)
_NO_TERMINALS: Final = np.empty(0, _INT)


class Ragged(NamedTuple):
    """Values of several games, one after the other: M of them, of which value `i` has `counts[i]`.

    Attributes:
        counts: ints, doubles and chars of each value, shape (M, 3), int32.
        ints: all ints, int32.
        doubles: all doubles, float64.
        chars: all chars, uint8.
    """

    counts: npt.NDArray[np.int32]
    ints: npt.NDArray[np.int32]
    doubles: npt.NDArray[np.float64]
    chars: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, values: Sequence[AbstractType]) -> Ragged:
        """Return `values`, concatenated."""
        counts = np.array([value.counts for value in values], np.int32).reshape(-1, _COUNTS)
        chars = np.frombuffer(b"".join([value.chars for value in values]), _CHAR)
        ints = [np.empty(0, np.int32), *(value.ints for value in values)]
        doubles = [np.empty(0), *(value.doubles for value in values)]
        return cls(counts, np.concatenate(ints), np.concatenate(doubles), chars)

    def values(self, kind: type[Any]) -> list[Any]:
        """Return each value on its own, as `kind`: Observation or Action."""
        ends = np.cumsum(self.counts, axis=0)
        starts = ends - self.counts
        return [
            kind(self.ints[i:i2], self.doubles[d:d2], self.chars[c:c2].tobytes())
            for (i, d, c), (i2, d2, c2) in zip(starts.tolist(), ends.tolist(), strict=True)
        ]


class Batch(NamedTuple):
    """The rewards, terminals and observations of one step, or the start, of N games.

    Attributes:
        rewards: shape (N,), float64; zeros at the start.
        terminals: shape (N,), int32: 0, 1 for an end, 2 (CUT_OFF) for a cut-off.
        observations: N observations, each of the next episode if one has ended or was cut off; then the last
            observation of each game that was cut off, in the order of the games.
    """

    rewards: npt.NDArray[np.float64]
    terminals: npt.NDArray[np.int32]
    observations: Ragged


def batch_task_spec(games: int, task_spec: str) -> str:
    """Return the task spec of `games` games, each with the given one."""
    return f"{_VERSION}{games} {task_spec}"


def read_batch_task_spec(text: str) -> tuple[int, str]:
    """Return the number of games, and the task spec of each.

    Raises:
        RemoteProtocolError: `text` is not the task spec of a batch.
    """
    head = _HEAD.match(text)
    if head is None:
        raise RemoteProtocolError(f"expected {_VERSION}N and a task spec; received {text!r:.80}")
    return int(head[1]), text[head.end() :]


def pack_batch(batch: Batch) -> Observation:
    """Return a batch as one observation."""
    rewards, terminals, values = batch
    return Observation.from_body(_join(len(rewards), rewards, terminals, values))


def unpack_batch(observation: Observation) -> Batch:
    """Return the batch that an observation carries; its arrays are read-only views.

    Raises:
        RemoteProtocolError: the observation carries no batch.
    """
    ints, doubles = observation.ints, observation.doubles
    games = int(ints[0]) if len(ints) else 0
    terminals = ints[1 : 1 + games]
    largest = CUT_OFF + 1 if games < 1 or len(terminals) != games else terminals.view(_UNSIGNED).max()
    if largest > CUT_OFF:
        raise RemoteProtocolError(f"a batch has N, then N terminals of 0, 1 or 2, not {ints!r:.50}")
    values = games
    if largest == CUT_OFF:
        values += int(np.count_nonzero(terminals == CUT_OFF))
    rest = _split(ints[1 + games :], doubles[games:], observation, values)
    return Batch(doubles[:games], terminals, rest)


def pack_actions(actions: Ragged) -> Action:
    """Return the actions of N games as one action."""
    return Action.from_body(_join(len(actions.counts), _NO_REWARDS, _NO_TERMINALS, actions))


def unpack_actions(action: Action, games: int) -> Ragged:
    """Return the actions of `games` games that an action carries; its arrays are read-only views.

    Raises:
        RemoteProtocolError: the action does not carry that many.
    """
    ints = action.ints
    if not len(ints) or ints[0] != games:
        raise RemoteProtocolError(f"expected the actions of {games} games; received {action!r:.80}")
    return _split(ints[1:], action.doubles, action, games)


def _join(
    games: int, rewards: npt.NDArray[np.float64], terminals: npt.NDArray[np.int32], values: Ragged
) -> bytes:
    """Return the body of an abstract type; every number is copied once, because there may be many."""
    ints = 1 + len(terminals) + values.counts.size + len(values.ints)
    doubles = len(rewards) + len(values.doubles)
    return b"".join(
        (
            _PREFIX.pack(ints, doubles, len(values.chars), 0),
            _row(rewards, _DOUBLE),
            _row(values.doubles, _DOUBLE),
            games.to_bytes(4, "little"),
            _row(terminals, _INT),
            _row(values.counts.T, _INT),
            _row(values.ints, _INT),
            _row(values.chars, _CHAR),
        )
    )


def _row(numbers: npt.NDArray[Any], dtype: np.dtype[Any]) -> memoryview:
    """Return the bytes of an array, copied only if its type differs or it is not contiguous."""
    return np.ascontiguousarray(numbers, dtype).data


def _split(
    ints: npt.NDArray[np.int32], doubles: npt.NDArray[np.float64], whole: AbstractType, values: int
) -> Ragged:
    """Return `values` values: their counts come first in `ints`, and their chars are those of `whole`."""
    size = _COUNTS * values
    if len(ints) < size:
        raise RemoteProtocolError(f"a batch of {values} values has {size} counts; {len(ints)} ints are left")
    all_ints, all_doubles, num_chars = whole.counts
    chars = np.frombuffer(whole.body, _CHAR, num_chars, PREFIX_SIZE + 8 * all_doubles + 4 * all_ints)
    counts = ints[:size].reshape(_COUNTS, values)
    ragged = Ragged(counts.T, ints[size:], doubles, chars)
    received = [len(ragged.ints), len(doubles), num_chars]
    stated = counts.view(_UNSIGNED).sum(axis=1, dtype=np.uint64).tolist()
    if stated != received:
        raise RemoteProtocolError(
            f"a batch states {counts.sum(axis=1).tolist()} ints, doubles and chars, and has {received}"
        )
    return ragged

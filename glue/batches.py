"""Many environments in one session: observations, rewards and terminals of N games in one message.

A batch is carried by an ordinary abstract type; docs/protocol.md has its layout, byte for byte. Environment
and agent both offer the capability `batch`: see `BatchEnvironment` and `BatchAgent` in `glue.roles`. A game
that is over begins its next episode at once, and shows the first observation of it. Of a game that was cut
off, the last observation is in the batch as well, behind all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.errors import RemoteProtocolError
from glue.types import CUT_OFF, AbstractType, Action, Observation

__all__ = [
    "Batch",
    "Ragged",
    "batch_task_spec",
    "pack_actions",
    "pack_batch",
    "read_batch_task_spec",
    "unpack_actions",
    "unpack_batch",
]

_VERSION: Final = "VERSION RL-Glue-Batch-1 "

_COUNTS: Final = 3
_CHAR: Final = np.dtype(np.uint8)


class Ragged(NamedTuple):
    """Values of several games, one after the other: M of them, of which game `i` has `counts[i]`.

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
        """Return `values` side by side."""
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
    """What N games have to say.

    Attributes:
        rewards: shape (N,), float64; zeros at the start.
        terminals: shape (N,), int32: 0, 1 for an end, 2 (CUT_OFF) for a cut-off.
        observations: N of them, those of the next episode where one has ended or was cut off; then the last
            observation of each game that was cut off, in the order of the games.
    """

    rewards: npt.NDArray[np.float64]
    terminals: npt.NDArray[np.int32]
    observations: Ragged


def batch_task_spec(games: int, task_spec: str) -> str:
    """Return the task spec of `games` games that each have the given one."""
    return f"{_VERSION}{games} {task_spec}"


def read_batch_task_spec(text: str) -> tuple[int, str]:
    """Return how many games there are, and the task spec of each.

    Raises:
        RemoteProtocolError: it is not the task spec of a batch.
    """
    games, _, task_spec = text.removeprefix(_VERSION).partition(" ")
    if not text.startswith(_VERSION) or not games.isascii() or not games.isdigit() or int(games) < 1:
        raise RemoteProtocolError(f"expected {_VERSION}N and a task spec; received {text!r:.80}")
    return int(games), task_spec


def pack_batch(batch: Batch) -> Observation:
    """Return a batch as one observation."""
    rewards, terminals, values = batch
    ints = np.concatenate([[np.int32(len(rewards))], terminals, values.counts.T.reshape(-1), values.ints])
    doubles = np.concatenate([rewards, values.doubles])
    return Observation(ints.astype(np.int32, copy=False), doubles, values.chars.tobytes())


def unpack_batch(observation: Observation) -> Batch:
    """Return the batch that an observation carries; its arrays are views.

    Raises:
        RemoteProtocolError: it carries none.
    """
    ints, doubles = observation.ints, observation.doubles
    games = int(ints[0]) if len(ints) else 0
    terminals = ints[1 : 1 + games]
    if games < 1 or len(terminals) != games or terminals.min() < 0 or terminals.max() > CUT_OFF:
        raise RemoteProtocolError(f"a batch has N, then N terminals of 0, 1 or 2, not {ints!r:.50}")
    values = games + int(np.count_nonzero(terminals == CUT_OFF))
    rest = _ragged(ints[1 + games :], doubles[games:], observation.chars, values)
    return Batch(doubles[:games], terminals, rest)


def pack_actions(actions: Ragged) -> Action:
    """Return the actions of N games as one."""
    ints = np.concatenate([[np.int32(len(actions.counts))], actions.counts.T.reshape(-1), actions.ints])
    return Action(ints.astype(np.int32, copy=False), actions.doubles, actions.chars.tobytes())


def unpack_actions(action: Action, games: int) -> Ragged:
    """Return the actions of `games` games that an action carries; its arrays are views.

    Raises:
        RemoteProtocolError: it does not carry that many.
    """
    ints = action.ints
    if not len(ints) or ints[0] != games:
        raise RemoteProtocolError(f"expected the actions of {games} games; received {action!r:.80}")
    return _ragged(ints[1:], action.doubles, action.chars, games)


def _ragged(
    ints: npt.NDArray[np.int32], doubles: npt.NDArray[np.float64], chars: bytes, values: int
) -> Ragged:
    size = _COUNTS * values
    if len(ints) < size:
        raise RemoteProtocolError(f"a batch of {values} values has {size} counts; {len(ints)} ints are left")
    counts = ints[:size].reshape(_COUNTS, values).T
    ragged = Ragged(counts, ints[size:], doubles, np.frombuffer(chars, _CHAR))
    received = [len(ragged.ints), len(doubles), len(chars)]
    stated = counts.sum(axis=0, dtype=np.int64).tolist()
    if counts.min() < 0 or stated != received:
        raise RemoteProtocolError(f"a batch states {stated} ints, doubles and chars, and has {received}")
    return ragged

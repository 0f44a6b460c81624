"""SARSA(0) on a table of values, one per key; epsilon-greedy choice by a given generator, and the keys.

A state may have several features; then the value of an action is the sum of one learned value per
feature, and an update is divided equally among them. With one feature this is the plain table.
Keys that were never updated have the value 0.
Source: Sutton and Barto, chapters 6 and 9; Mohan (2010).

The generator is SplitMix64, a 64-bit counter put through a mixing function: one word of state, so
that a draw costs nanoseconds and a saved agent continues with the same draws. The same function makes
the keys: a feature is a row of integers, identified by a 64-bit hash of them, so that no kind of state needs
its own encoding. The chance that a table of a million values has two features under one key is 3e-8.
Source: Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators.
"""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import entry, jit
from glue.compiled.records import Array, Flag, Int, Real, Word, layout
from glue.errors import SaveError

_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
_FIRST: Final = np.uint64(0xBF58476D1CE4E5B9)
_SECOND: Final = np.uint64(0x94D049BB133111EB)
_11: Final = np.uint64(11)
_27: Final = np.uint64(27)
_30: Final = np.uint64(30)
_31: Final = np.uint64(31)


class Learner:
    """The state of a learner apart from its table: hyperparameters, generator and counters.

    cycles   decision cycles so far, which shrink epsilon
    entries  values in the table
    errors   sum of the absolute TD errors of the episode
    updates  number of updates in the episode
    """

    step_size: Real
    discount: Real
    epsilon: Real
    reduction: Real
    learning: Flag
    random: Word
    cycles: Int
    entries: Int
    errors: Real
    updates: Int


def seeded(seed: int) -> np.uint64:
    """Return the generator state for a seed, 0 <= seed."""
    return np.uint64(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


@jit
def mix(word: np.uint64) -> np.uint64:
    """Return `word` scrambled: one to one, and any bit of it changes half the bits of the result."""
    word = (word ^ (word >> _30)) * _FIRST
    word = (word ^ (word >> _27)) * _SECOND
    return word ^ (word >> _31)


@jit
def uniform(chooser: Learner) -> float:
    """Draw from [0, 1), a multiple of 2**-53."""
    chooser.random += _GOLDEN
    return float(mix(chooser.random) >> _11) * 2.0**-53


@jit
def below(chooser: Learner, count: int) -> int:
    """Draw one of 0 .. count - 1, all equally likely; nothing is drawn if there is only one."""
    if count == 1:
        return 0
    return int(uniform(chooser) * count)


@jit
def epsilon_greedy(chooser: Learner, values: npt.NDArray[np.float64], count: int) -> int:
    """Choose among the first `count` values: any with the chance to explore, otherwise one of the largest.

    Source: Mohan (2010), epsilon-greedy exploration; ties as Soar breaks them, at random.
    """
    if count == 1:
        return 0
    if uniform(chooser) < chooser.epsilon * chooser.reduction ** float(chooser.cycles):
        return below(chooser, count)
    best = values[0]
    ties = 1
    for i in range(1, count):
        if values[i] > best:
            best = values[i]
            ties = 1
        elif values[i] == best:
            ties += 1
    place = below(chooser, ties)
    for i in range(count):
        if values[i] == best:
            if place == 0:
                return i
            place -= 1
    return 0


@jit
def feature(first: int) -> np.uint64:
    """Return the key of the row (first,)."""
    return mix(np.uint64(first) + _GOLDEN)


@jit
def extend(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the row of `key` with `number` appended."""
    return mix(key + np.uint64(number) + _GOLDEN)


Keys = npt.NDArray[np.uint64]
Values = npt.NDArray[np.float64]

MAX_FEATURES: Final = 512
_SMALLEST: Final = 4096
_FREE: Final = np.uint64(0)
_MAX_PROBES: Final = 64
"""Probes per key while a table is filled, on average; hashed keys need 0.2."""


class Entry:
    """One slot of a value table, free when the key is 0."""

    key: Word
    value: Real


class Taken:
    """The features of the action whose value is updated next."""

    count: Int
    keys: Annotated[Keys, np.uint64, MAX_FEATURES]


@jit
def action_values(table: Array, states: Keys, count: int, values: Values) -> None:
    """Fill in `values`, one per action: the sum of the values learned for each of `count` features."""
    for action in range(len(values)):
        total = 0.0
        for i in range(count):
            total += table[_place(table, extend(states[i], action))].value
        values[action] = total


@jit
def take(taken: Taken, states: Keys, count: int, action: int) -> None:
    """Record that `action` was taken in the state of these `count` features."""
    taken.count = count
    for i in range(count):
        taken.keys[i] = extend(states[i], action)


@jit
def sum_of_values(table: Array, keys: Keys, count: int) -> float:
    """Return the sum of the values of the first `count` keys."""
    total = 0.0
    for i in range(count):
        total += table[_place(table, keys[i])].value
    return total


@jit
def update(learner: Learner, table: Array, taken: Taken, target: float) -> None:
    """Move the value of the action taken towards `target` by the step size. The table must have room."""
    if taken.count == 0 or not learner.learning:
        return
    error = target - sum_of_values(table, taken.keys, taken.count)
    learner.errors += abs(error)
    learner.updates += 1
    share = learner.step_size / taken.count * error
    for i in range(taken.count):
        entry = table[_place(table, taken.keys[i])]
        if entry.key == _FREE:
            entry.key = taken.keys[i]
            learner.entries += 1
        entry.value += share


@jit
def has_room(learner: Learner, table: Array, count: int) -> bool:
    """Return whether `count` more keys leave half of the table free, which keeps look-ups fast."""
    return 2 * (learner.entries + count) <= len(table)


@jit
def _place(table: Array, key: np.uint64) -> int:
    """Return the slot of `key` in the table, or the free slot where it belongs."""
    last = np.uint64(len(table) - 1)
    place = key & last
    while table[place].key != key and table[place].key != _FREE:
        place = (place + np.uint64(1)) & last
    return int(place)


@entry
def _fill(table: Array, keys: Keys, values: Values) -> bool:
    """Add values to a table; return False when that takes far more than the usual number of probes."""
    last = np.uint64(len(table) - 1)
    probes = 0
    for i in range(len(keys)):
        place = _place(table, keys[i])
        probes += int((np.uint64(place) - keys[i]) & last)
        if probes > _MAX_PROBES * (i + 1):
            return False
        table[place].key = keys[i]
        table[place].value = values[i]
    return True


def table_of(keys: Keys, values: Values, size: int = _SMALLEST) -> Array:
    """Return a table of at least `size` slots, at most a quarter of them taken, with these values.

    Raises:
        SaveError: too many keys collide. Those of a learner are hashes and do not; those of a forged save
            would make every look-up slow.
    """
    while size < 4 * len(keys):
        size *= 2
    table = np.zeros(size, layout(Entry))
    if not _fill(table, keys, values):
        raise SaveError("the keys of this save collide with each other: no agent can have learned them")
    return table


def contents(table: Array) -> tuple[Keys, Values]:
    """Return the keys of a table, ascending, and their values."""
    taken = np.sort(table[table["key"] != _FREE], order="key")
    return np.ascontiguousarray(taken["key"]), np.ascontiguousarray(taken["value"])


def grown(table: Array) -> Array:
    """Return a table of twice the size with the same values."""
    return table_of(*contents(table), size=2 * len(table))

"""The numbers of learning agents: epsilon-greedy choice by a given generator, and keys of learned values.

The generator is SplitMix64, a 64-bit counter put through a mixing function: one word of state, so
that a draw costs nanoseconds and a saved agent continues with the same draws. The same function makes
the keys: a feature is a row of integers, identified by a 64-bit hash of them, so that no kind of state needs
its own encoding. The chance that a table of a million values has two features under one key is 3e-8.
Source: Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import jit

_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
_FIRST: Final = np.uint64(0xBF58476D1CE4E5B9)
_SECOND: Final = np.uint64(0x94D049BB133111EB)
_11: Final = np.uint64(11)
_27: Final = np.uint64(27)
_30: Final = np.uint64(30)
_31: Final = np.uint64(31)


class Chooser(Protocol):
    """The fields that a record needs to choose: a generator's state and the chance to explore.

    After `cycles` decision cycles that chance is epsilon * reduction ** cycles.
    """

    random: np.uint64
    epsilon: float
    reduction: float
    cycles: int


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
def uniform(chooser: Chooser) -> float:
    """Draw from [0, 1), a multiple of 2**-53."""
    chooser.random += _GOLDEN
    return float(mix(chooser.random) >> _11) * 2.0**-53


@jit
def below(chooser: Chooser, count: int) -> int:
    """Draw one of 0 .. count - 1, all equally likely; nothing is drawn if there is only one."""
    if count == 1:
        return 0
    return int(uniform(chooser) * count)


@jit
def epsilon_greedy(chooser: Chooser, values: npt.NDArray[np.float64], count: int) -> int:
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

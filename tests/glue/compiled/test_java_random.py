"""The generator against published draws of Java, and against its rule in unbounded integers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.compiled.java_random import draw, draw_double, seeded

_SEEDS = st.integers(-(2**63), 2**63 - 1)


def java(seed: int, bounds: list[int]) -> list[int]:
    """Draw as java.util.Random's documentation says."""
    state = (seed ^ 0x5DEECE66D) % 2**48
    drawn = []
    for bound in bounds:
        while True:
            state = (state * 0x5DEECE66D + 11) % 2**48
            bits = state >> 17
            if bound & -bound == bound:
                drawn.append(bound * bits >> 31)
                break
            if bits - bits % bound + bound - 1 < 2**31:
                drawn.append(bits % bound)
                break
    return drawn


def test_draws_of_seed_121() -> None:
    state = seeded(121)
    assert [draw(state, 10) for _ in range(12)] == [3, 6, 6, 8, 1, 9, 0, 9, 7, 9, 3, 7]
    state = seeded(121)
    assert [draw(state, 4) for _ in range(12)] == [2, 3, 1, 3, 1, 0, 0, 1, 2, 1, 0, 1]


@given(seed=_SEEDS, bounds=st.lists(st.integers(1, 2**31 - 1), max_size=20))
def test_draws_as_java_documents_them(seed: int, bounds: list[int]) -> None:
    state = seeded(seed)
    assert [draw(state, bound) for bound in bounds] == java(seed, bounds)


@pytest.mark.parametrize(
    ("seed", "draws"),
    [
        (0, [0.730967787376657, 0.24053641567148587, 0.6374174253501083]),
        (42, [0.7275636800328681, 0.6832234717598454, 0.30871945533265976]),
        (42 + 2**48, [0.7275636800328681]),
    ],
)
def test_doubles_are_those_of_java(seed: int, draws: list[float]) -> None:
    """Numbers as `new Random(seed).nextDouble()` gives them; the lowest 48 bits of a seed count."""
    state = seeded(seed)
    assert [draw_double(state) for _ in draws] == draws

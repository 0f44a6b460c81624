from __future__ import annotations

import math

from experiment_runner.store.records import EpisodeResult


def test_an_unknown_value_of_a_measure_repeats_any_other() -> None:
    known, unknown = EpisodeResult(1, 2.0, 7, True, 0.1), EpisodeResult(1, math.nan, 7, True, 0.3)
    assert known.repeats(unknown)
    assert unknown.repeats(unknown)
    assert not known.repeats(EpisodeResult(1, 3.0, 7, True, 0.1))
    assert not unknown.repeats(EpisodeResult(1, math.nan, 8, True, 0.3))

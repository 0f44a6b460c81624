"""Suggestions for unknown words."""

from __future__ import annotations

from glue.suggestions import did_you_mean


def test_near_misses_come_first() -> None:
    assert did_you_mean("minez", ["mario", "mines", "skeleton"]) == "; did you mean mines?"
    assert did_you_mean("tile", ["tiles", "tiless", "x"]) == "; did you mean tiles or tiless?"
    for typo in ("srasa", "sasra", "sarsaa", "sara", "asrsa"):
        assert did_you_mean(typo, ["random", "sarsa", "soar-mines"]) == "; did you mean sarsa?"


def test_without_a_near_miss_the_choices_are_listed_up_to_a_limit() -> None:
    assert did_you_mean("?", ["mines", "mario"]) == "; choose from mines, mario"
    assert did_you_mean("?", []) == ""
    assert did_you_mean("?", map(str, range(1000))).endswith("28, 29, ...")

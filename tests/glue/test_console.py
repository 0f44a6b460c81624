"""Texts of others on their way to a terminal, a page or a spreadsheet."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.console import cell, did_you_mean, for_terminal, one_line, printable, say

HOSTILE = "\x1b[2Ja\r\u202eb\nError: \x9bforged\udcff\u2028"


@given(st.text())
def test_whatever_comes_is_shown_as_printable_lines(text: str) -> None:
    assert printable(text).replace("\n", "").isprintable()
    assert one_line(text).isprintable()
    first, *others = for_terminal(text).split("\n")
    assert first.isprintable()
    assert all(line.startswith("  ") and line.isprintable() for line in others)
    assert not cell(text).startswith(("=", "+", "-", "@"))
    assert cell(text).isprintable()


@pytest.mark.parametrize("text", ["", "plain", "größer 大きい 🙂", "a b"])
def test_what_is_printable_stays_as_it_is(text: str) -> None:
    assert printable(text) == one_line(text) == for_terminal(text) == cell(text) == text


def test_lines_have_a_bound_and_keep_their_end() -> None:
    line = one_line("x" * 6000 + " remedy")
    assert len(line) == 1000
    assert line.endswith("remedy")
    assert len(one_line("x" * 6000, 300)) == 300
    assert [len(each) for each in for_terminal(f"{'x' * 6000}\n{'y' * 6000}").split("\n")] == [1000, 1002]


def test_no_line_of_others_looks_like_one_of_ours(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"Error: no run in {HOSTILE}")
    assert capsys.readouterr().err == "Error: no run in ?[2Ja??b\n  Error: ?forged??\n"


def test_near_misses_come_first() -> None:
    assert did_you_mean("minez", ["mario", "mines", "skeleton"]) == "; did you mean mines?"
    assert did_you_mean("tile", ["tiles", "tiless", "x"]) == "; did you mean tiles or tiless?"
    for typo in ("srasa", "sasra", "sarsaa", "sara", "asrsa"):
        assert did_you_mean(typo, ["random", "sarsa", "soar-mines"]) == "; did you mean sarsa?"


def test_without_a_near_miss_the_choices_are_listed_up_to_a_limit() -> None:
    assert did_you_mean("?", ["mines", "mario"]) == "; choose from mines, mario"
    assert did_you_mean("?", []) == ""
    assert did_you_mean("?", map(str, range(1000))).endswith("28, 29, ...")

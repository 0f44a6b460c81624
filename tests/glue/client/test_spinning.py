"""A spin finds an arrival, gives up when its time is over, and is skipped where spinning cost too much."""

from __future__ import annotations

import time

import pytest

from glue.system import clock, spinning
from glue.system.spinning import Spin

ENDLESS = 60.0


class Arriving:
    """A source that has something at its poll number `at` only."""

    def __init__(self, at: int) -> None:
        self.looks = 0
        self._at = at

    def __call__(self) -> str | None:
        self.looks += 1
        return "here" if self.looks == self._at else None


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other programs may take the core from this test at any time."""
    monkeypatch.setattr(spinning, "_LOST_SECONDS", ENDLESS)


def test_arrivals_are_found() -> None:
    assert Spin(ENDLESS).until_found(Arriving(50)) == "here"


def test_each_spin_without_success_doubles_the_number_of_waits_without_one() -> None:
    spin, nothing = Spin(0.0), Arriving(-1)
    for _ in range(2 + 4 + 8 + 3):
        assert spin.until_found(nothing) is None
    assert nothing.looks == 3


def test_a_core_that_was_lost_to_another_program_is_not_yielded_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(spinning, "_LOST_SECONDS", 0.001)
    monkeypatch.setattr(spinning, "SEVERAL_CORES", False)
    monkeypatch.setattr(spinning, "_REST", 1e5)
    monkeypatch.setattr(clock, "give_way", lambda: time.sleep(0.002))
    spin, nothing = Spin(ENDLESS), Arriving(-1)
    for _ in range(100):
        assert spin.until_found(nothing) is None
    assert nothing.looks == 1

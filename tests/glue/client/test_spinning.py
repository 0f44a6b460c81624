"""A spin finds an arrival, gives up when its time is over, and is skipped where spinning cost too much."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from glue.system import clock, spinning
from glue.system.spinning import Spin, cores_are_free

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


def test_a_core_that_another_program_took_is_not_yielded_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spinning, "_LOST_SECONDS", 0.001)
    monkeypatch.setattr(spinning, "SEVERAL_CORES", False)
    monkeypatch.setattr(spinning, "_REST", 1e5)
    monkeypatch.setattr(clock, "give_way", lambda: time.sleep(0.002))
    spin, nothing = Spin(ENDLESS), Arriving(-1)
    for _ in range(100):
        assert spin.until_found(nothing) is None
    assert nothing.looks == 1


def test_a_spin_that_needs_free_cores_is_left_out_while_there_are_none() -> None:
    free = iter([True, False, True, False])
    spin, there = Spin(ENDLESS, lambda: next(free)), Arriving(1)
    found = []
    for _ in range(3 * 64 + 2):
        there.looks = 0
        found.append(spin.until_found(there))
    assert found == ["here"] * 64 + [None] * 65 + ["here"] * 64 + [None]


def test_cores_are_free_if_all_programs_that_want_to_run_have_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: range(10**6), raising=False)
    assert cores_are_free() is Path("/proc/loadavg").exists()
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: (), raising=False)
    assert not cores_are_free()


@pytest.mark.parametrize("text", ["", "0.10 0.20 0.30\n", "0.10 0.20 0.30 many/200 7\n", None])
def test_where_the_load_is_hidden_no_core_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str | None
) -> None:
    file = tmp_path / "loadavg"
    if text is not None:
        file.write_text(text)
    monkeypatch.setattr(spinning, "_LOAD", file)
    assert not cores_are_free()

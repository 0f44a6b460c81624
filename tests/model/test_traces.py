"""Simulated runs of the hub and its players are behaviours of docs/model/Glue.tla."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.model.test_model import FOLDER, tlc, with_tlc
from tests.simulation.tracing import Line, module, traced

RUNS = 200


def followed(folder: Path, runs: list[tuple[int, list[Line]]]) -> set[int]:
    """Return the indices of the runs that TLC follows to their end."""
    for file in ("Glue.tla", "Trace.tla"):
        shutil.copy(FOLDER / file, folder)
    (folder / "Simulated.tla").write_text(module(runs), encoding="utf-8")
    output = tlc(folder, 1, FOLDER / "Trace.cfg", "Trace.tla")
    assert "No error has been found." in output, output[-5000:]
    return {int(number) - 1 for number in re.findall(r'<<"followed", (\d+)>>', output)}


@with_tlc
@pytest.mark.timeout(1200)
def test_every_run_is_a_behaviour_of_the_model(tmp_path: Path) -> None:
    runs = [traced(seed) for seed in range(RUNS)]
    assert sum(line.void for _, lines in runs for line in lines) > 20
    assert sum(line.event == "kill" for _, lines in runs for line in lines) > 20

    assert set(range(RUNS)) - followed(tmp_path, runs) == set()


@with_tlc
@pytest.mark.timeout(1200)
def test_what_no_hub_may_do_is_no_behaviour_of_the_model(tmp_path: Path) -> None:
    first, lines = traced(0)
    at = next(at for at, line in enumerate(lines) if line.event == "call")
    twice = [*lines[: at + 1], *lines[at:]]
    other = [*lines[:at], lines[at]._replace(number=lines[at].number + 1), *lines[at + 1 :]]

    assert followed(tmp_path, [(first, lines), (first, twice), (first, other)]) == {0}

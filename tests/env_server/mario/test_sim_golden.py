"""The simulator against recordings of the original: not one bit may differ."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.env_server.mario import golden_check
from tests.proof import size


@pytest.mark.parametrize(("name", "expected"), [("episodes", 25726), ("variants", 697)])
def test_recorded_runs_are_reproduced(name: str, expected: int) -> None:
    compared, differences = golden_check.check_runs(name)
    assert differences == []
    assert compared == expected


TICKS = {"dev-0050": 210} | size({}, {"dev-0003": 2021, "dev-0005": 1835, "dev-0006": 1213, "dev-0029": 1399})
STEPS = {"dev-0083": 54, "dev-0084": 45, "dev-0086": 3} | size({}, {"dev-0009": 420})


@pytest.mark.slow
@pytest.mark.proof
def test_uncompiled_rules_reproduce_every_tick() -> None:
    run = subprocess.run(
        [sys.executable, "-W", "error", golden_check.__file__ or "", ",".join(TICKS), ",".join(STEPS)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert found == {"ticks": [sum(TICKS.values()), []], "steps": [sum(STEPS.values()), []]}

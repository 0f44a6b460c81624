"""The sources of the secret seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiment_runner.competition.trials import read_secret
from tests.experiment_runner.competition.players import competition


@pytest.mark.parametrize(("mode", "warned"), [(0o600, False), (0o640, True), (0o604, True)])
def test_a_secret_that_other_users_can_read_is_warned_of(tmp_path: Path, mode: int, warned: bool) -> None:
    file = tmp_path / "secret.txt"
    file.write_text("hush\n")
    file.chmod(mode)
    warnings: list[str] = []
    assert read_secret(replace(competition("alice"), seed_file=file), {}, warnings.append) == b"hush"
    assert [f"chmod 600 {file}" in line for line in warnings] == [True] * warned

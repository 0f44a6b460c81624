"""A random attacker: honest sessions are undisturbed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.proof import size
from tests.system.attacks.siege import besiege


@pytest.mark.stage("attacks")
@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("keyed", [False, True], ids=["without keys", "with keys"])
def test_honest_sessions_play_beside_an_attacker_as_if_alone(keyed: bool, tmp_path: Path) -> None:
    besiege(size(1.0, 300.0), keyed, tmp_path)

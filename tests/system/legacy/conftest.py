"""A hub with a port for original programs."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.system.legacy.legacy_rig import Rig, gateway


@pytest.fixture
def rig() -> Iterator[Rig]:
    with gateway() as rig:
        yield rig

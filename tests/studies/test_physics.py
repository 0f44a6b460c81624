"""The study of unknown constants: the planner identifies them."""

from __future__ import annotations

import pytest

from glue.errors import ConfigError
from studies.physics import outcomes, physics_table


def test_constants_are_identified_in_the_study() -> None:
    groups = ("instance-7", "random")
    played = [list(outcomes(group, 2)) for group in groups]
    for found in played:
        assert all(one.identified <= 10 for one in found)
        assert all(one.predicted > 0.9 for one in found)
    assert "| instance-7 | 2 | 1.000 |" in physics_table(groups, played)
    with pytest.raises(ConfigError):
        next(outcomes("instance-10", 1))

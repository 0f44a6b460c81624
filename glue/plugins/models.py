"""Models of environments, which agents plan with: found by name in the entry-point group `glue.models`."""

from __future__ import annotations

from typing import Any

from glue.errors import ConfigError
from glue.installed import entry_points


def find_model(name: str) -> Any:
    """Return the model of the environment called `name`: a module of compiled functions.

    Raises:
        ConfigError: no installed package offers one.
    """
    for point in entry_points("glue.models").select(name=name):
        return point.load()
    raise ConfigError(
        f"no model of {name} is installed: agents that plan take it from the package of the environment, "
        "by its entry-point group glue.models"
    )

"""OpenEnv, both ways: docs/openenv.md.

glue-env openenv:http://127.0.0.1:8000     # an OpenEnv server as an environment here
glue-env mario --openenv 127.0.0.1:8000    # an environment of ours for OpenEnv's clients
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING

from glue.errors import ConfigError

if TYPE_CHECKING:
    from glue.roles import Environment


def environment_class(url: str) -> type[Environment]:
    """Return a class that plays the OpenEnv server at `url`; see `glue.openenv.environment`.

    Raises:
        ConfigError: `url` is not the address of a server, or OpenEnv is not installed.
    """
    _require()
    from glue.openenv import environment

    return environment.environment_class(url)


def serve(make: Callable[[], Environment], name: str, address: str, *, insecure: bool = False) -> None:
    """Serve environments to OpenEnv's clients; see `glue.openenv.serving.serve`.

    Raises:
        ConfigError: see there, or OpenEnv is not installed.
    """
    _require()
    from glue.openenv import serving

    serving.serve(make, name, address, insecure=insecure)


def _require() -> None:
    if find_spec("openenv") is None or find_spec("gymnasium") is None:
        raise ConfigError("OpenEnv needs its package: pip install 'glue-rl[openenv]'")

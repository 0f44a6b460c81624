"""Players written for other Python packages called rlglue, served unchanged: `glue-agent rlglue:my.py:Agent`.

There are two: the Python codec of RL-Glue 3 (Lee and Tanner, 2009), whose classes have RL-Glue's own method
names, and rlglue-andnp, whose agents have `start`, `step` and `end`. The methods of a class tell them apart.
"""

from __future__ import annotations

from glue.errors import ConfigError
from glue.plugins.loading import find
from glue.rlglue.adapters import AndnpAgent, AndnpEnvironment, CodecAgent, CodecEnvironment, adapted
from glue.rlglue.package import provide
from glue.wire.messages import Role

__all__ = ["agent_class", "environment_class"]


def agent_class(name: str) -> type:
    """Return the class that serves agents of the class `name`.

    Args:
        name: `module:Class` or `path/to/file.py:Class`.

    Raises:
        ConfigError: there is no such class, it has the methods of neither package, or its constructor has a
            parameter without default.
    """
    return _adapted(Role.AGENT, name, {"agent_": CodecAgent, "": AndnpAgent})


def environment_class(name: str) -> type:
    """Return the class that serves environments of the class `name`; otherwise as `agent_class`."""
    return _adapted(Role.ENVIRONMENT, name, {"env_": CodecEnvironment, "": AndnpEnvironment})


def _adapted(role: Role, name: str, adapters: dict[str, type]) -> type:
    provide()
    found = find(role, name)
    for prefix, adapter in adapters.items():
        if all(callable(getattr(found, f"{prefix}{verb}", None)) for verb in ("start", "step")):
            return adapted(adapter, found)
    wanted = " nor ".join(f"{prefix}start and {prefix}step" for prefix in adapters)
    raise ConfigError(f"rlglue:{name} is no {role} of either package called rlglue: it has neither {wanted}")

"""RL-Glue over ZeroMQ and msgpack: the interface, the protocol and the hub."""

from glue.types import Action, Observation

__version__ = "0.1.0"

__all__ = ["Action", "Observation", "__version__"]

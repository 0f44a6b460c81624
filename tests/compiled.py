"""Functions that only compiled code calls, as tests call them: kept on disk once they are compiled.

Otherwise each process of the tests would compile them anew, with all that they call. `tests.compile`
compiles them after the code that calls them, when most of the work is done.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from agents.mario import objects
from agents.mario import observation as agent_observation
from env_server.mario import observation
from env_server.mario.sim import blocks, step
from glue.compiled.jit import entry

__all__ = ["encode", "hit_block", "look", "read", "tick"]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _kept(function: _Function) -> _Function:
    return entry(cast(_Function, getattr(function, "py_func", function)))


tick = _kept(step.tick)
hit_block = _kept(blocks.hit_block)
encode = _kept(observation.encode)
look = _kept(objects.look)
read = _kept(agent_observation.read)

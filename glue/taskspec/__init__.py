"""The RL-Glue task spec language, which describes an environment's observations, actions and rewards.

    spec = parse_task_spec(text)
    spec.actions.ints[0].high        # the maximum of the first int of an action
    spec.actions.check(action)       # None, or why the action is not legal
    str(spec)                        # the canonical text

`parse_task_spec` is tolerant, `str` is canonical, and a printed spec reads back to an equal value.
docs/taskspec.md lists the deviations that are tolerated and those that are refused.
Source: RL-Glue 3.0 task spec language; for Mario-v1, RL-Competition 2009.
"""

from __future__ import annotations

from glue.taskspec.masks import legal_values, mask_sizes
from glue.taskspec.parser import MARIO, MAX_LENGTH, RL_GLUE_3, TaskSpec, parse_task_spec
from glue.taskspec.space import NEGINF, POSINF, UNSPEC, Bound, Range, Ranges, Space

__all__ = [
    "MARIO",
    "MAX_LENGTH",
    "NEGINF",
    "POSINF",
    "RL_GLUE_3",
    "UNSPEC",
    "Bound",
    "Range",
    "Ranges",
    "Space",
    "TaskSpec",
    "legal_values",
    "mask_sizes",
    "parse_task_spec",
]

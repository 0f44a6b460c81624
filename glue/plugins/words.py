"""Environments in words, for agents that read: found by the name that a task spec gives its environment.

That name is the first word of EXTRA or, where the format is the environment's own, the name of the format
without its version: `mines`, or `mario` for Mario-v1. An environment's words are its entry point in the group
`glue.words`, a module or anything else that has some of the attributes of `Words`; its picture in characters
is that in `glue.renderers`. It needs neither.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from glue.installed import entry_points
from glue.taskspec import RL_GLUE_3, Space, TaskSpec
from glue.types import Action, Observation

_NAME: Final = re.compile(r"[\w-]{1,64}")
_VERSION: Final = re.compile(r"-v\d+$")


@dataclass(frozen=True, slots=True)
class Words:
    """An environment's description of itself, for a language model.

    Args:
        rules: what happens in the task, what pays, and how to read the picture.
        actions: legal actions by their names; the names have no comma and no `*`.
        image: returns a picture of an observation, as PNG.
        observations: of the environment; another one of its name has neither its words nor its picture. None
            for any.
    """

    rules: str
    actions: Mapping[str, Action]
    image: Callable[[Observation], bytes] | None = None
    observations: Space | None = None


def find_words(spec: TaskSpec) -> Words:
    """Return the words of the environment of a task spec; empty ones if none are installed."""
    found = _offered("glue.words", spec)
    rules, actions = getattr(found, "rules", ""), getattr(found, "actions", {})
    return Words(rules, actions, getattr(found, "image", None), getattr(found, "observations", None))


def find_picture(spec: TaskSpec) -> Callable[[Observation, bool], list[str]] | None:
    """Return the drawing, in characters, of the environment of a task spec; None if it has none."""
    draw: Callable[[Observation, bool], list[str]] | None = _offered("glue.renderers", spec)
    return draw


def _offered(group: str, spec: TaskSpec) -> Any:
    return next((point.load() for point in entry_points(group).select(name=_name(spec))), None)


def _name(spec: TaskSpec) -> str:
    source = spec.extra if spec.version == RL_GLUE_3 else _VERSION.sub("", spec.version)
    first = _NAME.match(source)
    return first[0].lower() if first else ""

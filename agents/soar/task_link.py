"""Any task on the input link: the numbers of an observation by their positions, its chars as one text.

    (<input-link> ^observation <o> ^task <t>)
    (<o> ^int-1 5 ^int-2 0 ^double-1 0.25 ^chars |abc|)      the observation, counted from 1
    (<t> ^spec |VERSION RL-Glue-3.0 ...| ^int-1 <r>)         the task spec, and the ranges of the action
    (<r> ^low 0 ^high 3)                                     only the finite bounds

An action is (<output-link> ^action <a>) with (<a> ^int-1 2 ^double-1 0.5 ^chars |x|): everything that the
task spec says an action has, and a ^step if that helps to remove the action later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from agents.soar.kernel import Element, Kernel, SoarError, SoarLink
from glue.errors import ConfigError, RemoteProtocolError
from glue.taskspec import Range, TaskSpec
from glue.types import Action, Observation

MAX_NUMBERS: Final = 10_000
"""Maximum number of numbers of an observation or action in working memory."""

_CHARS: Final = "chars"


class TaskLink(SoarLink):
    """Observations of any task for Soar, and Soar's answers as actions.

    Raises:
        ConfigError: the task spec does not state the actions.
    """

    def __init__(self, kernel: Kernel, task: TaskSpec) -> None:
        super().__init__(kernel, task)
        if not task.actions.stated or sum(task.actions.counts) > MAX_NUMBERS:
            raise ConfigError(
                f"a Soar agent needs a task spec that states the actions, of at most {MAX_NUMBERS} numbers"
            )
        self._actions = task.actions
        self._observation = kernel.add_identifier(kernel.input, "observation")
        self._elements: dict[str, tuple[Element, int | float | str]] = {}
        described = kernel.add_identifier(kernel.input, "task")
        kernel.add_text(described, "spec", str(task))
        for i, bounds in enumerate(task.actions.ints, 1):
            element = kernel.add_identifier(described, f"int-{i}")
            for end, number in _bounds(bounds):
                kernel.add_int(element, end, int(number))
        for i, bounds in enumerate(task.actions.doubles, 1):
            element = kernel.add_identifier(described, f"double-{i}")
            for end, number in _bounds(bounds):
                kernel.add_float(element, end, number)

    def action(self, name: str, parameters: Mapping[str, str]) -> Action:
        """Return the action of a command ^action with ^int-1, ^double-1, ... and ^chars."""
        if name != "action":
            raise SoarError(f"the output link takes ^action; the agent sent ^{name}")
        ints, doubles, chars = self._actions.counts
        wanted = [*(f"int-{i + 1}" for i in range(ints)), *(f"double-{i + 1}" for i in range(doubles))]
        wanted += [_CHARS] * bool(chars)
        given = {key: value for key, value in parameters.items() if key not in ("status", "step")}
        if given.keys() != set(wanted):
            shown = " ".join(f"^{key} {value}" for key, value in given.items())
            raise SoarError(
                f"an action of this task has {' '.join(f'^{key}' for key in wanted)}; "
                f"the agent sent ^action with {shown or 'nothing'}"
            )
        try:
            action = Action(
                ints=[int(given[f"int-{i + 1}"]) for i in range(ints)],
                doubles=[float(given[f"double-{i + 1}"]) for i in range(doubles)],
                chars=given.get(_CHARS, "").encode("latin-1"),
            )
        except (ValueError, OverflowError) as error:
            raise SoarError(f"the agent sent an action that is none: {error}") from None
        wrong = self._actions.check(action)
        if wrong is not None:
            raise SoarError(f"the agent sent an action that the task does not have: {wrong}")
        return action

    def _forget(self) -> None:
        """Do nothing: each observation replaces all of the previous one."""

    def _put(self, observation: Observation) -> None:
        if sum(observation.counts) > MAX_NUMBERS:
            raise RemoteProtocolError(
                f"Soar can be shown observations of at most {MAX_NUMBERS} numbers and chars; received "
                f"{sum(observation.counts)}"
            )
        seen: dict[str, int | float | str] = {
            f"int-{i}": number for i, number in enumerate(observation.ints.tolist(), 1)
        }
        seen.update((f"double-{i}", number) for i, number in enumerate(observation.doubles.tolist(), 1))
        if observation.chars:
            seen[_CHARS] = observation.chars.decode("latin-1")
        for name in self._elements.keys() - seen.keys():
            self._kernel.remove(self._elements.pop(name)[0])
        for name, value in seen.items():
            element, before = self._elements.get(name, (None, None))
            if element is None:
                add: dict[type, Callable[[Element, str, Any], Element]] = {
                    int: self._kernel.add_int,
                    float: self._kernel.add_float,
                    str: self._kernel.add_text,
                }
                element = add[type(value)](self._observation, name, value)
            elif value != before:
                self._kernel.update(element, value)
            self._elements[name] = element, value


def _bounds(bounds: Range) -> Iterator[tuple[str, float]]:
    """Yield the ends of a range that are stated and finite, with their attributes."""
    for name, end in zip(("low", "high"), bounds.ends, strict=True):
        if math.isfinite(end):
            yield name, end

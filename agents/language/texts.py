"""The texts of a game for a language model: its rules, its actions by name, what is seen.

Both agents, `agents.language.server` and `agents.language.chat`, show the same ones, made of the task spec,
the words that the environment brings (`glue.plugins.words`) and the options.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import product
from typing import Final

import numpy as np

from glue.console import one_line, printable
from glue.errors import GlueError, LocalProtocolError
from glue.plugins.words import Words, find_picture, find_words
from glue.taskspec import Range, Ranges, Space, TaskSpec, legal_values, mask_sizes, parse_task_spec
from glue.types import Action, Observation

_MOST_LISTED: Final = 64  # actions that get names of their numbers
_MOST_NUMBERS: Final = 64  # in an action
_MOST_SEEN: Final = 4000  # letters of an observation
_MOST_EXTRA: Final = 1000
_MOST_NAME: Final = 200
_TIMES: Final = re.compile(r"(.*?)\s*(?:\*\s*([0-9]{1,9}))?", re.DOTALL)


class IllegalChoice(GlueError):
    """The model's choice is no legal action, or too many; the message says what is legal."""


class Texts:
    """The texts of one task.

    Args:
        task_spec: as the environment returned it.
        most: maximum number of actions of one choice.
        listed: whether every observation lists the legal actions.

    Attributes:
        rules: the rules of the game, in words.
        names: the actions by name; empty if they are too many to be named.

    Raises:
        TaskSpecError: the task spec does not parse.
        LocalProtocolError: it does not state the actions, or they are not a few numbers.
    """

    def __init__(self, task_spec: str, most: int, listed: bool) -> None:
        spec = parse_task_spec(task_spec)
        ints, doubles, chars = spec.actions.counts
        if chars or not 0 < ints + doubles <= _MOST_NUMBERS:
            raise LocalProtocolError(
                f"a language model needs a task spec that states actions of 1 to {_MOST_NUMBERS} numbers, "
                f"not {one_line(task_spec, 80)!r}"
            )
        self._spec = spec
        words = find_words(spec)
        fits = all(spec.actions.check(action) is None for action in words.actions.values())
        fits = fits and words.observations in (None, spec.observations)
        # Otherwise they are of another environment, whose name this one has.
        self._words = words if fits else Words("", {})
        self._picture = find_picture(spec) if fits else None
        self._most = most
        self.names: Final[Mapping[str, Action]] = self._words.actions or _enumerated(spec.actions)
        self._sizes = mask_sizes(spec.actions) if spec.masks else ()
        self._least = [int(range_.ends[0]) for range_ in spec.actions.ints] if spec.masks else []
        self._still = Action(*spec.actions.still())
        self.rules: Final = "\n".join(filter(None, self._rules(spec, listed)))

    @property
    def form(self) -> str:
        """The actions in a line: their names, or what they consist of."""
        return ", ".join(self.names) or f"{_numbers(self._spec.actions)}, separated by spaces"

    def allows(self, action: Action, observation: Observation) -> bool:
        """Return whether an observation's mask allows an action."""
        legal = legal_values(observation, self._sizes)
        values = zip(legal, action.ints.tolist(), self._least, strict=True) if legal else ()
        return all(allowed[value - least] for allowed, value, least in values)

    def legal_at(self, observation: Observation) -> list[str]:
        """Return the names of the actions that an observation's mask allows; none if they have no names."""
        return [name for name, action in self.names.items() if self.allows(action, observation)]

    def still_at(self, observation: Observation) -> Action:
        """Return the action of who stands still; where that is illegal, the first values that are legal."""
        if self.allows(self._still, observation):
            return self._still
        legal = legal_values(observation, self._sizes)
        ints = [int(np.argmax(allowed)) + least for allowed, least in zip(legal, self._least, strict=True)]
        return Action(ints, self._still.doubles)

    def actions(self, names: object, observation: Observation) -> list[Action]:
        """Return the actions of a choice: a list of names or numbers, each perhaps with `*` and how often.

        Args:
            names: what was chosen.
            observation: at which the first action is taken; its mask says nothing of those that follow.

        Raises:
            IllegalChoice: one is not legal, there is none, or there are too many.
        """
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise IllegalChoice("no list of actions was given")
        chosen: list[Action] = []
        for name in names:
            parts = _TIMES.fullmatch(name.strip()[:_MOST_NAME])
            assert parts is not None
            chosen += [self._action(parts[1])] * min(int(parts[2] or 1), self._most + 1)
            if len(chosen) > self._most:
                break  # A million names are not worth reading.
        if not 0 < len(chosen) <= self._most:
            raise IllegalChoice(f"a choice has 1 to {self._most} actions")
        if not self.allows(chosen[0], observation):
            legal = ", ".join(self.legal_at(observation)) or "others"
            raise IllegalChoice(f"{one_line(names[0], 60)!r} is illegal in this turn; legal are: {legal}")
        return chosen

    def seen(self, observation: Observation) -> str:
        """Return an observation as text: the environment's picture in characters, or numbers."""
        drawn = self._drawn(observation)
        text = printable(_in_numbers(observation) if drawn is None else drawn)
        return text if len(text) <= _MOST_SEEN else f"{text[:_MOST_SEEN]}..."

    def _drawn(self, observation: Observation) -> str | None:
        """Return the environment's picture, if there is one."""
        if self._picture is not None and self._spec.observations.check(observation) is None:
            with suppress(Exception):  # It may be the drawing of another environment of this name.
                return "\n".join(self._picture(observation, False))
        return None

    def image(self, observation: Observation) -> bytes | None:
        """Return a picture of an observation, as PNG; None if the environment has none.

        Raises:
            ConfigError: the library that draws it is missing.
        """
        return None if self._words.image is None else self._words.image(observation)

    def _action(self, name: str) -> Action:
        known = self.names.get(name.lower())
        if known is not None:
            return known
        words, ints = name.split(), self._spec.actions.counts[0]
        try:
            action = Action([int(word) for word in words[:ints]], [float(word) for word in words[ints:]])
            if self._spec.actions.check(action) is None:
                return action
        except (ValueError, LocalProtocolError):
            pass
        raise IllegalChoice(f"{one_line(name, 60)!r} is no legal action; legal are: {self.form}")

    def _rules(self, spec: TaskSpec, listed: bool) -> Iterator[str]:
        yield "You are the agent in a task of reinforcement learning: earn as much reward as you can."
        says = f"The environment says of itself: {one_line(spec.extra, _MOST_EXTRA)}"
        yield self._words.rules or (says if spec.extra else "")
        yield f"The task is {spec.problem_type}, with a discount factor of {spec.discount:g}."
        if spec.observations.stated:
            yield f"An observation: {_numbers(spec.observations)}."
        yield f"The reward of a step: a number{_between(spec.rewards)}."
        yield f"{'Legal actions' if self.names else 'An action'}: {self.form}."
        yield f"A choice is one action, or up to {self._most} in a row; NAME*3 is an action three times."
        if self._sizes:
            yield "Not every action is legal in every turn; the answer to an illegal one says which are."
        yield f"Legal actions are {'' if listed else 'not '}listed each time."
        yield "The game waits while you choose, unless it goes by a clock; where time is limited, you see it."


def _in_numbers(observation: Observation) -> str:
    """Return an observation as its numbers and characters."""
    ints, doubles = observation.ints[:_MOST_SEEN].tolist(), observation.doubles[:_MOST_SEEN].tolist()
    numbers = " ".join([*map(str, ints), *(f"{number:.6g}" for number in doubles)])
    return f"{numbers}\n{observation.chars[:_MOST_SEEN].decode('latin-1')}".strip("\n")


def _enumerated(space: Space) -> dict[str, Action]:
    """Return all actions by their numbers; none if there are doubles, or too many actions."""
    ends = [range_.ends for range_ in space.ints]
    if space.doubles or math.prod(high - low + 1 for low, high in ends) > _MOST_LISTED:
        return {}
    values = product(*(range(int(low), int(high) + 1) for low, high in ends))
    return {" ".join(map(str, ints)): Action(ints) for ints in values}


def _numbers(space: Space) -> str:
    """Return a description of the values of a space."""
    letters = [f"{space.chars} letters"] if space.chars else []
    parts = [*_runs(space.ints, "whole number"), *_runs(space.doubles, "number"), *letters]
    return ", ".join(parts[:_MOST_NUMBERS])


def _runs(ranges: Ranges, noun: str) -> Iterator[str]:
    for repeat, range_ in ranges.runs:
        yield f"{repeat} {noun}{'s' * (repeat > 1)}{_between(range_)}"


def _between(range_: Range) -> str:
    low, high = range_.ends
    least = "" if math.isinf(low) else f" from {low:g}"
    return least if math.isinf(high) else f"{least} to {high:g}"

"""The values that a Soar agent for Mario has learned, by the tests of its rules.

keystroke   in a state described by a text; several values may add up
operator    by its object, described by a text
context     an operator's name, and the kinds of objects to choose from
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from glue.errors import SaveError

KEYSTROKE: Final = "keystroke"
OPERATOR: Final = "operator"
CONTEXT: Final = "context"

_TEST: Final = re.compile(r"\^(sees|keystroke|context|name)\s+\|?([^\s|)]+)")
_END: Final = {"name": "end"}
"""The tests of the rule for the end of an operator; its value is 0, and is not learned."""

_VALUE: Final = re.compile(r"\^operator <[\w*-]+> = (-?\d+\.\d+)\)\s*\}\s*$")


class Learned(NamedTuple):
    """The subject of a value: its kind, the text that describes the state, and the choice made there."""

    kind: str
    seen: str
    chosen: str


def learned_values(rules: Iterable[str]) -> dict[Learned, float]:
    """Return the values of rules, as `agents.soar.agents.parse_rules` gives them.

    Raises:
        SaveError: a rule is not one of the productions that come with Mario's agents.
    """
    values = {}
    for rule in rules:
        tests, value = dict(_TEST.findall(rule)), _VALUE.search(rule)
        if tests == _END:
            continue
        if value is None or not tests.keys() & {"sees", "context"}:
            raise SaveError(f"this rule is not of an agent for Mario: {rule!r:.200}")
        if "keystroke" in tests:
            key = Learned(KEYSTROKE, tests["sees"], tests["keystroke"])
        elif "context" in tests:
            key = Learned(CONTEXT, tests["context"], tests["name"])
        else:
            key = Learned(OPERATOR, tests["sees"], "")
        values[key] = float(value.group(1))
    return values

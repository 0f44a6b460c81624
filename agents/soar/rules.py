"""The rules that hold learned values, in Soar's own syntax, parsed without trusting them.

A rule is a production whose only action is a numeric preference. A save may come from anyone, and the
actions of other productions can execute any Soar command.
"""

from __future__ import annotations

import re
from typing import Final

from glue.errors import SaveError

_MAX_RULES: Final = 1_000_000

_RULE: Final = re.compile(
    r"sp \{(?P<name>[^\s{}|\"]+)\n"
    r"(?P<conditions>(?:    +[^\n]*\n)+?)"
    r"    -->\n"
    r"    \(<[\w*-]+> \^operator <[\w*-]+> = -?\d+\.\d+\)\n"
    r"\}\s*"
)
_QUOTED: Final = re.compile(r"\|[^|{}\n]*\|")


def parse_rules(text: str) -> list[str]:
    """Return the rules of a text as commands, one `sp { ... }` each, in the order of the text.

    Raises:
        SaveError: the text holds anything else.
    """
    rules: list[str] = []
    end = 0
    text = text.strip()
    while end < len(text):
        match = _RULE.match(text, end)
        if match is None or len(rules) == _MAX_RULES or not _is_balanced(match["conditions"]):
            raise SaveError(
                f"saved rules: rule {len(rules) + 1} is not one that holds a value: {text[end : end + 200]!r}"
            )
        rules.append(match.group().strip())
        end = match.end()
    return rules


def _is_balanced(conditions: str) -> bool:
    """Return whether the braces of conditions are balanced, and none closes the production."""
    if "-->" in conditions:
        return False
    depth = 0
    for character in _QUOTED.sub("", conditions):
        depth += {"{": 1, "}": -1}.get(character, 0)
        if depth < 0 or character in '|"':
            return False
    return depth == 0

"""The grammar of docs/taskspec.md and the parser read the same texts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glue.errors import TaskSpecError
from glue.taskspec import parse_task_spec
from tests.pages import blocks
from tests.proof import size

DOCUMENT: Final = (Path(__file__).parents[2] / "docs/taskspec.md").read_text()

CHARACTERS: Final = {
    "white": r"\s",
    "digit": "[0-9]",
    "nonzero": "[1-9]",
    "any": r"[\s\S]",
    "word character": r"(?:(?!DISCOUNTFACTOR)[^\s()])",
}
"""Definitions of names that the grammar leaves undefined, as given in the text below it."""

BEYOND: Final = (
    "is given twice",
    "without leading zeros",  # ten digits or more
    "from 0 to 16777216",
    "more than the 16777216",
    "of 32 bits",
    "that a double holds",
    "is above the maximum",
    "cannot be POSINF",
    "a discount factor from 0 to 1, not",
)
"""Parts of errors for texts that the grammar allows, for reasons given in the text below it."""


def rules() -> dict[str, str]:
    """Return the rules of the grammar by name."""
    ((_, _, block),) = blocks(DOCUMENT, "ebnf")
    return {
        name.strip(): rule.strip() for name, rule in re.findall(r"([\w ]+?) *= (.*?) ;", block, re.DOTALL)
    }


def pattern_of(rule: str) -> str:
    """Return a rule of the grammar, which has no recursion, as a regular expression."""
    pattern = ""
    for literal, name, sign in re.findall(r'"([^"]+)"|([a-z][a-z0-9 ]*[a-z0-9]|[a-z])|([\[\]{}()|])', rule):
        if literal:
            pattern += re.escape(literal)
        elif name:
            pattern += CHARACTERS.get(name) or f"(?:{pattern_of(RULES[name])})"
        else:
            pattern += {"[": "(?:", "]": ")?", "{": "(?:", "}": ")*", "(": "(?:", ")": ")", "|": "|"}[sign]
    return pattern


RULES: Final = rules()
GRAMMAR: Final = re.compile(pattern_of("task spec"), re.IGNORECASE)

EXAMPLES: Final = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR .9 OBSERVATIONS INTS (3 0 1) (1 3) "
    "DOUBLES (-1.2 0.5)(NEGINF UNSPEC) CHARCOUNT 16 ACTIONS INTS (0 4)  REWARDS (-5.0 5.0) EXTRA a car",
    "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
    "ACTIONS INTS (-1 1) (2 0 1)  REWARDS (-10.0 100.0)",
)
KEYWORDS: Final = (
    "NEGINF INTS DOUBLES CHARCOUNT ACTIONS OBSERVATIONS REWARDS EXTRA EXTRAS PROBLEMTYPE VERSION"
)
PIECES: Final = st.sampled_from([*KEYWORDS.split(), *"()07-.e \n", "DISCOUNTFACTOR", "(0 1)", "(2 0 1)"])


FROM_GRAMMAR: Final = st.from_regex(GRAMMAR, fullmatch=True, alphabet=st.characters(max_codepoint=0x7F))


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A text of the grammar with a few pieces inserted, removed or replaced."""
    text = draw(st.sampled_from(EXAMPLES) | FROM_GRAMMAR)
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        text = text[:start] + draw(PIECES | st.just("")) + text[end:]
    return text


def refusal(text: str) -> str | None:
    try:
        parse_task_spec(text)
    except TaskSpecError as error:
        return str(error)
    return None


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_are_of_the_grammar(text: str) -> None:
    assert GRAMMAR.fullmatch(text)
    assert refusal(text) is None


@pytest.mark.proof
@settings(max_examples=size(10, 1000))  # Each example takes some milliseconds to make.
@given(FROM_GRAMMAR)
def test_what_the_grammar_makes_is_read_but_for_what_the_document_says(text: str) -> None:
    error = refusal(text)
    assert error is None or any(reason in error for reason in BEYOND), error


@pytest.mark.proof
@settings(max_examples=size(10, 1000))
@given(mutated())
def test_grammar_and_parser_agree_on_texts_with_mistakes(text: str) -> None:
    if not re.match(r"\s*VERSION\s+(RL-Glue-3\.0|Mario-v1)(?=\s|PROBLEMTYPE|$)", text, re.IGNORECASE):
        return  # A private format, or the colon format, or neither.
    error = refusal(text)
    if GRAMMAR.fullmatch(text):
        assert error is None or any(reason in error for reason in BEYOND), error
    else:
        assert error is not None

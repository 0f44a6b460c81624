"""The task spec language: glue/taskspec/__init__.py and docs/taskspec.md."""

from __future__ import annotations

import dataclasses
import doctest
import math
import re
from pathlib import Path
from random import Random
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glue.errors import LocalProtocolError, TaskSpecError
from glue.taskspec import (
    MARIO,
    MAX_LENGTH,
    NEGINF,
    POSINF,
    RL_GLUE_3,
    UNSPEC,
    Bound,
    Range,
    Ranges,
    Space,
    TaskSpec,
    parse_task_spec,
)
from glue.types import Action, Observation
from tests.memory import taking_less_than
from tests.pages import blocks
from tests.proof import size

DOCUMENT = Path(__file__).parents[2] / "docs" / "taskspec.md"
ANY = Range(UNSPEC, UNSPEC)

KEYWORDS = (
    *("VERSION", "PROBLEMTYPE", "DISCOUNTFACTOR", "OBSERVATIONS", "ACTIONS", "REWARDS", "EXTRA"),
    *("INTS", "DOUBLES", "CHARCOUNT"),
)
ANY_CASE = (*KEYWORDS, "NEGINF", "POSINF", "UNSPEC")
TIGHT = (*KEYWORDS, "(", ")")  # No white space is needed in front of these.
CANONICAL = [
    "VERSION RL-Glue-3.0 PROBLEMTYPE continuing DISCOUNTFACTOR 0.99 OBSERVATIONS DOUBLES (4 UNSPEC UNSPEC) "
    "ACTIONS DOUBLES (-2.5 2.5) REWARDS (NEGINF 0.0) EXTRA pendulum",
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 63) CHARCOUNT 16 "
    "ACTIONS CHARCOUNT 1 REWARDS (0.0 1.0) EXTRA text  maze: OBSERVATIONS",
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 0.0 OBSERVATIONS ACTIONS INTS (0 9) "
    "REWARDS (0.0 1.0) EXTRA bandit",
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 107) "
    "ACTIONS INTS (0 3) REWARDS (UNSPEC POSINF) EXTRA",
    "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 ACTIONS INTS (-1 1) (2 0 1) "
    "REWARDS (-10.0 100.0)",
    "VERSION Real-Time-Strategy-1.0 map=small units=9",
]


def space_text(observations: str) -> str:
    return (
        f"VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS {observations} "
        "ACTIONS INTS (0 1) REWARDS (0 1) EXTRA"
    )


some = settings(max_examples=size(20, 1000))

# Strategies


def ranges_of(numbers: st.SearchStrategy[int] | st.SearchStrategy[float]) -> st.SearchStrategy[Range]:
    """Ranges with ends in order, any of them open or not stated."""

    def build(ends: tuple[float, float], low: Bound, high: Bound) -> Range:
        return Range(min(ends) if low == POSINF else low, max(ends) if high == NEGINF else high)

    # The wrong infinity means the number drawn.
    lows = st.sampled_from([UNSPEC, NEGINF, POSINF, POSINF, POSINF])
    highs = st.sampled_from([UNSPEC, POSINF, NEGINF, NEGINF, NEGINF])
    return st.builds(build, st.tuples(numbers, numbers), lows, highs)


int_ranges = ranges_of(st.integers(-(2**31), 2**31 - 1))
double_ranges = ranges_of(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53))


def rows_of(ranges: st.SearchStrategy[Range], repeats: st.SearchStrategy[int]) -> st.SearchStrategy[Ranges]:
    return st.lists(st.tuples(repeats, ranges), max_size=5).map(lambda runs: Ranges(tuple(runs)))


def spaces_of(repeats: st.SearchStrategy[int]) -> st.SearchStrategy[Space]:
    return st.builds(Space, rows_of(int_ranges, repeats), rows_of(double_ranges, repeats), repeats)


words = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(
    lambda text: not any(char.isspace() or char in "()" for char in text)
)
problems = st.sampled_from(["episodic", "continuing", "non-episodic"]) | words.filter(
    lambda word: "discountfactor" not in word.lower()
)
spaces = spaces_of(st.integers(0, 3_000_000))
small_spaces = spaces_of(st.integers(0, 40))
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=100)
discounts = st.floats(0, 1)


def specs_of(version: str, observations: st.SearchStrategy[Space]) -> st.SearchStrategy[TaskSpec]:
    known = st.just(version)
    return st.builds(TaskSpec, known, problems, discounts, observations, spaces, double_ranges, texts)


public_specs = specs_of(RL_GLUE_3, spaces)
mario_specs = specs_of(MARIO, st.just(Space(stated=False)) | spaces)
private_specs = st.builds(
    TaskSpec.private, words.filter(lambda word: "problemtype" not in word.lower()), texts
)
task_specs = public_specs | mario_specs | private_specs


# Reading and printing


@some
@given(task_specs)
def test_printed_spec_reads_back_to_an_equal_value(spec: TaskSpec) -> None:
    text = str(spec)
    back = parse_task_spec(text)
    assert back == spec
    assert hash(back) == hash(spec)
    assert str(back) == text


@some
@given(public_specs, st.randoms())
def test_white_space_and_case_do_not_matter(spec: TaskSpec, random: Random) -> None:
    spec = dataclasses.replace(spec, problem_type="episodic", extra="")
    text, before = "", ""
    for token in re.findall(r"[()]|[^\s()]+", str(spec)):
        tight = before in ("(", ")") or (token in TIGHT and before not in ("", "VERSION", "PROBLEMTYPE"))
        text += "".join(random.choices(" \t\n\r\f\u00a0", k=random.randint(0 if tight else 1, 3)))
        text += (
            "".join(random.choice((letter.lower(), letter)) for letter in token)
            if token in ANY_CASE
            else token
        )
        before = token
    assert parse_task_spec(text) == spec


@pytest.mark.parametrize("text", CANONICAL)
def test_canonical_text_is_printed_as_it_was(text: str) -> None:
    assert str(parse_task_spec(text)) == text


@pytest.mark.parametrize("version", ["RL-Glue-3.0.1", "Mario-v2"])
def test_unknown_version_is_private(version: str) -> None:
    spec = parse_task_spec(f"VERSION {version} PROBLEMTYPE  episodic (0 1) EXTRA\n:x ")
    assert spec == TaskSpec.private(version, "PROBLEMTYPE  episodic (0 1) EXTRA\n:x")
    assert spec.actions.check(Action([1, 2, 3], [math.nan], b"x")) is None
    assert parse_task_spec("version\tFoo\n") == TaskSpec.private("Foo")


# The colon format


def test_colon_mountain_car_is_read() -> None:
    text = "2:e:2_[f,f]_[-1.2,.6]_[-.07,.07]:1_[i]_[0,2]:[-1,0]"
    spec = parse_task_spec(text)
    assert spec == TaskSpec(
        version=RL_GLUE_3,
        problem_type="episodic",
        discount=1.0,
        observations=Space(doubles=Ranges.of(Range(-1.2, 0.6), Range(-0.07, 0.07))),
        actions=Space(Ranges.of(Range(0, 2))),
        rewards=Range(-1, 0),
    )
    assert parse_task_spec("3" + text[1:] + ":Extra text: here") == dataclasses.replace(
        spec, extra="Extra text: here"
    )


BLANK = "(2 UNSPEC UNSPEC)"


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (
            "8_[f,f,f,f,i,i,i,i]_[,.6]_[-.07,]_[,]_[]_[,6]_[-7,]_[,]_[ ,  ]",
            f"INTS (UNSPEC 6) (-7 UNSPEC) {BLANK} DOUBLES (UNSPEC 0.6) (-0.07 UNSPEC) {BLANK}",
        ),
        (
            "5_[f,f,f,f,f,,]_[-inf,.6]_[-.07,inf]_[-inf,]_[,inf]_[-inf,inf]",
            "DOUBLES (NEGINF 0.6) (-0.07 POSINF) (NEGINF UNSPEC) (UNSPEC POSINF) (NEGINF POSINF)",
        ),
        ("1_[i]__[0,3]", "INTS (0 3)"),
        ("1_[i]_ _ _[0,3]", "INTS (0 3)"),
        (
            " 4 _ [ i, F, I, f ] _ [0,1.000] _ [2,3] _ [4,5] _ [6,7] ",
            "INTS (0 1) (4 5) DOUBLES (2.0 3.0) (6.0 7.0)",
        ),
        ("0_[]", ""),
    ],
)
def test_colon_spaces_are_read(written: str, read: str) -> None:
    spec = parse_task_spec(f" 2.0 : c :{written}:{written}")
    assert (str(spec.observations), str(spec.actions)) == (read, read)
    assert (spec.problem_type, spec.rewards) == ("continuing", ANY)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("4:e:1_[i]:1_[i]", "character 1: expected VERSION, or the colon format"),
        ("2:?:1_[i]:1_[i]", "character 3: expected e, c or another word, not '?:1_[i]:1_[i]'"),
        ("2:e:x_[i]:1_[i]", "character 5: expected a number of dimensions, not 'x_[i]:1_[i]'"),
        ("2:e:2_[i]:1_[i]", "character 5: 2 dimensions need as many letters; 1 received"),
        ("2:e:1_[x]:1_[i]", "character 8: expected i, f, ',' or ']', not 'x]:1_[i]'"),
        (
            "2:e:1_[i]_[0,-inf]:1_[i]",
            "character 11: a minimum cannot be POSINF (inf), nor a maximum NEGINF (-inf)",
        ),
        ("2:e:1_[i]_[5]:1_[i]", "character 13: expected ',', not ']:1_[i]'"),
        ("2:e:1_[i]_[0,x]:1_[i]", "character 14: expected a number, -INF or INF, not 'x'"),
        ("2:e:1_[i]_[0,.5]:1_[i]", "character 14: expected a whole number without leading zeros, not '.5'"),
        (
            "2:e:2_[i,f]_[0,1]:1_[i]",
            "character 18: expected '_' and the range of dimension 2 of 2, not ':1_[i]'",
        ),
        ("2:e:1_[i]_[0,1]_[2,3]:1_[i]", "character 16: expected ':', not '_[2,3]:1_[i]'"),
        ("2:e:1_[i]", "character 10: expected ':', not the end"),
        ("2:e:1_[i]:1_[i]:[0,1] x", "character 23: expected ':' or the end, not 'x'"),
        ("2:e:99999999_[i]:1_[i]", "character 5: 99999999 dimensions need as many letters; 1 received"),
        ("", "character 1: expected VERSION"),
        ("sample task spec", "character 1: expected VERSION"),
        ("VERSION", "character 8: expected the name of a version"),
        ("VERSION RL-Glue-3.0", "character 20: expected PROBLEMTYPE, not the end"),
        (space_text("INTS (0 1) (5 1)"), "character 84: the minimum 5 is above the maximum 1"),
        (
            space_text("INTS (0 1)\n(5 x)"),
            "character 86: expected a number, NEGINF, POSINF or UNSPEC, not 'x) ACTIONS",
        ),
        (
            space_text("INTS (16777216 0 1) (1 2)"),
            "character 77: 16777217 numbers are more than the 16777216",
        ),
    ],
)
def test_error_names_place_and_expectation(text: str, error: str) -> None:
    with pytest.raises(TaskSpecError) as caught:
        parse_task_spec(text)
    assert str(caught.value).startswith(f"task spec, {error}")


# Limits and hostile text


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "text",
    [
        "(" * MAX_LENGTH,
        "VERSION" + " " * 60_000,
        "VERSION RL-Glue-3.0 PROBLEMTYPE " + "DISCOUNTFACTO" * 4_500,
        space_text("INTS (0 1." + "0" * 60_000 + "x)"),
        space_text("DOUBLES (0 0." + "9" * 60_000 + "e9999999)"),
        space_text("INTS (" + "1 " * 30_000),
        space_text("INTS " + "()" * 30_000),
        space_text("__import__('os').getcwd()"),
        "2:e:1_[" + "," * 60_000,
        "2:e:" + "9" * 60_000,
    ],
    ids=lambda text: text[:90],
)
def test_hostile_text_is_refused(text: str) -> None:
    with pytest.raises(TaskSpecError, match=r"^task spec, character \d+: "):
        parse_task_spec(text)


def test_text_of_the_longest_length_is_read_and_no_longer() -> None:
    text = "VERSION Foo ".ljust(MAX_LENGTH, "x")
    assert len(str(parse_task_spec(text))) == MAX_LENGTH
    with pytest.raises(TaskSpecError, match=f"at most {MAX_LENGTH} characters; {MAX_LENGTH + 1} received"):
        parse_task_spec(text + "x")


def test_spec_whose_canonical_text_is_too_long_is_refused() -> None:
    with pytest.raises(TaskSpecError, match=f"at most {MAX_LENGTH} characters; the canonical text"):
        parse_task_spec(space_text("DOUBLES " + "(0 1)(2 3)" * 6_000))


def test_long_repeat_takes_no_memory() -> None:
    text = space_text("INTS (16777216 0 1) DOUBLES (16777215 NEGINF 5) (6 POSINF)")
    with taking_less_than(200_000):
        spec = parse_task_spec(text)
        reason = spec.observations.check(Observation([0]))
    assert spec.observations.ints[16_777_215] == Range(0, 1)
    assert spec.observations.doubles[-1] == Range(6, POSINF)
    assert reason == "ints: 16777216 expected, 1 received; doubles: 16777216 expected, 0 received"


# Values


@some
@given(rows_of(int_ranges, st.integers(0, 40)))
def test_ranges_are_a_row_of_ranges(ranges: Ranges) -> None:
    row = [range_ for repeat, range_ in ranges.runs for _ in range(repeat)]
    assert list(ranges) == row
    assert len(ranges) == len(row)
    assert [ranges[i] for i in range(len(row))] == row
    assert [ranges[i - len(row)] for i in range(len(row))] == row
    assert Ranges.of(*row) == ranges
    for outside in (len(row), -len(row) - 1):
        with pytest.raises(IndexError):
            ranges[outside]


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (1, 0),
        (POSINF, UNSPEC),
        (UNSPEC, NEGINF),
        (POSINF, POSINF),
        (math.nan, 0),
        (0, 10**400),
        (2**53 + 1, UNSPEC),
    ],
)
def test_range_that_holds_nothing_or_no_double_is_refused(low: Bound, high: Bound) -> None:
    with pytest.raises(TaskSpecError):
        Range(low, high)


def test_range_includes_its_ends_and_no_nan() -> None:
    assert 0 in Range(0, 1)
    assert 1 in Range(0, 1)
    assert 1.5 not in Range(0, 1)
    assert -1e300 in Range(UNSPEC, 1)
    assert math.inf in Range(0, POSINF)
    assert math.nan not in ANY


@pytest.mark.parametrize("bound", [0.5, 2.0, 2**31, -(2**31) - 1])
def test_bound_of_an_int_that_is_no_int32_is_refused(bound: float) -> None:
    with pytest.raises(TaskSpecError, match="a bound of an int is a whole number from"):
        Space(Ranges.of(Range(bound, UNSPEC)))


def test_counts_out_of_range_are_refused() -> None:
    with pytest.raises(TaskSpecError, match="16777217 numbers are more than"):
        Ranges(((2**24, Range(0, 1)), (1, Range(0, 2))))
    with pytest.raises(TaskSpecError, match="cannot be repeated -1 times"):
        Ranges(((-1, Range(0, 1)),))
    with pytest.raises(TaskSpecError, match="the number of chars is from 0"):
        Space(chars=-1)
    with pytest.raises(TaskSpecError, match="not stated"):
        Space(chars=1, stated=False)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"version": "two words"}, "a version is one word"),
        ({"version": "rl-glue-3.0"}, "a version is one word, spelt as in RL-Glue-3.0"),
        ({"version": "Foo"}, "Foo is a private format"),
        ({"problem_type": ""}, "a problem type is one word"),
        ({"problem_type": "two words"}, "a problem type is one word"),
        ({"discount": None}, "a discount factor is from 0 to 1"),
        ({"discount": 1.5}, "a discount factor is from 0 to 1"),
        ({"discount": math.nan}, "a discount factor is from 0 to 1"),
        ({"observations": Space(stated=False)}, "RL-Glue-3.0 has to state the observations"),
        ({"actions": Space(stated=False)}, "RL-Glue-3.0 has to state the actions"),
        ({"extra": "x" * MAX_LENGTH}, "at most 65536 characters"),
    ],
)
def test_task_spec_that_could_not_be_printed_is_refused(change: dict[str, Any], error: str) -> None:
    spec = parse_task_spec(space_text("INTS (0 1)"))
    with pytest.raises(TaskSpecError, match=error):
        dataclasses.replace(spec, **change)


# Asking


@some
@given(small_spaces, st.integers(0, 2**32))
def test_sample_is_in_its_space(space: Space, seed: int) -> None:
    value = Observation(*space.sample(np.random.default_rng(seed)))
    assert value.counts == space.counts
    assert space.check(value) is None


def test_sample_reaches_both_ends() -> None:
    space = Space(Ranges.of(Range(-1, 1)))
    generator = np.random.default_rng(1)
    assert {int(space.sample(generator)[0][0]) for _ in range(100)} == {-1, 0, 1}


def test_sample_of_a_space_not_stated_is_a_local_error() -> None:
    with pytest.raises(LocalProtocolError, match="does not state"):
        Space(stated=False).sample(np.random.default_rng(0))


@some
@given(small_spaces, st.data())
def test_check_names_the_first_number_out_of_its_range(space: Space, data: st.DataObject) -> None:
    ints = data.draw(
        st.lists(st.integers(-(2**31), 2**31 - 1), min_size=len(space.ints), max_size=len(space.ints))
    )
    doubles = data.draw(st.lists(st.floats(), min_size=len(space.doubles), max_size=len(space.doubles)))
    wrong = [
        f"{name} {index} is "
        for name, numbers, ranges in (("int", ints, space.ints), ("double", doubles, space.doubles))
        for index, (number, range_) in enumerate(zip(numbers, ranges, strict=True))
        if number not in range_
    ]
    reason = space.check(Action(ints, doubles, bytes(space.chars)))
    assert (reason is None) == (not wrong)
    if reason is not None:
        assert reason.startswith(wrong[0])


@pytest.mark.parametrize("count", [3, 300])
def test_check_gives_number_and_range(count: int) -> None:
    text = space_text(f"INTS ({count} 0 4) DOUBLES ({count} NEGINF 1.5) CHARCOUNT 2")
    space = parse_task_spec(text).observations
    ints, doubles = np.full(count, 4), np.full(count, 1.5)
    assert space.check(Observation(ints, doubles, b"ab")) is None
    assert space.check(Observation(ints, doubles, b"abc")) == "chars: 2 expected, 3 received"
    doubles[2] = math.nan
    assert space.check(Observation(ints, doubles, b"ab")) == "double 2 is nan, not in (NEGINF 1.5)"
    ints[1] = -1
    assert space.check(Observation(ints, doubles, b"ab")) == "int 1 is -1, not in (0 4)"


# The document


def test_examples_of_the_document_are_true() -> None:
    results = doctest.testfile(str(DOCUMENT), module_relative=False)
    assert results.attempted > 20
    assert results.failed == 0


def table_of_the_document(heading: str) -> list[tuple[str, str, str]]:
    """Return the rows below `heading`: a part of the example, its replacement, and the result."""
    section = DOCUMENT.read_text(encoding="utf-8").partition(f"## {heading}")[2].partition("\n## ")[0]
    rows = [row.split(" | ") for row in re.findall(r"^\| (`.*) \|$", section, re.MULTILINE)]
    assert len(rows) > 20
    return [(part.strip("`"), unescape(written), unescape(outcome)) for part, written, outcome in rows]


def unescape(cell: str) -> str:
    return cell.strip("`").replace("\\t", "\t").replace("\\n", "\n")


def example_of_the_document() -> str:
    match = re.search("^    (VERSION .*)$", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    assert match is not None
    return match[1]


@pytest.mark.parametrize(("part", "written", "read"), table_of_the_document("What is tolerated"))
def test_what_the_document_tolerates_is_read(part: str, written: str, read: str) -> None:
    example = example_of_the_document()
    assert part in example
    assert str(parse_task_spec(example.replace(part, written, 1))) == example.replace(part, read, 1)


@pytest.mark.parametrize(("part", "written", "error"), table_of_the_document("What is refused"))
def test_what_the_document_refuses_is_refused(part: str, written: str, error: str) -> None:
    example = example_of_the_document()
    assert part in example
    with pytest.raises(TaskSpecError) as caught:
        parse_task_spec(example.replace(part, written, 1))
    place, _, complaint = str(caught.value).partition(": ")
    assert re.fullmatch(r"task spec, character \d+", place)
    assert complaint == error


# The grammar of the document

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


def rules_of_the_document() -> dict[str, str]:
    """Return the rules of the grammar by name."""
    ((_, _, block),) = blocks(DOCUMENT.read_text("utf-8"), "ebnf")
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


RULES: Final = rules_of_the_document()
GRAMMAR: Final = re.compile(pattern_of("task spec"), re.IGNORECASE)

GRAMMATICAL: Final = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR .9 OBSERVATIONS INTS (3 0 1) (1 3) "
    "DOUBLES (-1.2 0.5)(NEGINF UNSPEC) CHARCOUNT 16 ACTIONS INTS (0 4)  REWARDS (-5.0 5.0) EXTRA a car",
    "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
    "ACTIONS INTS (-1 1) (2 0 1)  REWARDS (-10.0 100.0)",
)
PARTS: Final = "NEGINF INTS DOUBLES CHARCOUNT ACTIONS OBSERVATIONS REWARDS EXTRA EXTRAS PROBLEMTYPE VERSION"
PIECES: Final = st.sampled_from([*PARTS.split(), *"()07-.e \n", "DISCOUNTFACTOR", "(0 1)", "(2 0 1)"])


FROM_GRAMMAR: Final = st.from_regex(GRAMMAR, fullmatch=True, alphabet=st.characters(max_codepoint=0x7F))


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A text of the grammar with a few pieces inserted, removed or replaced."""
    text = draw(st.sampled_from(GRAMMATICAL) | FROM_GRAMMAR)
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


@pytest.mark.parametrize("text", GRAMMATICAL)
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

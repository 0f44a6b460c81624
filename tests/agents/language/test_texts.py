"""Tasks in words: rules, actions by name, observations as text."""

from __future__ import annotations

import re

import pytest

from agents.language.texts import IllegalChoice, Texts
from env_server.render.words import MARIO, MINES, SKELETON
from env_server.toys import MINES_MAP, MinesEnvironment, SkeletonEnvironment
from glue import Action, GlueError, Observation
from glue.taskspec import parse_task_spec
from tests.agents.screens import TASK_SPEC

CAR = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 0.9 OBSERVATIONS INTS (3 0 1) "
    "DOUBLES (-1.2 0.5) CHARCOUNT 4 ACTIONS INTS (0 1) DOUBLES (2 -1.0 1.0) REWARDS (-5.0 5.0) "
    "EXTRA a car\x1b[2J of ours"
)
GRID = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 9) "
    "ACTIONS INTS (1 2) (-1 1) REWARDS (UNSPEC UNSPEC) EXTRA"
)
MARIO_WINDOW = (b" " * 21 + b"\n") * 14 + (b"7" * 21 + b"\n") * 2
MARIO_SEEN = Observation([0, 0, 0], [5.0, 5.0, 0.0, 0.0], MARIO_WINDOW)


def made(spec: str, most: int = 20, listed: bool = False) -> Texts:
    return Texts(spec, most, listed)


def test_rules_say_the_task_spec_in_words() -> None:
    rules = made(CAR, listed=True).rules
    for line in (
        "The environment says of itself: a car?[2J of ours",
        "The task is episodic, with a discount factor of 0.9.",
        "An observation: 3 whole numbers from 0 to 1, 1 number from -1.2 to 0.5, 4 letters.",
        "The reward of a step: a number from -5 to 5.",
        "An action: 1 whole number from 0 to 1, 2 numbers from -1 to 1, separated by spaces.",
        "Legal actions are listed each time.",
    ):
        assert line in rules, rules
    assert "Legal actions are not listed each time." in made(GRID).rules
    assert "Legal actions: 1 -1, 1 0, 1 1, 2 -1, 2 0, 2 1." in made(GRID).rules
    assert "a number.\n" in made(GRID).rules


def test_words_of_another_environment_of_that_name_are_not_used() -> None:
    texts = made(f"{GRID} mines of ours")
    assert [*texts.names] == ["1 -1", "1 0", "1 1", "2 -1", "2 0", "2 1"]
    assert "The environment says of itself: mines of ours" in texts.rules
    for spec, seen in ((MinesEnvironment().env_init(), 499), (SkeletonEnvironment().env_init(), 21)):
        larger = made(re.sub(r"(?<=OBSERVATIONS INTS \(0 )\d+", str(seen), spec) + " of ours")
        assert larger.seen(Observation([seen])) == str(seen)
        assert "You are @" not in larger.rules
        assert "0" in larger.names


def test_a_picture_that_fails_leaves_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.language.texts.find_picture", lambda spec: lambda seen, color: [][0])
    assert made(GRID).seen(Observation([3])) == "3"


def test_actions_have_names_numbers_and_repeats() -> None:
    def ints(spec: str, *choice: str) -> list[list[int]]:
        return [action.ints.tolist() for action in made(spec).actions([*choice], Observation())]

    assert ints(GRID, "1 -1", "2 0*2", "2 1 * 1") == [[1, -1], [2, 0], [2, 0], [2, 1]]
    assert ints(TASK_SPEC, "Right+Jump", "stay*2", "-1 0 1") == [[1, 1, 0], *[[0, 0, 0]] * 2, [-1, 0, 1]]


@pytest.mark.parametrize(
    "choice",
    [
        *([], None, "right", [3], ["fly"], ["3 0"], ["1"], ["1 0 0"], ["1.5 0"], ["1 0*0"], ["1 0*21"]),
        *(["1 0"] * 21, ["9" * 5000], ["1 0*999999999"] * 1000, ["x\x1b[2J" * 1000]),
    ],
)
def test_what_is_no_legal_choice_is_refused_in_words(choice: object) -> None:
    with pytest.raises(IllegalChoice) as refusal:
        made(GRID).actions(choice, Observation())
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 300


@pytest.mark.parametrize("actions", ["ACTIONS CHARCOUNT 3", "ACTIONS INTS (65 0 1)", "ACTIONS"])
def test_a_task_without_a_few_numbers_as_action_is_refused(actions: str) -> None:
    for spec in (GRID.replace("ACTIONS INTS (1 2) (-1 1)", actions), "a task", "VERSION mine 1 2 3"):
        with pytest.raises(GlueError):
            made(spec)


def test_many_actions_have_no_names() -> None:
    assert made(GRID.replace("(1 2) (-1 1)", "(64 0 1)")).names == {}
    assert made(GRID.replace("(1 2)", "(NEGINF 2)")).names == {}
    assert made(CAR).names == {}
    assert made(CAR).actions(["1 0.25 -1"], Observation()) == [Action([1], [0.25, -1.0])]


def test_an_observation_is_a_picture_or_numbers_and_never_long() -> None:
    assert made(MinesEnvironment().env_init()).seen(Observation([20])).count("@") == 1
    assert made(MinesEnvironment().env_init()).seen(Observation([10**6])) == "1000000"
    assert made(CAR).seen(Observation([0, 1, 1], [0.5], b"a\x1bb\xff")) == "0 1 1 0.5\na?b\xff"
    assert len(made(GRID).seen(Observation([7] * 10**6, [0.5] * 10**6, b"x" * 10**6))) < 5000


def test_our_environments_bring_their_words() -> None:
    """The actions that they name are all that are legal."""
    for spec, words, count in (
        (TASK_SPEC, MARIO, 12),
        (MinesEnvironment().env_init(), MINES, 4),
        (SkeletonEnvironment().env_init(), SKELETON, 2),
    ):
        texts = made(spec)
        assert words.rules in texts.rules
        assert f"Legal actions: {', '.join(words.actions)}." in texts.rules.splitlines()
        assert len(set(words.actions.values())) == len(words.actions) == count
        legal = parse_task_spec(spec).actions
        assert [action for action in words.actions.values() if legal.check(action) is not None] == []
    assert made(TASK_SPEC).names["stay"] == made(TASK_SPEC).still_at(Observation())
    mines = MinesEnvironment()
    for name, field in {"right": 1, "down": len(MINES_MAP[0]), "up": 0, "left": 0}.items():
        mines.env_start()
        assert mines.env_step(MINES.actions[name]).observation.ints[0] == field


def test_mario_is_a_picture_in_characters_and_an_image_on_request() -> None:
    texts = made(TASK_SPEC)
    lines = texts.seen(MARIO_SEEN).splitlines()
    assert [len(line) for line in lines[:16]] == [42] * 16
    assert sum(map(len, lines)) < 1000
    image = texts.image(MARIO_SEEN)
    assert image is not None
    assert image.startswith(b"\x89PNG")
    assert made(GRID).image(Observation([1])) is None


def test_a_choice_is_read_no_further_than_it_is_legal() -> None:
    with pytest.raises(IllegalChoice, match="1 to 20 actions"):
        made(GRID).actions(["1 0*21", "what is never read"], Observation())

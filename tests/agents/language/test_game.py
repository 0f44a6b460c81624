"""Turns, sequences, illegal choices and forfeits, without a hub or a model."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import repeat

import pytest

from agents.language.game import Answer, Game, GameOptions, GameOver, NotNow, Phase, Until
from env_server.toys import SkeletonEnvironment
from glue import Action, GlueError, Observation

SPEC = SkeletonEnvironment().env_init()


class Table:
    """A game of the skeleton walk, and the agent's side of it.

    Attributes:
        played: the actions that were taken, by their int.
    """

    def __init__(self, rewards: Iterator[float] | None = None, **options: float) -> None:
        self.now = 0.0
        self.game = Game(GameOptions(**options), lambda: self.now)  # type: ignore[arg-type]
        self.played: list[int] = []
        self._rewards = rewards or repeat(0.0)
        self._state = 10
        self.game.task(SPEC)
        self.start()

    def start(self) -> None:
        self._state = 10
        self.game.start(Observation([10]))

    def run(self, most: int = 100) -> None:
        """Take actions until the model has to choose."""
        for _ in range(most):
            action = self.game.next_action()
            if action is None:
                return
            self.played.append(int(action.ints[0]))
            self._state += 1 if self.played[-1] else -1
            if self._state in (0, 20):
                self.game.end(1.0)
                return
            self.game.step(next(self._rewards), Observation([self._state]))

    def act(self, turn: int, *actions: str, until: str = Until.END) -> Answer:
        self.game.act(turn, list(actions), until)
        self.run()
        return self.answer(turn)

    def answer(self, turn: int) -> Answer:
        answer = self.game.answer(turn)
        assert answer is not None
        return answer


@pytest.fixture
def table() -> Table:
    return Table()


def test_the_first_look_has_the_rules_and_every_answer_the_turn(table: Table) -> None:
    first, second = table.game.look(), table.game.look()
    assert table.game.texts is not None
    assert first.text == f"{table.game.texts.rules}\n\n{second.text}"
    answer = table.act(1, "right*3", "left")
    assert table.played == [1, 1, 1, 0]
    assert answer.text.count("@") == 1
    told = {"turn": 2, "episode": 1, "steps": 4, "over": False, "steps_left": None, "time_left": None}
    assert answer.data == told | {"reward": 0.0, "return": 0.0, "forfeit": False}


def test_a_repeated_turn_has_the_same_answer_and_no_other_turn_is_played(table: Table) -> None:
    first = table.act(1, "right")
    for _ in range(2):
        assert table.act(1, "right") is first
    for turn in (0, 1, 3, 10**5000):
        with pytest.raises(NotNow, match="the current turn is 2"):
            table.game.act(turn, ["left"])
        with pytest.raises(NotNow, match="the current turn is 2"):
            table.game.give_up(turn)
    assert table.played == [1]
    assert table.game.counts.repeated == 2


def test_a_sequence_stops_at_its_condition() -> None:
    def steps(until: str, rewards: list[float]) -> int:
        table = Table(iter(rewards))
        return int(table.act(1, "right", "left", "right*5", until=until).data["steps"])

    assert steps(Until.END, [0, 0, 1, 1, 2, 2, 2]) == 7
    assert steps(Until.REWARD, [5, 5, 5, 0, 1, 1, 1]) == 4
    assert steps(Until.CHANGE, [0] * 7) == 1


def test_illegal_choices_are_counted_and_too_many_in_a_row_forfeit() -> None:
    table = Table(illegal=3)
    for turn, choice, left in ((1, "fly", 2), (2, "swim", 1)):
        answer = table.act(turn, choice)
        assert answer.error
        assert f"current turn is {turn + 1}" in answer.text
        assert f"After {left} more in a row" in answer.text
        assert table.act(turn, choice) is answer  # a repeated call counts once
    assert table.act(3, "right", until="never").error
    assert table.game.look().data["forfeit"]
    assert table.game.counts.illegal == 3
    table.start()
    for turn, choice, error in ((5, "fly", True), (6, "fly", True), (7, "right", False), (8, "fly", True)):
        assert table.act(turn, choice).error is error
    assert "After 2 more in a row" in table.answer(8).text  # not in a row


def test_an_episode_that_is_forfeit_is_played_to_its_end_by_standing_still(table: Table) -> None:
    table.act(1, "right")
    table.game.give_up(2)
    answer = table.answer(2)
    assert (answer.data["over"], answer.data["forfeit"], answer.error) == (True, True, False)
    assert "forfeit: you have given up" in answer.text
    with pytest.raises(NotNow):
        table.game.act(3, ["right"])
    table.run()
    assert table.played == [1, *[0] * 11]
    assert table.game.counts.forfeits == 1
    table.start()
    assert table.game.look().data["forfeit"] is False


def test_a_forfeit_that_never_ends_is_an_error_of_the_agent(table: Table) -> None:
    table.game.give_up(1)
    for _ in range(10_000):
        table.game.next_action()
        table.game.step(0.0, Observation([10]))
    with pytest.raises(GlueError, match="step limit"):
        table.game.next_action()


def test_each_episode_begins_with_a_turn_of_its_own(table: Table) -> None:
    answer = table.act(1, "right*20")
    assert answer.data["over"]
    assert answer.data["return"] == 1.0
    with pytest.raises(NotNow, match="the episode is over"):
        table.game.act(answer.data["turn"], ["right"])
    table.start()
    with pytest.raises(NotNow, match="the current turn is 3"):
        table.game.act(answer.data["turn"], ["right"])
    assert table.act(1, "right*20") is answer
    assert table.act(3, "left").data["episode"] == 2


def test_an_episode_that_is_cut_off_is_over(table: Table) -> None:
    table.game.act(1, ["right*5"])
    table.run(2)
    table.start()
    assert table.answer(1).data["over"]
    table.game.act(3, ["right*5"])
    table.run(2)
    table.game.close()
    assert table.answer(3).data["over"]
    table.game.act(3, ["right*5"])  # repeated: its answer remains
    for call in (table.game.look, lambda: table.game.act(4, ["right"]), lambda: table.game.give_up(4)):
        with pytest.raises(GameOver, match="session has ended"):
            call()


def test_legal_actions_time_and_steps_left_are_told_and_used_up_time_forfeits() -> None:
    table = Table(seconds=10.0, steps=6, list_actions=True)
    table.now += 4
    data = table.game.look().data
    assert (data["time_left"], data["steps_left"]) == (6.0, 5)
    answer = table.act(1, "right*2")
    assert (answer.data["time_left"], answer.data["steps_left"]) == (6.0, 3)
    assert "3 steps left, 6 s left" in answer.text
    assert answer.data["legal"] == ["left", "right"]
    assert answer.text.endswith("Legal actions: left, right")
    table.game.act(2, ["right"])
    table.now += 100  # the environment's time, not the model's
    table.run()
    assert table.game.time_left == 6.0
    table.now += 7
    table.run(1)
    forfeit = table.game.look()
    assert forfeit.data["forfeit"]
    assert "its time is used up" in forfeit.text
    assert "0 s left" in forfeit.text
    assert table.game.counts.seconds == 11.0
    assert table.played[-1] == 0


def test_a_choice_that_the_step_limit_cuts_off_is_not_asked_for() -> None:
    table = Table(steps=4)
    answer = table.act(1, "right*2")
    assert (answer.data["steps_left"], answer.data["over"]) == (1, False)
    table.game.act(2, ["right*5"])
    table.run(1)
    assert table.answer(2).data.items() > {"turn": 3, "steps": 3, "steps_left": 0, "over": True}.items()
    table.run(1)  # stands still, and asks again, as the limit was another one
    assert table.played == [1, 1, 1, 0]
    assert table.game.next_action() is None
    assert table.act(3, "right").data["steps"] == 5


def test_raw_answers_are_kept_within_bounds(table: Table) -> None:
    for number in range(30):
        table.game.note(f"{number} \x1b[2J \ud800 " + '"ä' * number * 70, 3, 2)
        table.act(number + 1, "right", "left")
    record = table.game.record()
    assert (record["counts"]["tokens_in"], record["counts"]["tokens_out"]) == (90, 60)
    assert 1 <= len(record["answers"]) < 30
    assert record["answers"][-1]["answer"].startswith("29 ?[2J ?")
    assert len(json.dumps(record, ensure_ascii=False)) < 9000
    table.game.note("next")
    assert table.game.record()["newest"] == [{"turn": 31, "answer": "next"}]


def test_a_mask_says_what_is_legal_and_ends_a_sequence() -> None:
    right = [False, True]
    game = Game(GameOptions(list_actions=True, illegal=2))
    game.task(SPEC.replace("EXTRA ", "EXTRA masks "))
    game.start(Observation([10], mask=right))
    assert game.view().data["legal"] == ["1"]

    game.act(1, ["0", "1"])
    refused = game.answer(1)
    assert refused is not None
    assert refused.error
    assert "'0' is illegal in this turn; legal are: 1" in refused.text

    game.act(2, ["1*2", "0", "1"])
    for mask, goes_on in ((None, True), (right, False)):
        assert game.next_action() == Action([1])
        game.step(0.0, Observation([11], mask=mask))
        assert (game.phase is Phase.PLAYING) == goes_on
    game.give_up(3)
    assert game.next_action() == Action([1])  # standing still, 0, is illegal

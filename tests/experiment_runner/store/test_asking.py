"""Agents that are asked after each episode and each recorded step, and play on as if they had not been."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from agents.baselines import RandomAgent
from experiment_runner.cli.experiment import experiment
from experiment_runner.store.merge import merge
from experiment_runner.store.records import MAX_ANSWER, Answer, Answered
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.trajectory import TrajectoryReader
from glue.wire.messages import Kind
from tests.experiment_runner.executors.test_trial import SPEC, Lossy, play
from tests.system.runs import contents


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: object) -> None:
    words = [*map(str, arguments), "--in-process"]
    assert CliRunner().invoke(experiment, words, standalone_mode=False).return_value == 0


def answers(directory: str) -> list[Answered]:
    with Results.open(Path(directory)) as results:
        (trial,) = results.trials()
        return results.answers(trial.spec.id)


LEARNING = ("--env", "mines", "--agent", "sarsa", "--max-steps", 9, "--seed", 4)


def test_asking_changes_no_result_and_no_recorded_step() -> None:
    run(*LEARNING, "--episodes", 6, "--out", "usual", "--record", "usual.traj")
    asked = ("--ask", "values", "--ask", "<script>", "--ask", "values")
    run(*LEARNING, "--episodes", 6, "--out", "asked", "--record", "asked.traj", *asked)
    run(*LEARNING, "--episodes", 3, "--out", "fewer", *asked)
    assert contents(Path("asked")) == contents(Path("usual"))
    usual, recorded = [*TrajectoryReader("usual.traj")], [*TrajectoryReader("asked.traj")]
    assert [(one.start, one.steps, one.ending) for one in recorded] == [
        (one.start, one.steps, one.ending) for one in usual
    ]
    # The answer after the last step equals the answer after the episode.
    stored = answers("asked")
    assert [(one.episode, one.message) for one in stored] == [
        (episode, message) for episode in range(1, 7) for message in ("<script>", "values")
    ]
    values = [one.answer for one in stored if one.message == "values"]
    assert len(set(values)) == 6
    assert [[*one.answers][-1].answer for one in recorded] == values
    # Each step changes one value, so each except the first has a new answer; the other answer never changes.
    for episode in recorded:
        steps = [one.step for one in episode.answers if one.message == "values"]
        assert steps == [0, *range(2, len(episode.steps) + 1)] or steps == [*range(len(episode.steps) + 1)]
        assert [one.step for one in episode.answers if one.message == "<script>"] == [0]
    assert answers("fewer") == stored[:6]
    assert answers("usual") == []


def test_answers_go_back_with_their_episodes_and_are_merged() -> None:
    run(*LEARNING, "--episodes", 4, "--out", "a", "--ask", "values")
    found = answers("a")
    shutil.copytree("a", "b")
    with Results.open(Path("a")) as results:
        merge([results], Path("merged"))
    assert answers("merged") == found
    with Store.open(Path("b")) as store:
        (trial,) = store.trials()
        assert store.newest_answers() == found[-1:]
        store.rewind(trial.spec.id, 2)
        assert store.answers(trial.spec.id) == found[:2]


class Wordy(RandomAgent):
    """Answers with more text than is kept, and with text that is not Unicode."""

    def agent_message(self, message: str) -> str:
        return "\ud800" + message * MAX_ANSWER


def test_an_agent_that_is_lost_when_it_is_asked_plays_the_episode_again() -> None:
    lossy = Lossy({Kind.RL_AGENT_MESSAGE: {2}}, Wordy)
    kept = play(lossy, spec=replace(SPEC, episodes=2), questions=("ab",))
    answer = Answer("ab", ("?" + "ab" * MAX_ANSWER)[:MAX_ANSWER])
    assert kept.answers == [(answer,), (answer,)]
    assert kept.voids == [2]

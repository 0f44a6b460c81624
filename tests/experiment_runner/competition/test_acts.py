"""Acts of the organiser while a competition is held at once: real matches, turn by turn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.cli.compete_serve import organise
from experiment_runner.competition.course import Course
from experiment_runner.competition.organiser import Held, open_competition
from experiment_runner.competition.season.acts import addition, answering
from experiment_runner.competition.season.control import Door, ask
from experiment_runner.competition.settings import Gate, parse_competition
from experiment_runner.executors.dispatcher import Dispatcher
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.store.results import Results
from glue.client.libzmq import new_pair
from glue.errors import ExperimentError
from glue.keys.certificates import write_pair
from tests.experiment_runner.competition.season.inside import SECRET, Absent, Season

FILE = """\
name = "spring"
seed_env = "SECRET"
trials = 2
tasks.mines = { env = "mines", options.random_start = true, steps = 20 }
entrants.alice.command = ["true"]
entrants.bob.command = ["true"]
"""


class Run(Season):
    """A run of the same kind, of which a test takes each turn."""

    def start(self) -> None:
        store = self.stack.enter_context(
            open_competition(self.directory, self.text, self.competition, SECRET)
        )
        self.said.clear()
        gate = Gate("tcp://127.0.0.1:4097", self.folder / "keys")
        self.held = self.stack.enter_context(Held(store, self.competition, SECRET, self.said.append, gate))
        self.visit = answering(self.stack.enter_context(Door(self.directory)))
        interrupts = self.stack.enter_context(Interrupts())
        self.dispatcher = Dispatcher(self.executor, self.held, interrupts)
        self.held.begin(self.dispatcher)

    def goes_on(self) -> bool:
        """Play what can be played; return whether anything waits or plays."""
        for _ in range(20):
            self.dispatcher.turn(0)
        return self.dispatcher.turn(0)

    def answered(self, command: Callable[[], Any]) -> Any:
        """Return what a command returns, which asks the run from another thread."""
        with ThreadPoolExecutor(1) as commands:
            asking = commands.submit(command)
            while not asking.done():
                self.visit(self.held, 0.01)
        return asking.result()

    def organise(self, kind: str, **wish: Any) -> None:
        """Carry out an act as its command does."""
        self.answered(partial(organise, self.directory, kind, why="because", **wish))

    def counts(self) -> Counter[str]:
        """Return how many of the trials that count are over, by their entrant."""
        with Results.open(self.directory) as results:
            over = results.outcomes()
        return Counter(trial.parts[0] for trial in self.course.trials if trial in over)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    made = Run(tmp_path, FILE)
    with made.stack:
        yield made


def test_who_is_excluded_while_it_plays_is_ended_at_once(run: Run) -> None:
    run.executor.agents["alice"] = None  # plays for ever
    assert run.goes_on()
    run.organise("exclude", subject="alice")
    assert not run.executor.jobs
    assert not run.goes_on()
    assert run.counts() == {"bob": 2}
    del run.executor.agents["alice"]
    run.organise("readmit", subject="alice")
    assert not run.goes_on()
    assert run.counts() == {"alice": 2, "bob": 2}


def test_who_is_absent_is_waited_for_once_more_after_the_others(tmp_path: Path) -> None:
    text = FILE.replace("trials = 2", "trials = 5")
    for name in ("alice", "bob"):
        write_pair(tmp_path, name, new_pair())
        text = text.replace(f'{name}.command = ["true"]', f'{name}.key = "{name}.key"')
    run = Run(tmp_path, text)
    with run.stack:
        run.executor.agents["alice"] = Absent
        for _ in range(6):
            run.dispatcher.turn(0)
        assert run.executor.played == [
            f"{one}/mines/{n}" for n in range(5) for one in ("alice", "bob")[n > 0 :]
        ]
        del run.executor.agents["alice"]
        run.dispatcher.turn(0)
        run.executor.agents["alice"] = Absent
        assert not run.goes_on()
        assert run.counts() == {"alice": 5, "bob": 5}
        assert run.executor.awaited == [f"alice/mines/{n}" for n in (0, 2, 3)]


def test_what_is_played_again_is_played_at_once_and_counts(run: Run) -> None:
    with pytest.raises(ExperimentError, match="no trial of alice is over"):
        run.organise("rerun", subject="alice")
    run.goes_on()
    run.organise("rerun", subject="bob/mines/1")
    run.goes_on()
    run.organise("rerun", subject="alice")
    assert not run.goes_on()
    assert run.executor.played[4:] == ["bob/mines/2", "alice/mines/2", "alice/mines/3"]
    assert run.counts() == {"alice": 2, "bob": 2}


def test_who_is_added_plays_the_same_levels(run: Run) -> None:
    run.executor.agents["bob"] = None
    run.goes_on()
    late = run.folder / "late.toml"
    late.write_text(FILE + 'entrants.carol.command = ["true"]\n')
    run.organise("add", **addition(run.course, late, SECRET))
    del run.executor.agents["bob"]
    run.goes_on()
    with Results.open(run.directory) as results:
        specs = {str(record.spec.id): record.spec for record in results.trials()}
    assert specs["carol/mines/1"].environment == specs["bob/mines/1"].environment
    assert run.counts() == {"alice": 2, "carol": 2}
    run.text = late.read_text()
    run.restart()
    assert not run.goes_on()
    assert run.counts() == {"alice": 2, "bob": 2, "carol": 2}


def test_what_is_paused_starts_when_it_is_resumed_also_after_a_restart(run: Run) -> None:
    run.organise("pause", subject="bob")
    assert run.goes_on()
    assert run.counts() == {"alice": 2}
    run.organise("pause")
    run.organise("resume", subject="bob")
    run.restart()
    assert "* is paused: because" in run.said[0]
    assert run.goes_on()
    assert run.counts()["bob"] == 0
    run.organise("resume")
    assert not run.goes_on()
    assert run.counts()["bob"] == 2
    with pytest.raises(ExperimentError, match="the run is not paused"):
        run.organise("resume")


def test_what_a_run_does_not_have_is_refused_by_name(run: Run) -> None:
    run.organise("exclude", subject="alice")
    for kind, subject, why in (
        ("grant", "bob", r"grant is an act of a season.*rerun has an entrant play again"),
        ("pause", "carol", "there is no entrant carol"),
        ("exclude", "carol", "there is no entrant carol; there are alice, bob"),
        ("exclude", "alice", "alice is excluded: because"),
        ("rerun", "bob/mines/7", "there is no trial bob/mines/7"),
        ("rerun", "bob/mines/1", "bob/mines/1 is not over"),
    ):
        with pytest.raises(ExperimentError, match=why):
            run.organise(kind, subject=subject)
    reply = run.answered(partial(ask, run.directory, {"do": "status"}))
    assert (reply["ok"], reply["error"]) == (False, "the season is over, and its final is played")


def test_a_run_of_before_there_were_journals_has_the_entrants_of_its_file(tmp_path: Path) -> None:
    competition = parse_competition(FILE, tmp_path / "spring.toml")
    course = Course(competition, [])
    assert [(name, act.player) for name, act in course.entrants.items()] == [
        (one.name, one.player) for one in competition.entrants
    ]
    assert len(course.trials) == len(competition.entrants) * len(competition.tasks) * competition.trials > 0

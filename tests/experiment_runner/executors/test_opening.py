from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import ModuleType

import pytest

from env_server.mario.pictures import digest_of
from experiment_runner.cli.make_plan import make_plan, role_sweeps
from experiment_runner.executors.opening import Remaining, open_run, remaining
from experiment_runner.plan.file import dump_plan, load_plan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.plan.provenance import program
from experiment_runner.store.layout import ABOUT_FILE, PLAN_FILE, DirectoryTaken, remove_run
from experiment_runner.store.records import Checkpoint, EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from glue.wire.messages import Role

PLAN = Plan(episodes=5, trials=4, agents=(RoleSweep("sarsa", {"step_size": 0.5}),))
DONE, CHECKPOINTED, PLAIN, UNTOUCHED = (spec.id for spec in PLAN.expand())


def result(trial_id: str, episode: int) -> EpisodeResult:
    return EpisodeResult(episode, hash((trial_id[-1], episode)) / 7, episode, True, 0.5)


def run(store: Store, trial_id: str, first: int, last: int, checkpoint_at: int = 0) -> None:
    for episode in range(first, last + 1):
        checkpoint = Checkpoint(b"after %d" % episode) if episode == checkpoint_at else None
        store.record(trial_id, result(trial_id, episode), checkpoint)


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    directory = tmp_path / "run"
    with open_run(directory, PLAN) as store:
        run(store, DONE, 1, 5, checkpoint_at=5)
        run(store, CHECKPOINTED, 1, 4, checkpoint_at=3)
        run(store, PLAIN, 1, 2)
        store.record_failure(PLAIN, "the agent crashed")
    return directory


def test_run_says_what_it_is_and_what_made_it(interrupted: Path) -> None:
    assert load_plan(interrupted / PLAN_FILE) == PLAN
    about = json.loads((interrupted / ABOUT_FILE).read_text())
    assert about["program"] == program()
    assert about["program"].startswith("glue-rl ")
    assert about["packages"]["numpy"] == metadata.version("numpy")
    assert about["machine"]["cores"] >= 1
    assert set(about["machine"]) == {"name", "system", "processor", "cores"}


def test_trials_go_on_after_their_checkpoint_or_start_over(interrupted: Path) -> None:
    expected = [Remaining(CHECKPOINTED, 3, 1), Remaining(PLAIN, 0, 2), Remaining(UNTOUCHED, 0, 0)]
    with Results.open(interrupted) as results:
        assert remaining(results) == expected
    with open_run(interrupted, PLAN) as store:
        assert remaining(store) == [trial._replace(dropped=0) for trial in expected]
        assert [record.done for record in store.trials()] == [5, 3, 0, 0]
        assert store.checkpoint(CHECKPOINTED) == (3, Checkpoint(b"after 3"))
        assert all(record.failure is None for record in store.trials())
        assert [(e.kind, e.trial_id, e.text) for e in store.events()] == [
            ("start", None, program()),
            ("resume", None, program()),
            ("rewind", CHECKPOINTED, "continues after episode 3; 1 recorded episode is run again"),
            ("rewind", PLAIN, "starts over; 2 recorded episodes are run again"),
        ]


def test_directory_of_another_plan_is_refused_untouched(interrupted: Path) -> None:
    other = replace(PLAN, episodes=4, agents=(RoleSweep("sarsa", {"step_size": 0.25}),))
    message = r"another plan \(episodes is 4, not 5; step_size of sarsa is 0.25, not 0.5\)"
    with pytest.raises(DirectoryTaken, match=message):
        open_run(interrupted, other)
    with Results.open(interrupted) as results:
        assert [record.done for record in results.trials()] == [5, 4, 2, 0]
        assert [event.kind for event in results.events()] == ["start"]
    open_run(interrupted, PLAN).close()  # the lock is free


def test_plan_edited_behind_the_runs_back_is_refused(interrupted: Path) -> None:
    path = interrupted / PLAN_FILE
    path.write_text(path.read_text().replace("episodes = 5", "episodes = 4"))
    with pytest.raises(ExperimentError, match=r"plan.toml was changed after its run began"):
        open_run(interrupted, PLAN)


@pytest.mark.parametrize("killed", [False, True])
def test_longer_plan_extends_a_run(interrupted: Path, killed: bool) -> None:
    longer = replace(PLAN, episodes=7, trials=5)
    if killed:  # after writing the plan, before writing the trials
        (interrupted / PLAN_FILE).write_text(dump_plan(longer))
    with open_run(interrupted, longer) as store:
        left = remaining(store)
        assert load_plan(interrupted / PLAN_FILE) == longer
        assert {trial.spec.id: trial.spec for trial in store.trials()} == {s.id: s for s in longer.expand()}
        new = longer.expand()[-1].id
        assert left[:2] == [Remaining(DONE, 5, 0), Remaining(CHECKPOINTED, 3, 0)]
        assert left[-1] == Remaining(new, 0, 0)
        run(store, DONE, 6, 7)
        run(store, new, 1, 7)
    with pytest.raises(DirectoryTaken, match="episodes is 5, not 7; trials is 4, not 5"):
        open_run(interrupted, PLAN)


def test_changed_file_is_named_and_the_run_left_as_it_is(tmp_path: Path) -> None:
    agent, weights = tmp_path / "mine.py", tmp_path / "weights"
    agent.write_text("one")
    weights.write_bytes(b"two")
    plan = Plan(episodes=1, agents=(RoleSweep(f"{agent}:Mine", {"policy": str(weights)}),))
    directory = tmp_path / "run"
    open_run(directory, plan).close()
    about = json.loads((directory / ABOUT_FILE).read_text())
    assert [(directory / about["files"][str(path)]["copy"]).read_text() for path in (agent, weights)] == [
        "one",
        "two",
    ]
    open_run(directory, plan).close()
    weights.write_bytes(b"three")
    with pytest.raises(DirectoryTaken, match=re.escape(f"({weights} has changed since)")):
        open_run(directory, plan)
    remove_run(directory)
    assert not directory.exists()


def test_a_run_goes_on_with_the_file_that_its_option_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From another folder, the same name is another file; or none, as a player will say that needs one."""
    plan, directory = Plan(episodes=1, agents=(RoleSweep("sarsa", {"policy": "data.txt"}),)), tmp_path / "run"
    for folder, text in (("begun", "5"), ("copied", "5"), ("other", "2"), ("without", None)):
        (tmp_path / folder).mkdir()
        if text is not None:
            (tmp_path / folder / "data.txt").write_text(text)
    for folder in ("begun", "begun", "copied", "without"):
        monkeypatch.chdir(tmp_path / folder)
        open_run(directory, plan).close()
    monkeypatch.chdir(tmp_path / "other")
    with pytest.raises(DirectoryTaken, match=r"begun/data\.txt is not what its option names"):
        open_run(directory, plan)


def test_a_run_goes_on_without_a_file_that_is_gone_but_not_with_another_behind_a_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    gone, other, another, link = map(Path, ("a/data.txt", "b/data.txt", "c/data.txt", "link.txt"))
    for file in (gone, other, another):
        file.parent.mkdir()
        file.write_text(str(file))
    link.symlink_to(other)
    options = {"first": str(gone), "second": str(link)}
    plan, directory = Plan(episodes=1, agents=(RoleSweep("sarsa", options),)), tmp_path / "run"
    open_run(directory, plan).close()
    gone.unlink()
    open_run(directory, plan).close()
    link.unlink()
    link.symlink_to(another)
    with pytest.raises(DirectoryTaken, match=r"b/data\.txt is not what its option names"):
        open_run(directory, plan)


def test_a_run_on_the_level_of_a_file_is_of_that_file(tmp_path: Path) -> None:
    level, directory = tmp_path / "level.txt", tmp_path / "run"
    level.write_text("X" * 20)

    def plan() -> Plan:
        sweeps = role_sweeps(Role.ENVIRONMENT, "mario", (f"level={level}", "instance=9"))
        return make_plan(None, {"episodes": 1}, {"environments": sweeps})

    options = plan().environments[0].options
    assert options == {"level": str(level), "instance": 9, "level_digest": digest_of(level)}
    open_run(directory, plan()).close()
    open_run(directory, plan()).close()
    assert json.loads((directory / ABOUT_FILE).read_text())["files"][str(level)]["sha256"] == digest_of(level)
    level.write_text("X" * 21)
    with pytest.raises(DirectoryTaken, match=r"level\.txt has changed since"):
        open_run(directory, plan())


def test_module_without_a_file_is_no_file_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_memory = ModuleType("in_memory")
    in_memory.__file__ = "_ops.py"  # as in torch.ops
    monkeypatch.setitem(sys.modules, "in_memory", in_memory)
    open_run(tmp_path / "run", PLAN).close()
    about = json.loads((tmp_path / "run" / ABOUT_FILE).read_text())
    assert not [path for path in about.get("files", {}) if path.endswith("_ops.py")]


def test_run_without_a_plan_cannot_continue(interrupted: Path) -> None:
    (interrupted / PLAN_FILE).unlink()
    with pytest.raises(ExperimentError, match="was merged from other runs"):
        open_run(interrupted, PLAN)

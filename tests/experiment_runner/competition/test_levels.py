"""The levels of a competition's task in files beside the competition's."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from env_server.mario.pictures import digest_of
from experiment_runner.competition.environment import RecordedEnvironment
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records.record import RecordFile, record_path
from experiment_runner.competition.records.replay import made_for, recorded_run
from experiment_runner.competition.records.seal import add_trials, record_outcome
from experiment_runner.competition.records.verify import replay_trial, verify
from experiment_runner.competition.season.bundle import bundle
from experiment_runner.competition.settings import parse_competition
from experiment_runner.competition.trials import public_trial, trials
from experiment_runner.executors.recording import run_of
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.layout import SOURCES, copy_of
from experiment_runner.store.records import TrialEnd
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError
from glue.trajectory import ActionWriter, Ending, Run
from glue.types import Action, step_of
from tests.experiment_runner.competition.contest import compete

SECRET = b"hush"
STAY = Action([0, 0, 0])
FILE = """\
trials = 3
seed_env = "SECRET"
tasks.own = { env = "mario", options.instance = 9, levels = ["one.txt", "two.txt"], episodes = 1 }
entrants.alice.command = ["true"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "one.txt").write_text("X" * 20)
    (tmp_path / "two.txt").write_text("X" * 21)
    return tmp_path


def trials_of(folder: Path, text: str = FILE) -> list[TrialSpec]:
    return trials(parse_competition(text, folder / "spring.toml"), SECRET)


def test_the_trials_of_a_task_play_its_levels_in_turn(folder: Path) -> None:
    specs = trials_of(folder)
    files = [folder / "one.txt", folder / "two.txt", folder / "one.txt"]
    expected = [{"instance": 9, "level": str(file), "level_digest": digest_of(file)} for file in files]
    assert [spec.environment.options for spec in specs if spec.environment] == expected
    task = parse_competition(FILE, folder / "spring.toml").tasks[0]
    tried = public_trial(task, "alice", 1, 10).environment
    assert tried is not None
    assert tried.options == {"instance": 9}, "an entrant is tried on the default level"


def test_a_level_that_was_changed_is_not_played(folder: Path) -> None:
    held = parse_competition(FILE, folder / "spring.toml")
    open_competition(folder / "run", FILE, held, SECRET).close()
    specs = trials(held, SECRET)
    (folder / "two.txt").write_text("X" * 22)
    with pytest.raises(
        ExperimentError, match=r"level_digest of alice/own/1 was \w{64}, not \w{64}: put that back"
    ):
        open_competition(folder / "run", FILE, held, SECRET)
    with pytest.raises(ConfigError, match=r"two\.txt has changed"):
        made_for(specs[1])  # as verification does


@pytest.mark.parametrize("run", [recorded_run, run_of], ids=["now", "older"])
def test_a_record_names_its_level_not_where_it_is(folder: Path, run: Callable[..., Run]) -> None:
    spec = trials_of(folder)[0]
    path = folder / "record.traj"
    environment = made_for(spec)
    begun = run(spec, environment.env_init())
    with path.open("wb") as file:
        writer = ActionWriter(file.write)
        writer.run(begun)
        environment.env_start()
        writer.start()
        for _ in range(5):
            step = step_of(environment.env_step(STAY))
            writer.step(STAY.body, step.reward)
        writer.end(Ending.CUTOFF)
        writer.close()
    assert begun.options["level"] == ("one.txt" if run is recorded_run else str(folder / "one.txt"))
    ((ending, steps, *_),), *_ = replay_trial(spec, path)
    assert (ending, steps) == (Ending.CUTOFF, 5)


def play(store: Store, spec: TrialSpec, action: Action = STAY) -> None:
    with RecordFile(record_path(store.directory, spec.id)) as file:
        writer = ActionWriter(file.append)
        environment = RecordedEnvironment(
            made_for(spec), writer, spec, lambda result: store.record(spec.id, result)
        )
        environment.env_init()
        environment.env_start()
        environment.env_step(action)
        environment.end(Ending.CUTOFF)
        writer.close()
        record_outcome(store, spec.id, TrialEnd(None, file.finish()))


@pytest.mark.parametrize("older", [False, True])
def test_a_bundle_is_verified_where_the_files_of_its_levels_are_not(folder: Path, older: bool) -> None:
    held = parse_competition(FILE, folder / "spring.toml")
    with open_competition(folder / "run", FILE, held, SECRET) as store:
        for record in store.trials():
            play(store, record.spec)
    if older:  # as before there were copies
        shutil.rmtree(folder / "run" / SOURCES)
    bundle(folder / "run", folder / "bundle")
    shutil.rmtree(folder / "run")
    levels = [folder / name for name in ("one.txt", "two.txt")]
    copies = {copy_of(level, digest_of(level)): level.read_bytes() for level in levels}
    for level in levels:
        level.unlink()
    found = (folder / "bundle" / SOURCES).iterdir()
    assert {f"{SOURCES}/{path.name}": path.read_bytes() for path in found} == copies
    with Store.open(folder / "bundle") as store:
        assert verify(store, {"own": 0}, print) == 0


def test_no_code_is_loaded_because_a_run_names_it(folder: Path) -> None:
    """An environment in a file of the organiser's is played from the verifier's own copy of it."""
    code = "from env_server.toys import SkeletonEnvironment\nclass World(SkeletonEnvironment): pass\n"
    (folder / "world.py").write_text(code)
    played = 'env = "mario", options.instance = 9, levels = ["one.txt", "two.txt"]'
    text = FILE.replace(played, 'env = "world.py:World"')
    with open_competition(
        folder / "run", text, parse_competition(text, folder / "spring.toml"), SECRET
    ) as store:
        for record in store.trials():
            play(store, record.spec, Action([0]))
    (folder / "spring.toml").write_text(text)
    told = compete(folder, "run", "spring.toml", "--out", "run", secret=SECRET.decode())
    assert f"now: glue-compete verify run --env {folder}/world.py:World\n" in told
    assert "glue-compete verify bundle --env world.py:World\n" in compete(folder, "bundle", "run", "bundle")
    (folder / "world.py").write_text(f"open({str(folder / 'loaded')!r}, 'w')\n{code}")
    (folder / "copy").mkdir()
    (folder / "copy" / "world.py").write_text(code)
    with Store.open(folder / "bundle") as store:
        for others in [], ["mario"], ["world.py:Other"]:
            with pytest.raises(ConfigError, match=r"alice/own/0 .*/world\.py:World, which is not installed"):
                verify(store, {"own": 0}, print, others)
        assert verify(store, {"own": 0}, print, [f"{folder}/copy/world.py:World"]) == 0
    assert not (folder / "loaded").exists()


def test_an_opponent_is_code_that_a_run_names_too(folder: Path) -> None:
    game = RoleSpec("pettingzoo:go_v5", {"opponent": "theirs.py:Go"})
    with open_competition(
        folder / "run", FILE, parse_competition(FILE, folder / "spring.toml"), SECRET
    ) as store:
        add_trials(store, [replace(store.trials()[0].spec, id=TrialId("alice/own/3"), environment=game)])
        for others in [], ["elsewhere/theirs.py:Go"]:
            with pytest.raises(ConfigError, match=r"alice/own/3 .*theirs\.py:Go, which is not inst"):
                verify(store, {"own": 0}, print, others)
        assert verify(store, {"own": 0}, print, ["theirs.py:Go"]) == 0
    assert bundle(folder / "run", folder / "bundle") == ["theirs.py:Go"]


def test_a_bundle_has_no_other_level_than_was_played(folder: Path) -> None:
    open_competition(folder / "run", FILE, parse_competition(FILE, folder / "spring.toml"), SECRET).close()
    shutil.rmtree(folder / "run" / SOURCES)
    (folder / "two.txt").write_text("X" * 22)
    with pytest.raises(ExperimentError, match=r"two\.txt has changed since the run began"):
        bundle(folder / "run", folder / "bundle")
    assert not (folder / "bundle").exists()


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('"mario", options.instance = 9', '"mines"', "task own: mines reads no levels from files"),
        ("instance = 9", 'level = "one.txt"', r"task own: levels from files are not an option: levels = \["),
        ("two.txt", "three.txt", r"three\.txt: No such file"),
        ('["one.txt", "two.txt"]', '"one.txt"', "levels must be a list"),
    ],
)
def test_what_is_refused(old: str, new: str, why: str, folder: Path) -> None:
    with pytest.raises(Exception, match=why):
        trials_of(folder, FILE.replace(old, new))

"""Files that a stranger has laid in a run, a competition, a folder of keys or in place of a recording.

Whatever lies there, reading and continuing end at once with a result or with one clear error, and nothing is
written outside the folder. Who waits for a file, as opening a FIFO would, meets the timeout of its test.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from env_server.replay.episodes import open_recording, recorded_moments
from experiment_runner.competition.board.standings import standings
from experiment_runner.competition.course import course_of
from experiment_runner.competition.records.verify import verify
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.overview import as_text, overview
from experiment_runner.store.layout import clear, live_sessions, lock_holder, remove_run, runs_under
from experiment_runner.store.merge import merge
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import episode_table
from experiment_runner.store.store import Store
from experiment_runner.view.catalog import Catalog, run_in_full
from glue.errors import ExperimentError, GlueError
from glue.trajectory import Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation
from tests.experiment_runner.competition.contest import compete

PLAN = Plan(episodes=2, environments=(RoleSweep("mines"),), agents=(RoleSweep("sarsa"),))
PRECIOUS = b"precious " * 20


def hole(path: Path, victim: Path) -> None:
    path.touch()
    os.truncate(path, 2**40)


def unreadable(path: Path, victim: Path) -> None:
    path.write_bytes(b"x")
    path.chmod(0)


THINGS: dict[str, Callable[[Path, Path], object]] = {
    "link": Path.symlink_to,
    "fifo": lambda path, victim: os.mkfifo(path),
    "hole": hole,
    "hard link": Path.hardlink_to,
    "dangling link": lambda path, victim: path.symlink_to(path.parent.parent / "nothing"),
    "device": lambda path, victim: path.symlink_to("/dev/zero"),
    "folder": lambda path, victim: (path / "inner").mkdir(parents=True),
    "unreadable": unreadable,
}
MOST = ("link", "fifo", "hole")
each_thing = pytest.mark.parametrize(
    "thing",
    [name if name in MOST else pytest.param(name, marks=pytest.mark.stage("attacks")) for name in THINGS],
)


def lay(path: Path, thing: str, victim: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    victim.write_bytes(PRECIOUS)
    THINGS[thing](path, victim)


def tried(*uses: Callable[[], object]) -> None:
    """Try each use of a folder; only our own errors are allowed."""
    for use in uses:
        with contextlib.suppress(GlueError):
            use()


def read_run(directory: Path) -> None:
    with Results.open(directory) as results:
        overview(results)
        as_text([results])
        [*episode_table(results).rows]


def merge_run(directory: Path) -> None:
    with Results.open(directory) as results:
        merge([results], directory.with_name("merged"))


def resume(directory: Path) -> None:
    open_run(directory, PLAN).close()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two runs, to be copied."""
    folder = tmp_path_factory.mktemp("made")
    with open_run(folder / "run", PLAN) as store:
        store.record(store.trials()[0].spec.id, EpisodeResult(1, 1.0, 2, True, 0.1))
    open_run(folder / "sound", PLAN).close()
    return folder


@pytest.mark.parametrize(("damaged", "opened"), [("run/parts/0", "run"), ("", "parts/0")])
def test_a_damaged_database_above_or_below_is_named(tmp_path: Path, damaged: str, opened: str) -> None:
    resume(tmp_path / opened)
    (tmp_path / damaged).mkdir(parents=True, exist_ok=True)
    (tmp_path / damaged / "results.sqlite").write_bytes(b"no database")
    with pytest.raises(ExperimentError, match=f"cannot read {tmp_path / damaged}: file is not a database"):
        resume(tmp_path / opened)


@each_thing
@pytest.mark.parametrize(
    "name",
    ["lock", "plan.toml", "run.json", "results.sqlite", "results.sqlite-wal", "notes.json", "hubs.json"],
)
def test_a_run(made: Path, tmp_path: Path, name: str, thing: str) -> None:
    directory, victim = shutil.copytree(made, tmp_path / "runs") / "run", tmp_path / "victim"
    lay(directory / name, thing, victim)
    lock_holder(directory)
    live_sessions(directory)
    catalog = Catalog([tmp_path / "runs"])
    shown = {str(found["path"]): found["state"] for found in catalog.changes().values() if found}
    assert shown[str(tmp_path / "runs/sound")] == "interrupted"
    tried(
        lambda: read_run(directory),
        lambda: run_in_full(directory),
        lambda: merge_run(directory),
        lambda: resume(directory),
    )
    tried(lambda: clear(directory), lambda: remove_run(directory))
    assert victim.read_bytes() == PRECIOUS
    assert not (tmp_path / "runs/nothing").exists()
    assert [path.name for path in runs_under(tmp_path / "runs")].count("sound") == 1


@pytest.mark.parametrize("linked", [Path.symlink_to, Path.hardlink_to])
def test_the_database_of_another_run_is_not_written_to(
    made: Path, tmp_path: Path, linked: Callable[[Path, Path], None]
) -> None:
    runs = shutil.copytree(made, tmp_path / "runs")
    before = (runs / "sound/results.sqlite").read_bytes()
    (runs / "run/results.sqlite").unlink()
    linked(runs / "run/results.sqlite", runs / "sound/results.sqlite")
    with pytest.raises(GlueError, match=r"symbolic link|hard link"):
        resume(runs / "run")
    assert (runs / "sound/results.sqlite").read_bytes() == before


def test_a_folder_of_a_run_that_leads_elsewhere_is_not_written_to(made: Path, tmp_path: Path) -> None:
    run = shutil.copytree(made / "run", tmp_path / "run")
    (run / "records").symlink_to(tmp_path)
    with pytest.raises(GlueError, match="records is a symbolic link, which no run has: remove it"):
        resume(run)


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A competition that was held and verified, of an entrant whose program ends at once."""
    home = tmp_path_factory.mktemp("held")
    text = 'seed_env = "SECRET"\ntasks.walk = { env = "skeleton", episodes = 1 }\n'
    (home / "small.toml").write_text(text + 'entrants.a.command = ["true"]\n')
    compete(home, "run", "small.toml", "--out", "run")
    compete(home, "verify", "run")
    return home / "run"


def board(directory: Path) -> None:
    with Results.open(directory) as results:
        standings(results, course_of(directory))


def verify_again(directory: Path) -> None:
    with Store.open(directory) as store:
        verify(store, {"walk": 0}, lambda line: None)


@each_thing
@pytest.mark.parametrize(
    "name",
    [
        *("competition.toml", "journal.jsonl", "seal.json", "run.json", "lock"),
        *("records/a/walk/0.traj", "records/a"),
    ],
)
def test_a_competition(held: Path, tmp_path: Path, name: str, thing: str) -> None:
    directory, victim = tmp_path / "run", tmp_path / "victim"
    shutil.copytree(held, directory)
    lay(directory / name, thing, victim)
    tried(lambda: board(directory), lambda: verify_again(directory), lambda: remove_run(directory))
    assert victim.read_bytes() == PRECIOUS


@each_thing
@pytest.mark.parametrize("name", ["hub.key_secret", "hub.key", "allow.toml", "user.key"])
def test_a_folder_of_keys(tmp_path: Path, name: str, thing: str) -> None:
    pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
    from glue.keys.allowed import read_keys
    from tests.keyed import KeyFolder

    keys = KeyFolder(tmp_path / "keys")
    keys.entrant("user")
    keys.allow('[user]\nrole = "agent"\n')
    lay(keys.path / name, thing, tmp_path / "victim")
    with contextlib.suppress(GlueError):
        read_keys(keys.path)
    assert (tmp_path / "victim").read_bytes() == PRECIOUS


@each_thing
def test_a_recording(tmp_path: Path, thing: str) -> None:
    path, victim = tmp_path / "a/x.traj", tmp_path / "victim"
    lay(path, thing, victim)
    tried(
        lambda: [*TrajectoryReader(path)],
        lambda: [*recorded_moments(open_recording(path))],
        lambda: TrajectoryWriter(path),
    )
    assert victim.read_bytes() == PRECIOUS


def test_the_error_says_what_lies_there_and_what_to_do(tmp_path: Path) -> None:
    with TrajectoryWriter(tmp_path / "x.traj") as recording:
        recording.run(Run("skeleton", {}, ""))
        recording.start(Observation())
        recording.step(Action(), 1.0, Observation(), True)
    (tmp_path / "link.traj").symlink_to(tmp_path / "x.traj")
    os.mkfifo(tmp_path / "fifo.traj")
    for name, what in (
        ("link", "it is a symbolic link, which is not followed"),
        ("fifo", "it is not a regular file"),
    ):
        with pytest.raises(GlueError, match=f"cannot read .*{name}.traj: {what}"):
            [*TrajectoryReader(tmp_path / f"{name}.traj")]

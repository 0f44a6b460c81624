from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.store import schema
from experiment_runner.store.layout import ABOUT_FILE, PLAN_FILE, UNFINISHED, lock_holder
from experiment_runner.store.records import Checkpoint, EpisodeResult, OutsidePlayer, RunEvent, Void
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from tests.proof import size

PLAN = Plan(
    episodes=100_000,
    trials=2,
    environments=(RoleSweep("mario", {"level_seed": (121, 122), "slow": False}),),
    agents=(RoleSweep("random", {"speed": 0.1}),),
)
FIRST, SECOND, THIRD, FOURTH = (spec.id for spec in PLAN.expand())
FILES = {PLAN_FILE: "the plan\n"}
NOBODY = 65534


def result(episode: int) -> EpisodeResult:
    return EpisodeResult(episode, episode / 3, 10 * episode, episode % 2 == 0, 0.25)


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    monkeypatch.setattr("experiment_runner.store.store.time", lambda: 5.0)
    with Store.create(tmp_path / "run", PLAN.expand(), FILES) as store:
        yield store


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that everyone can read and only its owner can write to."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@contextlib.contextmanager
def without_write_permission(folder: Path) -> Iterator[None]:
    """Give up write permission. Permissions do not restrict root, so root becomes the user nobody."""
    if os.geteuid() == 0:
        os.seteuid(NOBODY)
        try:
            yield
        finally:
            os.seteuid(0)
    else:
        folder.chmod(0o555)
        try:
            yield
        finally:
            folder.chmod(0o755)


def start(program: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a Python program without coverage, which could not write its data if file sizes are limited."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_")}
    pipes: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(command, **pipes, text=True, env=environment)


def test_reader_sees_each_episode_as_soon_as_it_is_recorded(store: Store) -> None:
    with Results.open(store.directory) as results:
        for episode in range(1, 50):
            store.record(FIRST, result(episode))
            assert results.measure(FIRST, "return")[-1] == episode / 3


def test_an_unknown_value_of_a_measure_repeats_any_other() -> None:
    known, unknown = EpisodeResult(1, 2.0, 7, True, 0.1), EpisodeResult(1, math.nan, 7, True, 0.3)
    assert known.repeats(unknown)
    assert unknown.repeats(unknown)
    assert not known.repeats(EpisodeResult(1, 3.0, 7, True, 0.1))
    assert not unknown.repeats(EpisodeResult(1, math.nan, 8, True, 0.3))


def test_episode_out_of_turn_or_of_an_unknown_trial_is_refused(store: Store) -> None:
    store.record(FIRST, result(1))
    for episode in (0, 1, 3):
        with pytest.raises(ExperimentError, match=f"episode {episode} of {FIRST} .*where episode 2"):
            store.record(FIRST, result(episode))
    with pytest.raises(ExperimentError, match="has no trial sample/0"):
        store.record("sample/0", result(1))
    assert store.episodes(FIRST) == [result(1)]


def test_episode_and_its_checkpoint_are_recorded_together_or_not_at_all(store: Store) -> None:
    store.record(FIRST, result(1), Checkpoint(b"one"))
    with pytest.raises(ExperimentError, match=r"episode 2 of .* is not recorded"):
        store.record(FIRST, result(2), Checkpoint(object()))  # type: ignore[arg-type]
    assert store.episodes(FIRST) == [result(1)]
    store.record(FIRST, result(2), Checkpoint(b"two"))
    assert store.checkpoint(FIRST) == (2, Checkpoint(b"two"))


def test_voids_events_and_failures_read_back(store: Store) -> None:
    store.record(FIRST, result(1))
    store.record_void(FIRST, 2, "the agent was lost")
    store.record_void(FIRST, 2, "the agent was lost again")
    store.record_event("start", "glue-rl")
    store.record_event("rewind", "starts over", SECOND)
    store.record_failure(SECOND, "the environment raised ValueError")
    store.record_failure(THIRD, "it crashed")
    store.rewind(THIRD, 0)
    assert store.voids() == [
        Void(5.0, FIRST, 2, "the agent was lost"),
        Void(5.0, FIRST, 2, "the agent was lost again"),
    ]
    assert store.events() == [
        RunEvent(5.0, None, "start", "glue-rl"),
        RunEvent(5.0, SECOND, "rewind", "starts over"),
    ]
    first, second, third, _ = store.trials()
    assert (first.done, first.voids, first.failure) == (1, 2, None)
    assert (second.done, second.voids, second.failure) == (0, 0, "the environment raised ValueError")
    assert third.failure is None


operations = st.lists(
    st.one_of(
        st.tuples(st.just("record"), st.sampled_from([FIRST, THIRD]), st.booleans()),
        st.tuples(st.just("rewind"), st.sampled_from([FIRST, THIRD]), st.integers(0, 12)),
        st.tuples(st.just("reopen"), st.none(), st.none()),
    ),
    max_size=30,
)


@settings(max_examples=size(20, 200), deadline=None)
@given(operations)
def test_store_is_what_was_done_to_it(operations: list[tuple[str, str, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        store = Store.create(Path(folder) / "run", PLAN.expand(), FILES)
        episodes: dict[str, int] = {FIRST: 0, THIRD: 0}
        checkpoints: dict[str, int] = {}
        for operation, trial, value in operations:
            if operation == "record":
                episodes[trial] += 1
                if value:
                    checkpoints[trial] = episodes[trial]
                saved = Checkpoint(b"%d" % episodes[trial]) if value else None
                store.record(trial, result(episodes[trial]), saved)
            elif operation == "rewind":
                store.rewind(trial, value)
                episodes[trial] = min(episodes[trial], value)
                if checkpoints.get(trial, 0) > value:
                    del checkpoints[trial]
            else:
                store.close()
                store = Store.open(store.directory)
        assert store.checkpointed() == checkpoints
        for trial, done in episodes.items():
            assert store.episodes(trial) == [result(episode) for episode in range(1, done + 1)]
        for trial, episode in checkpoints.items():
            assert store.checkpoint(trial) == (episode, Checkpoint(b"%d" % episode))
        store.close()


# Directories that cannot hold a run, or hold none.


def test_directory_with_a_run_is_not_overwritten(store: Store) -> None:
    store.record(FIRST, result(1))
    store.close()
    with pytest.raises(ExperimentError, match="holds a run"):
        Store.create(store.directory, PLAN.expand(), FILES)
    with Results.open(store.directory) as results:
        assert results.episodes(FIRST) == [result(1)]


def test_file_is_not_a_run_directory(tmp_path: Path) -> None:
    path = tmp_path / "run"
    path.write_text("")
    with pytest.raises(ExperimentError, match=r"cannot make .*: File exists"):
        Store.create(path, PLAN.expand(), FILES)


@pytest.mark.parametrize("name", [PLAN_FILE, ABOUT_FILE, "thesis.tex", "lock", "results.sqlite"])
def test_file_of_the_user_is_never_replaced_nor_removed(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(ExperimentError, match=f"{name}|not a database"):
        Store.create(tmp_path, PLAN.expand(), FILES)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "mine"}


CREATE_AND_DIE = """
import os, signal, sys
from pathlib import Path
from experiment_runner.plan.plan import Plan
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.store import Store
def die(store):
    store.record("remote/remote/0", EpisodeResult(1, 1.0, 1, True, 0.1))
    os.kill(os.getpid(), signal.SIGKILL)
Store.create(Path(sys.argv[1]), Plan(episodes=1).expand(), {"plan.toml": "half a pl"}, fill=die)
"""


def test_killed_making_of_a_run_leaves_no_run_and_does_not_stand_in_the_way(tmp_path: Path) -> None:
    with start(CREATE_AND_DIE, tmp_path) as process:
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert sorted(path.name for path in tmp_path.iterdir()) == [UNFINISHED, "lock"]
    with pytest.raises(ExperimentError, match="holds no run"):
        Results.open(tmp_path)
    with Store.create(tmp_path, PLAN.expand(), FILES) as store:
        store.record(FIRST, result(1))
        assert [trial.done for trial in store.trials()] == [1, 0, 0, 0]
    assert (tmp_path / PLAN_FILE).read_text() == "the plan\n"
    assert not (tmp_path / UNFINISHED).exists()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_file_system_without_locks_takes_no_run_and_shows_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    with Store.create(tmp_path / "there", PLAN.expand(), FILES) as store:
        store.record(FIRST, result(1))

    def refuse(file: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(ExperimentError, match=r"no locks .*: use a directory on another file system"):
        Store.create(tmp_path / "new", PLAN.expand(), FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    with pytest.raises(ExperimentError, match="no locks"):
        Store.open(tmp_path / "there")
    with Results.open(tmp_path / "there") as results:
        assert len(results.episodes(FIRST)) == 1
    assert lock_holder(tmp_path / "there") is None


def test_name_that_is_not_text_makes_no_run(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="not UTF-8: rename that file"):
        Store.create(tmp_path / "run", PLAN.expand(), {PLAN_FILE: "\udcff"})
    assert list(tmp_path.iterdir()) == []


def test_file_that_is_no_lock_is_not_overwritten(store: Store, tmp_path: Path) -> None:
    store.close()
    (tmp_path / "precious").write_text("precious")
    (store.directory / "lock").unlink()
    (store.directory / "lock").hardlink_to(tmp_path / "precious")
    with pytest.raises(ExperimentError, match="a file lock that is no run's lock: remove it"):
        Store.open(store.directory)
    assert (tmp_path / "precious").read_text() == "precious"


def test_empty_lock_that_a_full_disk_left_does_not_stand_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "lock").touch()
    Store.create(tmp_path, PLAN.expand(), FILES).close()
    assert lock_holder(tmp_path) is None


@pytest.mark.parametrize("opener", [Results.open, Store.open])
def test_directory_without_a_run_is_refused(tmp_path: Path, opener: type[Results]) -> None:
    with pytest.raises(ExperimentError, match="holds no run"):
        opener(tmp_path)  # type: ignore[call-arg]
    assert list(tmp_path.iterdir()) == []


def test_database_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.sqlite"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE recipes (name TEXT)")
    with pytest.raises(ExperimentError, match="not written by glue-experiment"):
        Results.open(tmp_path)
    path.write_bytes(b"no database at all, but long enough to be one" * 100)
    with pytest.raises(ExperimentError, match="file is not a database"):
        Results.open(tmp_path)


# Versions of the tables.


def dump(directory: Path) -> list[str]:
    with contextlib.closing(sqlite3.connect(directory / "results.sqlite")) as connection:
        return list(connection.iterdump())


def test_run_of_version_1_opens_today(tmp_path: Path) -> None:
    text = (Path(__file__).parent / "run_version_1.sql").read_text()
    with contextlib.closing(sqlite3.connect(tmp_path / "results.sqlite")) as connection:
        connection.executescript(text)
    with Results.open(tmp_path) as results:
        assert [(r.spec.id, r.done, r.failure) for r in results.trials()] == [
            ("random/level_seed=121/mario/0", 2, None),
            ("remote/mario/1", 0, "it raised ValueError"),
        ]
        assert results.measure("random/level_seed=121/mario/0", "return").tolist() == [1.5, -10.25]
        assert np.isnan(results.measure("random/level_seed=121/mario/0", "late")).tolist() == [True, True]
        assert results.checkpoint("random/level_seed=121/mario/0") == (2, Checkpoint(b"\x01\x02", b""))
        assert [void.why for void in results.voids()] == ["the agent was lost"]
        assert [event.kind for event in results.events()] == ["start", *["joined"] * 4]
        assert results.players() == [
            OutsidePlayer(1000000001.0, "remote/mario/1", "agent", "Jumper", "Python 3.11"),
            OutsidePlayer(
                1000000002.0, "remote/mario/1", "agent", "My (old) agent joined", "RL-Glue C codec"
            ),
            OutsidePlayer(1000000003.0, "remote/mario/1", "environment", "mario", None),
        ]
        assert results.trial_names()["remote/mario/1"] == "My (old) agent joined/mario/1"
    with Store.open(tmp_path) as store:
        store.record("remote/mario/1", result(1))


@pytest.fixture
def next_version(monkeypatch: pytest.MonkeyPatch, store: Store) -> Store:
    """A closed run, to be read by a program whose database version is one higher."""
    store.record(FIRST, result(1))
    store.close()
    added = ("ALTER TABLE trials ADD COLUMN note TEXT NOT NULL DEFAULT 'none'",)
    monkeypatch.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, added))
    return store


def test_old_run_is_migrated_when_opened_for_writing(next_version: Store) -> None:
    before = dump(next_version.directory)
    with Store.open(next_version.directory) as store:
        store.record(FIRST, result(2))
        assert store.episodes(FIRST) == [result(1), result(2)]
    after = "\n".join(dump(next_version.directory))
    assert "note TEXT NOT NULL DEFAULT 'none'" in after
    assert "note" not in "\n".join(before)


def test_old_run_is_read_without_being_changed(next_version: Store) -> None:
    before = dump(next_version.directory)
    with Results.open(next_version.directory) as results:
        assert results.episodes(FIRST) == [result(1)]
    assert dump(next_version.directory) == before


def test_migration_that_fails_leaves_the_run_as_it_was(
    next_version: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = dump(next_version.directory)
    broken = (*schema.MIGRATIONS, ("DELETE FROM episodes", "DROP TABLE absent"))
    monkeypatch.setattr(schema, "MIGRATIONS", broken)
    with pytest.raises(ExperimentError, match="no such table: absent"):
        Store.open(next_version.directory)
    assert dump(next_version.directory) == before


def test_run_of_a_newer_release_is_refused(next_version: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    Store.open(next_version.directory).close()
    monkeypatch.undo()
    known = len(schema.MIGRATIONS)
    for opener in (Results.open, Store.open):
        with pytest.raises(ExperimentError, match=rf"version {known + 1}\b.* up to {known}: .*newer release"):
            opener(next_version.directory)


# One writer.


def test_second_writer_is_refused_by_name(store: Store) -> None:
    holder = f"in use by process {os.getpid()} on "
    with pytest.raises(ExperimentError, match=holder):
        Store.open(store.directory)
    with pytest.raises(ExperimentError, match=holder):
        Store.create(store.directory, PLAN.expand(), FILES)
    assert f"process {os.getpid()} on" in (lock_holder(store.directory) or "")
    store.record(FIRST, result(1))


HOLD = """
import os, subprocess, sys
from pathlib import Path
from experiment_runner.store.store import Store
store = Store.open(Path(sys.argv[1]))
if sys.argv[2] == "forked":
    child = os.fork()
    if child == 0:
        sys.stdin.read()
else:
    child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=sys.stdin).pid
print(child, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("child_is", ["started", "forked"])
def test_killed_writer_lets_go_though_its_child_lives_on(store: Store, child_is: str) -> None:
    store.close()
    with start(HOLD, store.directory, child_is) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        with pytest.raises(ExperimentError, match=f"in use by process {process.pid} on"):
            Store.open(store.directory)
        process.kill()
        process.wait()
        os.kill(child, 0)  # the process exists
        Store.open(store.directory).close()


WRITE = """
import sys
from pathlib import Path
from experiment_runner.store.records import Checkpoint, EpisodeResult
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
store = Store.open(Path(sys.argv[1]))
trial = sys.argv[2]
done = len(store.episodes(trial))
try:
    for episode in range(done + 1, done + 100_000):
        result = EpisodeResult(episode, episode / 3, 10 * episode, episode % 2 == 0, 0.25)
        checkpoint = Checkpoint(b"%d" % episode, bytes(2000)) if episode % 7 == 0 else None
        store.record(trial, result, checkpoint)
        print(episode, flush=True)
except ExperimentError as error:
    print(error, file=sys.stderr)
    sys.exit(3)
"""


@pytest.mark.stage("kills")
def test_killed_writer_loses_no_episode_that_it_reported(store: Store) -> None:
    store.close()
    chance = np.random.default_rng(4)
    for _ in range(10):
        lines = int(chance.integers(1, 300))
        with start(WRITE, store.directory, FIRST) as process:
            assert process.stdout is not None
            for _ in range(lines):
                process.stdout.readline()
            os.kill(process.pid, signal.SIGKILL)
            rest = process.stdout.read().split()
        with Results.open(store.directory) as results:
            episodes = results.episodes(FIRST)
            assert episodes == [result(episode) for episode in range(1, len(episodes) + 1)]
            assert len(episodes) >= lines
            if rest:
                assert len(episodes) - int(rest[-1]) in (0, 1)  # recorded, perhaps not yet reported
            last = len(episodes) - len(episodes) % 7
            assert results.checkpoint(FIRST) == (
                (last, Checkpoint(b"%d" % last, bytes(2000))) if last else None
            )
        with contextlib.closing(sqlite3.connect(store.directory / "results.sqlite")) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


COPY = """
import os, sys
import urllib.parse  # which Python 3.13 imports later, when it may not read its own modules any more
from pathlib import Path
from experiment_runner.store.results import Results
if os.geteuid() == 0:
    os.seteuid(65534)
with Results.open(Path(sys.argv[1])) as results:
    print(len(results.episodes(sys.argv[2])))
"""


def test_killed_run_without_its_shm_file_is_read_on_a_read_only_medium(
    store: Store, open_folder: Path
) -> None:
    store.close()
    with start(WRITE, store.directory, FIRST) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.kill()
    medium = open_folder / "run"
    medium.mkdir()
    for name in ("results.sqlite", "results.sqlite-wal"):
        shutil.copyfile(store.directory / name, medium / name)
        (medium / name).chmod(0o444)
    medium.chmod(0o555)
    with start(COPY, medium, FIRST) as process:
        read, errors = process.communicate()
    assert errors == ""
    with Results.open(store.directory) as results:
        assert int(read) == len(results.episodes(FIRST)) > 0
    assert sorted(path.name for path in medium.iterdir()) == ["results.sqlite", "results.sqlite-wal"]


# A disk that is full, and one that cannot be written to.

LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))"


def test_file_that_may_not_grow_stops_the_run_cleanly(store: Store) -> None:
    """A limit on file sizes makes SQLite's writes fail like a full disk, and needs no privileges."""
    store.close()
    with start(f"{LIMITED}\n{WRITE}", store.directory, FIRST) as process:
        reported, message = process.communicate()
    assert process.returncode == 3, message
    last = int(reported.split()[-1])
    assert f"episode {last + 1} of {FIRST} is not recorded: disk I/O error; the episodes before" in message
    assert message.strip().endswith(f"resume the run in {store.directory}")
    with Store.open(store.directory) as again:
        assert again.episodes(FIRST) == [result(episode) for episode in range(1, last + 1)]
        again.record(FIRST, result(last + 1))


def test_full_disk_stops_the_run_cleanly(store: Store) -> None:
    """SQLite fails in the same way if its file may have no more pages."""
    (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
    store._connection.execute(f"PRAGMA max_page_count = {pages}")

    def fill() -> None:
        for episode in range(1, 10_000):
            store.record(FIRST, result(episode))

    with pytest.raises(ExperimentError, match="the disk is full; the episodes before it are") as full:
        fill()
    done = store.done(FIRST)
    assert f"episode {done + 1} of {FIRST} is not recorded: " in str(full.value)
    with Results.open(store.directory) as results:
        assert results.episodes(FIRST) == [result(episode) for episode in range(1, done + 1)]


def test_nothing_is_left_of_a_run_that_could_not_be_created(tmp_path: Path) -> None:
    program = f"""{LIMITED.replace("150_000", "6_000")}
import sys
from pathlib import Path
from experiment_runner.plan.plan import Plan
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
try:
    Store.create(Path(sys.argv[1]), Plan(episodes=1, trials=100).expand(), {{"plan.toml": "the plan"}})
except ExperimentError as error:
    print(error)
"""
    with start(program, tmp_path / "run") as process:
        message, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    assert message.startswith(f"cannot make {tmp_path / 'run'}: ")
    assert list(tmp_path.iterdir()) == []


def test_read_only_directory_is_refused(open_folder: Path) -> None:
    with (
        without_write_permission(open_folder),
        pytest.raises(ExperimentError, match=r"cannot make .*: Permission"),
    ):
        Store.create(open_folder / "run", PLAN.expand(), FILES)
    assert list(open_folder.iterdir()) == []


@pytest.mark.parametrize("under_way", [True, False])
def test_run_in_a_read_only_directory_is_read_but_not_written(open_folder: Path, under_way: bool) -> None:
    directory = open_folder / "run"
    store = Store.create(directory, PLAN.expand(), FILES)
    store.record(FIRST, result(1))
    if not under_way:
        store.close()
    with without_write_permission(directory):
        with Results.open(directory) as results:
            assert results.episodes(FIRST) == [result(1)]
        with pytest.raises(ExperimentError, match=r"cannot write .*lock: Permission denied|in use"):
            Store.open(directory)
    store.close()


def test_episodes_recorded_together_are_all_recorded_or_none(store: Store) -> None:
    right, wrong = (EpisodeResult(number, 1.0, 2, True, 0.5) for number in (1, 3))
    with pytest.raises(ExperimentError, match=r"episode 3 .* where episode 2 was expected"):
        store.record_all([(FIRST, right, None, (), ()), (FIRST, wrong, None, (), ())])
    assert store.episodes(FIRST) == []
    assert store.done(FIRST) == 0
    second = right._replace(episode=2)
    store.record_all(
        [(FIRST, right, None, (), ()), (FIRST, second, Checkpoint(b"agent", b"environment"), (), ())]
    )
    assert store.episodes(FIRST) == [right, second]
    assert store.checkpoint(FIRST) == (2, Checkpoint(b"agent", b"environment"))

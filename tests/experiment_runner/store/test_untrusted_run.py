"""A run directory may come from anyone: reading it always ends, with its results or with one clear error."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.overview import as_object, as_text, overview
from experiment_runner.store.layout import ABOUT_FILE, PLAN_FILE, read_about
from experiment_runner.store.merge import merge
from experiment_runner.store.records import Checkpoint, EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import load_run
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from tests.proof import size

PLAN = Plan(
    episodes=30,
    trials=2,
    environments=(RoleSweep("mario", {"level_seed": 121}),),
    agents=(RoleSweep("sarsa", {"step_size": 0.5}),),
)
MUTATIONS = size(40, 1000)


@pytest.fixture(scope="module")
def _sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("sound") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiment_runner.store.store.time", lambda: 1e9)
        with open_run(made, PLAN) as store:
            for spec in PLAN.expand():
                for episode in range(1, 21):
                    store.record(spec.id, EpisodeResult(episode, 1.5, 9, True, 0.1), Checkpoint(b"saved"))
                store.record_void(spec.id, 21, "the agent was lost")
            store.record_failure(PLAN.expand()[1].id, "it broke")
    return made


@pytest.fixture
def run(_sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(_sound, tmp_path / "run"))


def read_all(run: Path) -> None:
    """Read everything that `glue-results` and `load_run` read."""
    with Results.open(run) as results:
        overview(results)
        as_text([results])
        as_object(results)
        for trial in results.trials():
            results.checkpoint(trial.spec.id)
            results.totals(trial.spec.id, 10)
        results.checkpointed()
    load_run(run)


def change(run: Path, *statements: str) -> None:
    with contextlib.closing(sqlite3.connect(run / "results.sqlite", isolation_level=None)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        for statement in statements:
            connection.execute(statement)


ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"


@pytest.mark.parametrize(
    ("statements", "what"),
    [
        (
            ("DROP TABLE episodes", f"CREATE VIEW episodes AS {ENDLESS} SELECT x FROM c"),
            "'episodes'",
        ),
        (("CREATE TRIGGER t AFTER INSERT ON episodes BEGIN DELETE FROM trials; END",), "trigger 't'"),
        (("CREATE TABLE more (x)",), "'more'"),
        (("DROP TABLE voids",), "'voids'"),
    ],
)
def test_database_with_other_tables_is_refused(run: Path, statements: tuple[str, ...], what: str) -> None:
    change(run, *statements)
    for opener in (Results.open, Store.open):
        with pytest.raises(ExperimentError, match=what):
            opener(run)


@pytest.mark.parametrize(
    ("statement", "what"),
    [
        ("UPDATE trials SET agent = '{'", "agent or environment of sarsa"),
        ("UPDATE trials SET agent = '[]'", "agent or environment of sarsa"),
        ('UPDATE trials SET agent = \'{"name": 1, "options": {}, "label": ""}\'', "of sarsa"),
        ("UPDATE trials SET agent = replace(hex(zeroblob(50000)), '00', '[')", "of sarsa"),
        ("UPDATE trials SET id = CAST(x'ff' AS TEXT) WHERE key = 1", "UTF-8"),
        ("UPDATE trials SET episodes = -1", "int` >= 0"),
        ("UPDATE trials SET max_steps = 'many'", "str"),
        ("UPDATE episodes SET episode_return = 'much'", "str"),
        ("UPDATE episodes SET steps = x'00'", "bytes|float"),
        ("DELETE FROM episodes WHERE episode = 3", "missing|checkpoint"),
        ("UPDATE checkpoints SET episode = 1000", "1000"),
        ("UPDATE checkpoints SET agent = 'text'", "str"),
        ("UPDATE events SET time = 1e300", "float` <= 2"),
        ("UPDATE voids SET time = -1", "float` >= 0"),
        ("UPDATE events SET time = 'today'", "str"),
    ],
)
def test_value_that_no_run_holds_is_one_clear_error(run: Path, statement: str, what: str) -> None:
    change(run, statement)
    with pytest.raises(ExperimentError, match=f"cannot read {run}: .*({what})"):
        read_all(run)


@pytest.mark.proof
def test_changed_bytes_give_numbers_or_one_clear_error(run: Path) -> None:
    rng = np.random.default_rng(10)
    path = run / "results.sqlite"
    sound = path.read_bytes()
    refused, messages = 0, set()
    for _ in range(MUTATIONS):
        damaged = bytearray(sound)
        for _ in range(rng.integers(1, 4)):
            begin, length = int(rng.integers(len(sound))), int(rng.integers(1, 17))
            damaged[begin : begin + length] = rng.bytes(len(damaged[begin : begin + length]))
        path.write_bytes(damaged)
        try:
            read_all(run)
        except ExperimentError as error:
            refused += 1
            messages.add(str(error).partition(":")[0])
    assert 0 < refused < MUTATIONS
    assert messages == {f"cannot read {run}"}


def test_query_that_does_not_end_is_stopped(run: Path) -> None:
    """An endless query, which a b-tree page that refers to itself can cause."""
    with Results.open(run) as results, pytest.raises(ExperimentError, match="does not end"):
        results._query(f"{ENDLESS} SELECT count(*) FROM c")


INTERRUPTED = f"""
import sys
from pathlib import Path
from experiment_runner.store import database
from experiment_runner.store.results import Results
database._INSTRUCTIONS_AT_LEAST = 10**15
with Results.open(Path(sys.argv[1])) as results:
    print("reading", flush=True)
    results._query("{ENDLESS} SELECT count(*) FROM c")
"""


def test_ctrl_c_ends_a_query(run: Path) -> None:
    command = [sys.executable, "-c", INTERRUPTED, str(run)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.kill(process.pid, signal.SIGINT)
        _, errors = process.communicate()
    assert errors.strip().endswith("KeyboardInterrupt")


def test_a_long_text_that_many_rows_refer_to_is_not_repeated_without_end(run: Path) -> None:
    rows = "WITH RECURSIVE c(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM c WHERE i < 1000)"
    change(
        run,
        "UPDATE trials SET id = printf('%.*c', 100000, 'x') WHERE key = 1",
        f"INSERT INTO voids {rows} SELECT 1.0, 1, 1, '' FROM c",
    )
    with Results.open(run) as results, pytest.raises(ExperimentError, match="repeated too often"):
        results.voids()


def test_merge_takes_damaged_texts_as_they_are(run: Path, tmp_path: Path) -> None:
    (run / PLAN_FILE).write_bytes(b"\xff\xfe")
    (run / ABOUT_FILE).write_text("[" * 100_000)
    with Results.open(run) as results:
        merge([results], tmp_path / "merged")
    with Results.open(tmp_path / "merged") as merged:
        assert [trial.done for trial in merged.trials()] == [20, 20]


@pytest.mark.parametrize("number", ["NaN", "1e999"])
def test_merge_of_a_number_that_json_lacks_can_be_read(run: Path, tmp_path: Path, number: str) -> None:
    (run / ABOUT_FILE).write_text(f'{{"load": {number}}}')
    with Results.open(run) as results:
        merge([results], tmp_path / "merged")
    assert read_about(tmp_path / "merged") == {"merged": {str(run): f'{{"load": {number}}}'}}


def test_merge_that_fails_keeps_a_directory_that_was_there(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    (out / PLAN_FILE).write_text("episodes = 3  # my plan\n")
    with Results.open(run) as results, pytest.raises(ExperimentError, match=f"holds {PLAN_FILE}"):
        merge([results], out)
    assert (out / PLAN_FILE).read_text() == "episodes = 3  # my plan\n"
    change(run, "UPDATE checkpoints SET agent = 'text'")
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new"):
        with Results.open(run) as results, pytest.raises(ExperimentError, match="damaged"):
            merge([results], tmp_path / name)
    assert list((tmp_path / "empty").iterdir()) == []
    assert not (tmp_path / "new").exists()

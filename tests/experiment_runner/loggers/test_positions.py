"""Errors if results cannot be sent, and the points that are sent."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import pytest

from experiment_runner.loggers import LOGGERS
from experiment_runner.loggers.stream import Logger, Point, Source, _Position, _send, points_of, stream
from experiment_runner.store.layout import DirectoryTaken, RunLock, remove_run
from experiment_runner.store.results import Results
from glue.errors import ConfigError, ExperimentError
from tests.system.runs import run as execute


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of one trial whose agent has metrics; not to be changed."""
    folder = tmp_path_factory.mktemp("done")
    ended = execute("--env", "mines", "--agent", "sarsa", "--episodes", 9, "--out", "run", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    return folder / "run"


@pytest.fixture
def run(done: Path, tmp_path: Path) -> Path:
    """A copy of the run, to be changed."""
    return Path(shutil.copytree(done, tmp_path / "run"))


@pytest.mark.parametrize("name", LOGGERS)
def test_logger_that_is_not_installed_is_named(name: str, run: Path) -> None:
    if find_spec(name) is not None:
        pytest.skip(f"{name} is installed")
    with pytest.raises(ConfigError, match=rf"{name} is not installed: pip install 'glue-rl\[{name}\]'"):
        stream(run, name, "mine")


def test_directory_without_a_run_stays_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError):
        stream(tmp_path, "tensorboard", "mine")
    assert not list(tmp_path.iterdir())


def test_two_do_not_send_a_run_to_one_logger(run: Path) -> None:
    folder = run / "streams/wandb"
    folder.mkdir(parents=True)
    lock = RunLock(folder)
    with pytest.raises(DirectoryTaken, match="streams/wandb is in use by process"):
        stream(run, "wandb", "mine")
    lock.release()


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[" * 100_000,
        "[1]",
        '{"mine": 1}',
        '{"mine": {"stream": 1, "began": 1.0, "episodes": {}}}',
        '{"mine": {"stream": "a", "began": 1.0, "episodes": {"sarsa/mines/0": "x"}}}',
    ],
)
def test_damaged_position_is_named(text: str, run: Path) -> None:
    file = run / "streams/mlflow/positions.json"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    with pytest.raises(ExperimentError, match=r"positions\.json: it is damaged; remove it"):
        stream(run, "mlflow", "mine")


def test_what_was_sent_is_removed_with_the_run(run: Path) -> None:
    (run / "streams/tensorboard").mkdir(parents=True)
    assert remove_run(run) == []
    assert not run.exists()


def test_points_of_later_episodes_are_those_of_all(run: Path) -> None:
    with Results.open(run) as results:
        (trial,) = results.trials()
        points = points_of(results, trial.spec.id, 0, 1000.0)
        later = points_of(results, trial.spec.id, 4, 1000.0)
    assert [point.episode for point in points] == list(range(1, 10))
    assert later == points[4:]
    assert points[0].time > 1000.0
    assert sum(point.values["episode/steps"] for point in points) == points[-1].step


class Written(Logger):
    """Notes the episodes of each call, and whether it was the last of its trial."""

    def __init__(self) -> None:
        self.calls: list[tuple[list[int], bool]] = []

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        self.calls.append(([point.episode for point in points], finished))
        return True

    def close(self) -> None:
        pass


def test_the_last_episode_ends_its_trial_also_if_it_is_recorded_meanwhile(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written, sent = Written(), _Position("a", 1000.0, {})
    with Results.open(run) as results:
        (trial,) = results.trials()
        for before in (trial._replace(done=6), trial):
            monkeypatch.setattr(results, "trials", lambda seen=before: [seen])
            assert list(_send(results, written, sent, sent.episodes)) == [trial.spec.id]
    assert written.calls == [([1, 2, 3, 4, 5, 6], False), ([7, 8, 9], True)]


@pytest.mark.parametrize(
    ("name", "accepted"),
    [
        ("agent/mean TD error", "agent/mean TD error"),
        ("agent/loss (clip)", "agent/loss _clip_"),
        ("agent//x/../y", "agent/_/x/_/y"),
    ],
)
def test_a_metric_has_a_name_that_mlflow_accepts(name: str, accepted: str) -> None:
    validation = pytest.importorskip("mlflow.utils.validation")
    from experiment_runner.loggers.mlflow import _accepted

    assert _accepted(name) == accepted
    validation._validate_metric_name(accepted)

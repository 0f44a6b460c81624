"""Datasets made from recordings, read by the libraries that they are for, and compared step by step."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from glue.gym.spaces import Codec
from glue.trajectory import ActionWriter, Ending, Episode, Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation
from tests import forked
from tests.env_server.replay.test_replay import GOLDEN

pytestmark = pytest.mark.stage("docs")

parquet = pytest.importorskip("pyarrow.parquet")
minari = pytest.importorskip("minari")
spaces = pytest.importorskip("gymnasium").spaces

SPEC: Final = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
    "OBSERVATIONS INTS (0 9) ACTIONS INTS (0 3) REWARDS (0 1)"
)
UNSTATED: Final = "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 ACTIONS INTS (0 3) REWARDS (0 1)"


@pytest.fixture(autouse=True)
def _own_datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))


def replay(*arguments: object) -> str:
    """Run glue-replay; return its standard error."""
    done = forked.run("glue-replay", *map(str, arguments), cwd=Path(), timeout=120)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.stdout == ""
    return done.stderr


def recorded(path: Path, *options: object) -> list[Episode]:
    """Record an experiment; return the episodes that count."""
    command = ["--in-process", "--seed", "5", "--out", str(path.with_suffix("")), "--record", str(path)]
    done = forked.run("glue-experiment", *map(str, options), *command, cwd=path.parent, timeout=120)
    assert done.returncode == 0, done.stderr
    return list(TrajectoryReader(path))


def numbers(kind: str, value: Any) -> Any:
    return np.frombuffer(value.chars, np.uint8) if kind == "chars" else getattr(value, kind)


def observations(episode: Episode) -> Iterator[Observation]:
    assert episode.start is not None
    yield episode.start
    for step in episode.steps:
        assert step.observation is not None
        yield step.observation


def ends(episode: Episode) -> list[tuple[bool, bool]]:
    last = (episode.ending is Ending.TERMINAL, episode.ending is Ending.CUTOFF)
    return [*[(False, False)] * (len(episode.steps) - 1), last]


GAMES: Final = {
    "stated": ("--env", "mines", "--agent", "sarsa", "--episodes", 20, "--max-steps", 40),
    "a tuple": ("--env", "gymnasium:Blackjack-v1", "--agent", "random", "--episodes", 20),
    "doubles": ("--env", "gymnasium:CartPole-v1", "--agent", "random", "--episodes", 5, "--max-steps", 15),
}


@pytest.mark.parametrize("game", GAMES)
def test_minari_reads_back_each_value_of_the_spaces(game: str, tmp_path: Path) -> None:
    episodes = recorded(tmp_path / "a.traj", *GAMES[game])
    count = len(episodes)
    assert replay(tmp_path / "a.traj", "--minari", "games/one-v3") == (
        f"wrote the dataset games/one-v3: {count} episodes\n"
    )
    dataset = minari.load_dataset("games/one-v3")
    assert dataset.total_episodes == count
    assert dataset.total_steps == sum(len(episode.steps) for episode in episodes)
    seen, acted = Codec(dataset.observation_space), Codec(dataset.action_space)
    for found, episode in zip(dataset, episodes, strict=True):
        for at, observation in enumerate(observations(episode)):
            ints, doubles, chars = seen.pack(at_step(found.observations, at))
            assert Observation(ints, doubles, chars) == observation
        for at, step in enumerate(episode.steps):
            assert Action(*acted.pack(at_step(found.actions, at))) == step.action
        assert found.rewards.tolist() == [step.reward for step in episode.steps]
        flags = zip(found.terminations.tolist(), found.truncations.tolist(), strict=True)
        assert list(flags) == ends(episode)


def at_step(values: Any, at: int) -> Any:
    """Return the value of one step of a Minari episode."""
    if isinstance(values, dict):
        return {name: at_step(part, at) for name, part in values.items()}
    if isinstance(values, tuple):
        return tuple(at_step(part, at) for part in values)
    return values[at]


def test_counts_that_are_not_stated_are_padded(tmp_path: Path) -> None:
    game = ("--env", "mario", "--agent", "sample", "--episodes", 2, "--max-steps", 60)
    episodes = recorded(tmp_path / "a.traj", *game)
    replay(tmp_path / "a.traj", "--minari", "mario-v0")
    dataset = minari.load_dataset("mario-v0")
    counts = {value.counts for episode in episodes for value in observations(episode)}
    assert len(counts) > 1
    for found, episode in zip(dataset, episodes, strict=True):
        for at, value in enumerate(observations(episode)):
            here = at_step(found.observations, at)
            assert tuple(here["counts"]) == value.counts
            for kind, count in zip(("ints", "doubles", "chars"), value.counts, strict=True):
                assert np.array_equal(here[kind][:count], numbers(kind, value))
                assert not here[kind][count:].any()


@pytest.mark.slow
def test_parquet_has_each_step_and_each_run(tmp_path: Path) -> None:
    game = ("--env", "mario", "--agent", "sample", "--episodes", 2, "--max-steps", 60)
    episodes = recorded(tmp_path / "a.traj", *game) + recorded(tmp_path / "b.traj", *GAMES["stated"])
    out = tmp_path / "a.parquet"
    assert replay(tmp_path / "a.traj", tmp_path / "b.traj", "--parquet", out) == f"wrote {out}: 22 episodes\n"
    table = parquet.read_table(out)
    rows = iter(table.to_pylist())
    for number, episode in enumerate(episodes):
        steps = [*episode.steps, None]
        flags = [*ends(episode), (None, None)]
        moments = zip(observations(episode), steps, flags, strict=True)
        for at, (observation, step, flag) in enumerate(moments):
            row = next(rows)
            assert (row["run"], row["episode"], row["step"]) == (int(number >= 2), number, at)
            assert values_of(row, "observation") == observation
            assert (row["terminal"], row["truncated"]) == flag
            assert row["reward"] == (step and step.reward)
            if step is None:
                assert [row[f"action_{kind}"] for kind in ("ints", "doubles", "chars")] == [None] * 3
            else:
                assert values_of(row, "action") == step.action
    assert next(rows, None) is None
    runs = json.loads(parquet.read_metadata(out).metadata[b"runs"])
    assert [run["environment"] for run in runs] == ["mario", "mines"]
    assert [run["task_spec"] for run in runs] == [episodes[0].run.task_spec, episodes[-1].run.task_spec]


def values_of(row: dict[str, Any], what: str) -> Observation | Action:
    made = Observation if what == "observation" else Action
    return made(row[f"{what}_ints"], row[f"{what}_doubles"], row[f"{what}_chars"])


def write(path: Path, spec: str = SPEC, number: int = 1) -> Path:
    """Write a void episode, one of two steps and one without steps."""
    with TrajectoryWriter(path) as recording:
        recording.run(Run("corridor", {}, spec))
        for ending in (recording.void, recording.cutoff):
            recording.start(Observation([0]))
            recording.step(Action([1]), 0.5, Observation([number]), False)
            recording.step(Action([2]), 0.25, Observation([2]), False)
            ending()
        recording.start(Observation([0]))
        recording.cutoff()
    return path


def test_only_episodes_that_count_and_have_steps_are_kept(tmp_path: Path) -> None:
    said = replay(write(tmp_path / "a"), "--minari", "a-v0", "--parquet", tmp_path / "table")
    assert said.count(": 1 episode\n") == 2
    (episode,) = minari.load_dataset("a-v0")
    assert episode.observations.tolist() == [0, 1, 2]
    assert episode.truncations.tolist() == [False, True]
    assert parquet.read_table(tmp_path / "table").column("step").to_pylist() == [0, 1, 2]


def actions_only(path: Path) -> Path:
    with path.open("wb") as file:
        writer = ActionWriter(file.write)
        writer.run(Run("corridor", {}, SPEC))
        writer.start()
        writer.step(Action([1]).body, 1.0)
        writer.end(Ending.TERMINAL)
        writer.close()
    return path


@pytest.mark.parametrize("form", ["minari", "parquet"])
def test_what_no_dataset_can_hold_is_said_and_nothing_is_left(form: str, tmp_path: Path) -> None:
    out = tmp_path / "out" if form == "parquet" else "mine/out-v0"
    empty = tmp_path / "empty"
    with TrajectoryWriter(empty) as recording:
        recording.run(Run("corridor", {}, SPEC))
    for file, message in (
        (actions_only(tmp_path / "actions"), "actions holds actions only, and a dataset needs observations"),
        (GOLDEN / "variants.jsonl.gz", "recordings of the original Mario cannot be datasets"),
        (empty, "empty: no episode that counts"),
        (tmp_path / "none", "none"),
    ):
        assert message in replay(file, f"--{form}", out)
    assert not list(tmp_path.glob("*out*"))
    assert minari.list_local_datasets() == {}
    assert "leave out the other options" in replay(write(tmp_path / "a"), f"--{form}", out, "--check")


def test_table_that_fails_leaves_the_old_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.write_text("old")
    torn = tmp_path / "torn"
    torn.write_bytes(write(tmp_path / "a").read_bytes()[:-20] + b"x" * 20)
    assert replay(torn, "--parquet", out).startswith("Error: ")
    assert out.read_text() == "old"
    assert sorted(path.name for path in tmp_path.glob("*out*")) == ["out"]
    assert "cannot write" in replay(tmp_path / "a", "--parquet", tmp_path / "no/folder")


def test_minari_s_conditions_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = write(tmp_path / "good")
    assert "like mines/sarsa-v0, with a version at its end, not mines" in replay(good, "--minari", "mines")
    assert "not ../../a-v0" in replay(good, "--minari", "../../a-v0")
    assert replay(good, "--minari", "a-v0").endswith(": 1 episode\n")
    assert "there is a dataset a-v0 already" in replay(good, "--minari", "a-v0")
    other = write(tmp_path / "other", SPEC.replace("9", "8"))
    assert "different task specs: make a dataset of each" in replay(good, other, "--minari", "b-v0")
    assert "cannot be read" in replay(write(tmp_path / "bad", SPEC[:60]), "--minari", "b-v0")
    assert "is not in Discrete(10)" in replay(write(tmp_path / "far", number=10), "--minari", "b-v0")
    assert [*minari.list_local_datasets()] == ["a-v0"]
    monkeypatch.setenv("MINARI_DATASETS_PATH", "/proc/nowhere")
    assert "Error: cannot write the dataset b-v0: " in replay(good, "--minari", "b-v0")


def test_one_large_observation_does_not_make_all_as_large(tmp_path: Path) -> None:
    with TrajectoryWriter(tmp_path / "a") as recording:
        recording.run(Run("any", {}, UNSTATED))
        recording.start(Observation(chars=bytes(2**20)))
        for _ in range(1024):
            recording.step(Action([1]), 0.0, Observation(), False)
        recording.cutoff()
    assert "write Parquet instead" in replay(tmp_path / "a", "--minari", "a-v0")
    assert replay(tmp_path / "a", "--parquet", tmp_path / "out").endswith(": 1 episode\n")

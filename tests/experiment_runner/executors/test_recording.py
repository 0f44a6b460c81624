"""Recordings of experiments: their contents, which replay."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Any, Final

import pytest
from click.testing import CliRunner, Result

from agents.baselines import RandomAgent
from agents.tabular import SarsaAgent
from env_server.replay.episodes import build_environment, open_recording, recorded_moments, replayed_moments
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from experiment_runner.cli.experiment import experiment
from experiment_runner.executors.job import BEGINNING, Start
from experiment_runner.executors.recording import Meter, Recorder, recorded
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.results import Results
from glue import Action, ConfigError, Experiment, Observation, Pace, local, serve_environment
from glue.trajectory import Ending, Episode, TrajectoryError, TrajectoryReader, TrajectoryWriter
from glue.wire.messages import Kind
from tests.experiment_runner.executors.test_trial import Forgetful, Kept, Lossy, mines, play
from tests.system.runs import contents, start, wait_until

COMMAND: Final = ("--env", "mines", "--agent", "random", "--max-steps", "9", "--in-process")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(experiment, list(map(str, arguments)), standalone_mode=False)


def episodes(path: Path) -> list[Episode]:
    return list(TrajectoryReader(path))


def counting(path: Path) -> list[Episode]:
    """Compare all episodes of a recording with the environment; return those that count."""
    found = episodes(path)
    moments = list(replayed_moments(open_recording(path), build_environment))
    assert len(moments) == sum(1 + len(episode.steps) for episode in found)
    return [episode for episode in found if episode.ending is not Ending.VOID]


def numbers(found: list[Episode]) -> list[tuple[float, int, bool]]:
    """Return the return, steps and end of each episode, as in the results of an experiment."""
    steps = [1 + sum(not step.terminal for step in episode.steps) for episode in found]
    return [(e.episode_return, n, e.ending is Ending.TERMINAL) for e, n in zip(found, steps, strict=True)]


def in_results(directory: Path) -> list[tuple[float, int, bool]]:
    with Results.open(directory) as results:
        [trial] = results.trials()
        return [(e.episode_return, e.steps, e.terminal) for e in results.episodes(trial.spec.id)]


@pytest.mark.parametrize(
    ("name", "agent", "max_steps", "how"),
    [("mines", "sarsa", 30, ("--in-process",)), ("skeleton", "skeleton", 80, ())],  # limits that cut off some
)
def test_recorded_run_has_the_usual_results_and_replays(
    name: str, agent: str, max_steps: int, how: tuple[str, ...]
) -> None:
    command = ("--env", name, "--agent", agent, "--episodes", "6", "--max-steps", max_steps, "--seed", "3")
    assert invoke(*command, "--in-process", "--out", "usual").return_value == 0
    assert invoke(*command, *how, "--out", "run", "--record", "run.traj").return_value == 0
    assert contents(Path("run")) == contents(Path("usual"))
    found = counting(Path("run.traj"))
    assert numbers(found) == in_results(Path("run"))
    assert {episode.ending for episode in found} == {Ending.CUTOFF, Ending.TERMINAL}
    [run] = {id(episode.run): episode.run for episode in found}.values()
    assert (run.environment, dict(run.options), run.state) == (name, {}, b"")


def test_environment_that_joins_from_outside_is_recorded_without_a_name() -> None:
    url = "ipc://hub"
    outside = threading.Thread(target=serve_environment, args=(mines(), url))
    outside.start()
    command = ("--agent", "sarsa", "--episodes", "5", "--bind", url, "--record", "run.traj")
    assert invoke(*command, "--out", "run").return_value == 0
    outside.join()
    found = episodes(Path("run.traj"))
    assert numbers(found) == in_results(Path("run"))
    assert {episode.run.environment for episode in found} == {""}
    moments = list(replayed_moments(open_recording(Path("run.traj")), lambda run: mines()))
    assert len(moments) == sum(1 + len(episode.steps) for episode in found)


# Losses and continuations


def played(kept: Kept) -> list[tuple[float, int, bool]]:
    return [(result.episode_return, result.steps, result.terminal) for result in kept.results]


def run_recorded(path: str, glue: Experiment, start: Start = BEGINNING) -> Kept:
    with recorded(Path(path)) as recording:
        return play(glue, 10, start=start, recording=recording)


def contents_of(found: list[Episode]) -> list[tuple[Any, ...]]:
    return [(episode.start, episode.steps, episode.ending) for episode in found]


@pytest.mark.parametrize(
    ("losses", "runs", "states"),
    [
        ({Kind.RL_STEP: {2}}, 2, [False]),  # the very first episode
        ({Kind.RL_STEP: {40}}, 2, [True]),  # before the first checkpoint
        ({Kind.RL_STEP: {150}}, 2, [True]),
        ({Kind.RL_STEP: {100, 200, 230}}, 4, [True] * 3),
        ({Kind.RL_START: {12}}, 2, [True]),  # right after a checkpoint
    ],
)
def test_episodes_that_count_are_recorded_once_each_whatever_is_lost(
    losses: dict[Kind, set[int]], runs: int, states: list[bool]
) -> None:
    whole = run_recorded("whole.traj", local(SarsaAgent(), mines()))
    kept = run_recorded("run.traj", Lossy(losses, SarsaAgent, mines()))
    assert played(kept) == played(whole)
    found = counting(Path("run.traj"))
    assert contents_of(found) == contents_of(counting(Path("whole.traj")))
    assert numbers(found) == played(kept)
    begun = list({id(e.run): e.run for e in episodes(Path("run.traj"))}.values())
    assert len(begun) == runs
    assert [bool(run.state) for run in begun[1:]] == states
    voids = [e for e in episodes(Path("run.traj")) if e.ending is Ending.VOID]
    assert (
        len(voids)
        == len(losses.get(Kind.RL_STEP, ()))
        == len(kept.voids) - len(losses.get(Kind.RL_START, ()))
    )


def test_environment_continues_in_the_recording_when_an_agent_is_replaced() -> None:
    kept = run_recorded("run.traj", Lossy({Kind.RL_STEP: {100}, Kind.RL_START: {20}}, Forgetful, mines()))
    assert numbers(counting(Path("run.traj"))) == played(kept)
    assert len(kept.voids) == 2


class Unsaved(MinesEnvironment):
    """Cannot be saved."""

    env_save = env_load = None  # type: ignore[assignment]


def test_recording_of_an_environment_that_cannot_be_saved_has_no_state_after_a_loss() -> None:
    kept = run_recorded("run.traj", Lossy({Kind.RL_STEP: {100}}, SarsaAgent, Unsaved()))
    found = episodes(Path("run.traj"))
    assert [episode.ending for episode in found].count(Ending.VOID) == 1
    assert numbers([e for e in found if e.ending is not Ending.VOID]) == played(kept)
    assert {episode.run.state for episode in found} == {b""}


def test_trial_that_continues_is_recorded_from_its_checkpoint() -> None:
    whole = run_recorded("whole.traj", local(SarsaAgent(), mines()))
    start = Start(10, whole.checkpoints[10])
    kept = run_recorded("rest.traj", local(SarsaAgent(), mines()), start)
    rest = counting(Path("rest.traj"))
    assert contents_of(rest) == contents_of(episodes(Path("whole.traj"))[10:])
    assert numbers(rest) == played(kept)
    assert rest[0].run.state == whole.checkpoints[10].environment


@pytest.mark.stage("kills")
def test_killed_recording_holds_every_episode_of_the_results_and_the_rest_goes_to_another(
    tmp_path: Path,
) -> None:
    arguments = ("--env", "mines", "--agent", "sarsa", "--episodes", "1500", "--in-process", "--out", "run")
    begun = start(*arguments, "--checkpoint-every", "20", "--record", "a.traj", cwd=tmp_path)
    wait_until(lambda: Path("run/plan.toml").exists() and len(done()) > 50, "fifty episodes")
    begun.send_signal(signal.SIGKILL)
    begun.communicate()
    before = done()
    assert len(before) < 1500
    first = numbers(counting(Path("a.traj")))
    assert first[: len(before)] == before
    again = invoke(*arguments, "--record", "a.traj")
    assert isinstance(again.exception, TrajectoryError)
    assert "a.traj exists already" in str(again.exception)
    assert invoke("--resume", "run", "--in-process", "--record", "b.traj").return_value == 0
    second = numbers(counting(Path("b.traj")))
    assert second == in_results(Path("run"))[-len(second) :]
    assert 1500 - len(before) <= len(second) < 1500 - len(before) + 20


def done() -> list[tuple[float, int, bool]]:
    """Return the episodes in the results so far."""
    try:
        return in_results(Path("run"))
    except Exception:
        return []


# Experiments that cannot be recorded


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        (("--trials", "2"), ConfigError, "a single trial, and the plan has 2"),
        (("--workers", "2"), ConfigError, "leave out --workers"),
        (("--engine", "ray"), ConfigError, "leave out --workers and --engine"),
        (("--record", "nowhere/a.traj"), TrajectoryError, "cannot write nowhere/a.traj: No such file"),
        (("--record", "old.traj"), TrajectoryError, "old.traj exists already"),
    ],
)
def test_what_cannot_be_recorded_is_said_before_anything_is_made(
    arguments: tuple[str, ...], kind: type[Exception], message: str
) -> None:
    Path("old.traj").write_text("an older one")
    result = invoke(*COMMAND, "--episodes", "3", "--record", "new.traj", *arguments)
    assert isinstance(result.exception, kind)
    assert message in str(result.exception)
    assert [path.name for path in Path.cwd().iterdir()] == ["old.traj"]
    assert Path("old.traj").read_text() == "an older one"


def test_run_that_cannot_begin_or_is_finished_leaves_no_recording() -> None:
    assert invoke(*COMMAND, "--episodes", "3", "--out", "run").return_value == 0
    other = invoke(*COMMAND, "--episodes", "2", "--out", "run", "--record", "new.traj")
    assert "is the run of another plan" in str(other.exception)
    finished = invoke("--resume", "run", "--in-process", "--record", "new.traj")
    assert finished.return_value == 0
    assert "new.traj was not written" in finished.stderr
    assert not Path("new.traj").exists()


class Thinker(RandomAgent):
    """An agent whose time goes by as it says."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.seconds = [0.0, 2.5, 0.5, 1.5]  # of its first answers

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.now += self.seconds.pop(0) if self.seconds else 0.0
        return super().agent_step(reward, observation)


def test_recording_says_which_steps_were_late_and_replays(tmp_path: Path) -> None:
    agent = Thinker()
    glue = local(agent, SkeletonEnvironment(), pace=Pace(rate=1.0), clock=lambda: agent.now)
    with TrajectoryWriter(tmp_path / "late.traj") as writer:
        spec = TrialSpec(
            TrialId("random/skeleton/0"), RoleSpec("random"), RoleSpec("skeleton"), 1, 10, seed=3
        )
        recorder = Recorder(writer, spec, glue, Meter(glue, None))
        recorder.begin(glue.rl_init(spec.seed), continued=False)
        recorder.rl_episode(max_steps=10)

    (episode,) = counting(tmp_path / "late.traj")
    # The answer to step 2 comes when step 4 has been made, that to step 5 after step 6.
    assert list(episode.late) == [3, 4, 6]
    shown = [moment.place for moment in recorded_moments(open_recording(tmp_path / "late.traj"))]
    assert shown[2:5] == ["episode 1, step 2", "episode 1, step 3, late", "episode 1, step 4, late"]

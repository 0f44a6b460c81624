from __future__ import annotations

import asyncio
import math
import re
import threading
from collections.abc import Set

import pytest

from agents.baselines import RandomAgent
from env_server.toys import MinesEnvironment
from experiment_runner.executors import job
from experiment_runner.executors.trial import run_job, watched
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult
from glue import Action, ExperimentError, Observation, Step, local
from glue.wire.messages import Role

RESULT = EpisodeResult(7, -1.25, 2**40, False, 0.5)
SENT: list[job.Report] = [
    job.Recorded(RESULT, None),
    job.Recorded(EpisodeResult(8, math.inf, 1, True, 0.0), Checkpoint(b"\0agent", b"")),
    job.Recorded(RESULT, None, (Answer("values", "ä\n"), Answer("", ""))),
    job.Voided(9, "the agent was lost"),
    job.Happened("lost", "why ☂"),
    job.Playing(9, 12),
    job.Playing(9, None),
    job.Line("a line"),
    job.Ended(None),
    job.Ended("a mistake"),
    job.Lost("killed"),
]


def test_reports_arrive_as_they_were_sent_however_the_stream_is_cut() -> None:
    stream, received = job.unpacker(), list[job.Report]()
    for byte in b"".join(map(job.encode, SENT)):
        stream.feed(bytes([byte]))
        received += (job.decode(value, job.REPORTS) for value in stream)
    assert received == SENT


def test_job_arrives_as_it_was_sent() -> None:
    agent = RoleSpec("sarsa", {"step_size": 0.1, "episodes": 2**63 - 1, "greedy": True, "file": "ä"}, "mine")
    spec = TrialSpec(TrialId("mine/mines/0"), agent, RoleSpec("mines"), 12, 30, 2**63 - 1)
    config = job.RunConfig(job.Placement(job.BOTH, any_reward=True), 4, questions=("values", ""))
    whole = job.Job(spec, config, job.Start(5, Checkpoint(b"a", b"e")))
    assert [job.decode(value, {"Job": job.Job}) for value in job.unpack(job.encode(whole))] == [whole]


class Unshowable(Exception):
    def __str__(self) -> str:
        raise AttributeError("no text")


RAISED = "^agent Failing raised in agent_step: "
FAILURES = {
    "cancelled": (asyncio.CancelledError("mine"), f"{RAISED}CancelledError: mine"),
    "a closed generator": (GeneratorExit("mine"), f"{RAISED}GeneratorExit: mine"),
    "a surrogate": (ValueError("a path \udcff"), r"ValueError: a path \?"),
    "no text": (Unshowable(), r"Unshowable: \(its text cannot be shown\)"),
    "ten megabytes": (ValueError("x" * 10_000_000), r"ValueError: x+\.\.\. \([\d,]+ characters\)"),
    "an exit": (SystemExit("mine"), "SystemExit: mine"),
}


class Failing(RandomAgent):
    def __init__(self, *, how: str = "") -> None:
        super().__init__()
        self._how = how

    def agent_step(self, reward: float, observation: Observation) -> Action:
        raise FAILURES[self._how][0]


@pytest.mark.parametrize(
    ("failure", "inside"), [*((failure, job.BOTH) for failure in FAILURES), ("cancelled", {Role.AGENT})]
)
def test_whatever_a_player_raises_ends_its_trial_with_a_text_that_can_be_stored(
    failure: str, inside: Set[Role], capsys: pytest.CaptureFixture[str]
) -> None:
    reports: list[job.Report] = []
    agent = RoleSpec(f"{__file__}:Failing", {"how": failure})
    spec = TrialSpec(TrialId("a/b/0"), agent, RoleSpec("mines"), 1, 30, 0)
    run_job(job.Job(spec, job.RunConfig(job.Placement(frozenset(inside)))), reports.append)
    ended = reports[-1]
    assert isinstance(ended, job.Ended)
    assert re.search(FAILURES[failure][1], ended.failure or ""), ended.failure
    assert [job.decode(value, job.REPORTS) for value in job.unpack(job.encode(ended))] == [ended]
    assert len(capsys.readouterr().err) < 100_000


def test_episode_that_does_not_end_is_reported_with_its_steps() -> None:
    told = threading.Event()

    class Endless(MinesEnvironment):
        def env_step(self, action: Action) -> Step:
            assert told.wait(60)
            return Step(0.0, Observation([0]), True)

    reports: list[job.Report] = []

    def send(report: job.Report) -> None:
        reports.append(report)
        told.set()

    glue = local(RandomAgent(), Endless())
    with watched(glue, lambda: 4, send, seconds=0.001):
        glue.rl_init()
        glue.rl_episode()
    assert set(reports) == {job.Playing(5, 1)}


@pytest.mark.parametrize("value", [None, 7, [], ["Recorded"], ["Recorded", 1, 2], ["__class__", 1], [[], 1]])
def test_what_is_no_report_is_refused(value: object) -> None:
    with pytest.raises(ExperimentError, match="Recorded"):
        job.decode(value, job.REPORTS)

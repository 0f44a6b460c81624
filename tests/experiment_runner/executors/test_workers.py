from __future__ import annotations

from experiment_runner.executors.job import (
    BOTH,
    REPORTS,
    Ended,
    Job,
    Line,
    Lost,
    Placement,
    Recorded,
    Report,
    RunConfig,
    decode,
    encode,
    unpack,
)
from experiment_runner.executors.workers import LocalExecutor, _run, _trial
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec


def test_worker_that_is_stopped_ends_an_episode_and_reports_a_checkpoint_after_it() -> None:
    spec = TrialSpec(
        TrialId("sarsa/mines/0"), RoleSpec("sarsa"), RoleSpec("mines"), 10**6, max_steps=20, seed=1
    )
    reports: list[Report] = []
    stopped = False
    with LocalExecutor(1) as executor:
        executor.start(Job(spec, RunConfig(Placement(BOTH), grace=60)))
        while not (reports and isinstance(reports[-1], Lost)):
            reports += [report for _, report in executor.receive(60)]
            if reports and not stopped:
                stopped = True
                executor.stop()
    last = reports[-2]
    assert isinstance(last, Recorded)
    assert last.checkpoint is not None
    assert last.result.episode == len(reports) - 1


def test_job_that_a_node_of_a_cluster_cannot_read_ends_with_the_reason() -> None:
    (batch,) = _run(encode(Line("of another version")), _trial)
    (report,) = (decode(value, REPORTS) for value in unpack(batch))
    assert isinstance(report, Ended)
    assert "expected Job" in (report.failure or "")

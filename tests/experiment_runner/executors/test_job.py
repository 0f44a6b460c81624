from __future__ import annotations

import math

import pytest

from experiment_runner.asking import Answer
from experiment_runner.executors.job import (
    Ended,
    Happened,
    Job,
    Lost,
    Recorded,
    Report,
    Said,
    Voided,
    decode_job,
    decode_report,
    encode_job,
    encode_report,
    unpack,
    unpacker,
)
from experiment_runner.executors.trial import Start
from experiment_runner.plan import RoleSpec, TrialSpec
from experiment_runner.players import Meeting
from experiment_runner.store.records import Checkpoint, EpisodeResult
from glue.errors import ExperimentError

RESULT = EpisodeResult(7, -1.25, 2**40, False, 0.5)
REPORTS: list[Report] = [
    Recorded(RESULT, None),
    Recorded(EpisodeResult(8, math.inf, 1, True, 0.0), Checkpoint(b"\0agent", b"")),
    Recorded(RESULT, None, (Answer("values", "ä\n"), Answer("", ""))),
    Voided(9, "the agent was lost"),
    Happened("lost", "why ☂"),
    Said("a line"),
    Ended(None),
    Ended("a mistake"),
    Lost("killed"),
]


def test_reports_arrive_as_they_were_sent_however_the_stream_is_cut() -> None:
    stream, received = unpacker(), list[Report]()
    for byte in b"".join(map(encode_report, REPORTS)):
        stream.feed(bytes([byte]))
        received += map(decode_report, stream)
    assert received == REPORTS


def test_job_arrives_as_it_was_sent() -> None:
    agent = RoleSpec("sarsa", {"step_size": 0.1, "episodes": 2**70, "greedy": True, "file": "ä"}, "mine")
    spec = TrialSpec("mine/mines/0", agent, RoleSpec("mines"), 12, 30, 2**63 - 1)
    job = Job(spec, Meeting(True, any_reward=True), Start(5, Checkpoint(b"a", b"e")), 4, ("values", ""))
    assert list(map(decode_job, unpack(encode_job(job)))) == [job]


@pytest.mark.parametrize("value", [None, 7, [], ["Recorded"], ["Recorded", 1, 2], ["__class__", 1], [[], 1]])
def test_what_is_no_report_is_refused(value: object) -> None:
    with pytest.raises(ExperimentError, match="not a report"):
        decode_report(value)

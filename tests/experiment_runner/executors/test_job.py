from __future__ import annotations

import math

import pytest

from experiment_runner.executors.job import (
    REPORTS,
    Ended,
    Happened,
    Job,
    Lost,
    Recorded,
    Report,
    Said,
    Voided,
    decode,
    decode_job,
    encode,
    unpack,
    unpacker,
)
from experiment_runner.executors.trial import Start
from experiment_runner.meeting.players import BOTH, Meeting
from experiment_runner.plan.ids import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult
from glue.errors import ExperimentError

RESULT = EpisodeResult(7, -1.25, 2**40, False, 0.5)
SENT: list[Report] = [
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
    for byte in b"".join(map(encode, SENT)):
        stream.feed(bytes([byte]))
        received += (decode(value, REPORTS) for value in stream)
    assert received == SENT


def test_job_arrives_as_it_was_sent() -> None:
    agent = RoleSpec("sarsa", {"step_size": 0.1, "episodes": 2**63 - 1, "greedy": True, "file": "ä"}, "mine")
    spec = TrialSpec(TrialId("mine/mines/0"), agent, RoleSpec("mines"), 12, 30, 2**63 - 1)
    job = Job(spec, Meeting(BOTH, any_reward=True), Start(5, Checkpoint(b"a", b"e")), 4, ("values", ""))
    assert list(map(decode_job, unpack(encode(job)))) == [job]


@pytest.mark.parametrize("value", [None, 7, [], ["Recorded"], ["Recorded", 1, 2], ["__class__", 1], [[], 1]])
def test_what_is_no_report_is_refused(value: object) -> None:
    with pytest.raises(ExperimentError, match="Recorded"):
        decode(value, REPORTS)

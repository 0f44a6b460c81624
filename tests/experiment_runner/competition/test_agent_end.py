"""A competition of agents that fail in agent_end, from its file to its board: they forfeit like any other."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from experiment_runner.competition.records.record import record_path
from experiment_runner.store.results import Results
from glue.trajectory import Ending, TrajectoryReader
from tests import forked

pytestmark = pytest.mark.slow

FAILURES = {
    "exits": ("os._exit(8)", "status 8"),
    "raises": ("raise ValueError('at the end')", "at the end"),
    "sleeps": ("time.sleep(1000)", "bank of 1 s is empty"),
    "babbles": ("babble(); time.sleep(1000)", ""),  # it breaks the protocol, so the hub breaks its connection
}

AGENT = """\
import os, time
from contextlib import suppress
from glue import Action, serve_agent

class Failing:
    ends = 0
    def agent_start(self, observation): return Action(ints=[1])
    def agent_step(self, reward, observation): return Action(ints=[1])
    def agent_end(self, reward):
        self.ends += 1
        if self.ends == 2: {failure}

def babble():
    for descriptor in range(3, 100):
        with suppress(OSError): os.write(descriptor, b"garbage" * 100)

serve_agent(Failing(), os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])
"""


def test_they_forfeit_and_their_competition_is_verified(tmp_path: Path) -> None:
    file = (
        'name = "ends"\ntrials = 1\nseed_env = "SECRET"\n[limits]\nstep_seconds = 0.5\nbank_seconds = 1.0\n'
    )
    file += '[tasks.walk]\nenv = "skeleton"\nepisodes = 4\n'
    for name, (failure, _) in {"walks": ("pass", ""), **FAILURES}.items():
        (tmp_path / f"{name}.py").write_text(AGENT.format(failure=failure))
        file += f'[entrants.{name}]\ncommand = ["{sys.executable}", "{name}.py"]\n'
    (tmp_path / "ends.toml").write_text(file)

    def compete(*arguments: str) -> str:
        environment = {**os.environ, "SECRET": "xyzzy"}
        done = forked.run("glue-compete", *arguments, cwd=tmp_path, env=environment, timeout=200)
        assert done.returncode == 0, done.stderr
        return done.stdout

    compete("run", "ends.toml", "--out", "run", "--workers", "2")
    compete("verify", "run")
    shown = json.loads(compete("board", "run", "--format", "json"))
    entrants = {entrant["name"]: entrant for entrant in shown["entrants"]}
    assert entrants["walks"]["forfeits"] == []
    assert None not in {entrant["place"] for entrant in entrants.values()}
    with Results.open(tmp_path / "run") as results:
        for name, (_, why) in FAILURES.items():
            [forfeit] = entrants[name]["forfeits"]
            assert why in forfeit["reason"]
            # The episode was played to its end: it is in the record and in the results.
            trial_id = f"{name}/walk/0"
            record = TrajectoryReader(record_path(tmp_path / "run", trial_id))
            assert [episode.ending for episode in record] == [Ending.TERMINAL] * 2
            assert len(results.episodes(trial_id)) == 2

"""A season in a directory, whose attempts are played in this process, by agents that repeat their actions."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from typing import Final

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.environment import RecordedEnvironment
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records.journal import ENROL, OVER, REQUEST, START, Act, act
from experiment_runner.competition.records.record import RecordFile, record_path
from experiment_runner.competition.records.replay import made_for
from experiment_runner.competition.records.seal import add_trials, record_acts, record_outcome, record_verdict
from experiment_runner.competition.records.verify import judge
from experiment_runner.competition.settings import parse_competition
from experiment_runner.competition.trials import attempt_trials, levels
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import TrialEnd
from glue.closing import Closing
from glue.trajectory import ActionWriter, Ending
from glue.types import Action

BEGAN: Final = datetime(2026, 11, 2, 9, tzinfo=UTC)

SECRET: Final = b"only a test"

FILE: Final = """\
name = "<b>spring</b>"
trials = 2
seed_env = "SECRET"
[season]
opens = 2026-11-01T00:00:00
closes = 2026-12-01T00:00:00
enrol = "open"
names = "{names}"
parallel = 2
[tasks]
mines = {{ env = "mines", options.random_start = true, episodes = 2, max_steps = 30, phase = "proving" }}
[tasks.deep]
env = "mines"
options = {{ random_start = true }}
episodes = 1
max_steps = 20
phase = "proving"
hidden = true
"""


class Held(Closing):
    """A season that is under way.

    Args:
        directory: of it.
        names: see `Season`.
    """

    def __init__(self, directory: Path, names: str = "pseudonyms") -> None:
        self.directory = directory
        self.now = BEGAN
        text = FILE.format(names=names)
        competition = parse_competition(text, directory.parent / "spring.toml")
        self._levels = levels(competition, SECRET)
        self._store = open_competition(directory, text, competition, SECRET)

    def close(self) -> None:
        """Release the directory."""
        self._store.close()

    @property
    def course(self) -> Course:
        return course_of(self.directory)

    def act(self, kind: str, subject: str, reason: str = "", **more: object) -> Act:
        """Carry out an act, a minute after the one before."""
        self.now += timedelta(minutes=1)
        made = act(kind, subject, reason, now=self.now, **more)
        record_acts(self._store, [made])
        return made

    def enrol(self, name: str, alias: str) -> str:
        """Admit an entrant; return its token."""
        token = f"the token of {name}"
        digest = sha256(token.encode()).hexdigest()
        self.act(ENROL, name, player=f"{name}.pub", id=f"key of {name}", alias=alias, token=digest)
        return token

    def play(self, name: str, number: int, actions: Sequence[int], forfeit: str | None = None) -> None:
        """Let an entrant play an attempt by repeating actions, and verify it.

        Args:
            name: of the entrant.
            number: of the attempt.
            actions: of each step in turn.
            forfeit: why it forfeits its last trial after a few steps; None if it does not.
        """
        self.act(REQUEST, name, number=number)
        start = self.act(START, name, number=number, player=f"{name}.pub", id=f"key of {name}")
        specs = attempt_trials(self._levels, self.course.competition.trials, start)
        add_trials(self._store, specs)
        for spec in specs:
            reason = forfeit if spec is specs[-1] else None
            outcome = TrialEnd(reason, self._played(spec, actions, reason is not None))
            record_outcome(self._store, spec.id, outcome)
            record_verdict(self._store, spec.id, judge(self._store, spec, outcome, 0))
        self.act(OVER, name, forfeit or "", number=number)

    def _played(self, spec: TrialSpec, actions: Sequence[int], leaves: bool) -> bytes:
        """Play and record a trial; return the digest of the record."""
        with RecordFile(record_path(self.directory, spec.id)) as file:
            writer = ActionWriter(file.append)
            environment = RecordedEnvironment(
                made_for(spec), writer, spec, lambda result: self._store.record(spec.id, result)
            )
            environment.env_init()
            for _ in range(spec.episodes):
                environment.env_start()
                for step in range(spec.max_steps):
                    if environment.env_step(Action(ints=[actions[step % len(actions)]])).terminal:
                        break
                    if leaves and step == 3:
                        break
                environment.end(Ending.VOID if leaves else Ending.CUTOFF)
                if leaves:
                    break
            writer.close()
            return file.finish()

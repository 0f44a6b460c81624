"""Mistakes of the hub and of its clients that the simulator has to find: python -m tests.simulation.mutants.

Each is a change of one place in the source, tried on a copy of it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]

SEEDS: Final = 2000
"""Number of seeds within which each mutant has to be found."""


class Mutant(NamedTuple):
    """A change of the source."""

    mistake: str
    file: str
    before: str
    """Text that occurs in the file exactly once."""

    after: str


_SESSION: Final = "glue/hub/session.py"
_SESSIONS: Final = "glue/hub/sessions.py"
_OBSERVERS: Final = "glue/hub/observers.py"
_CONNECTION: Final = "glue/hub/io/connection.py"
_CHANNELS: Final = "glue/hub/io/channels.py"
_ANSWERS: Final = "glue/client/answers.py"
_EXPERIMENT: Final = "glue/client/experiment.py"
_LINK: Final = "glue/client/link.py"

MUTANTS: Final = (
    Mutant(
        "the hub drops its last reply too soon",
        _SESSION,
        "missed = self._reply if peer.role is Role.EXPERIMENT else self._outstanding",
        "missed = None if peer.role is Role.EXPERIMENT else self._outstanding",
    ),
    Mutant(
        "the hub does not repeat the outstanding call",
        _SESSION,
        "missed = self._reply if peer.role is Role.EXPERIMENT else self._outstanding",
        "missed = self._reply if peer.role is Role.EXPERIMENT else None",
    ),
    Mutant(
        "the hub begins a repeated request again (< instead of <=)",
        _SESSION,
        "if message.seq <= self._request_seq:",
        "if message.seq < self._request_seq:",
    ),
    Mutant(
        "the hub accepts an answer of any number",
        _SESSION,
        "if outstanding is None or seq != outstanding[2] or _CALLEES",
        "if outstanding is None or _CALLEES",
    ),
    Mutant(
        "a void episode is forgotten", "glue/engine/engine.py", "self._void = reason", "self._void = None"
    ),
    Mutant("a lost player voids nothing", _SESSION, "engine.void(reason)", "pass"),
    Mutant(
        "a WELCOME is trusted that may have been lost",
        _SESSIONS,
        "known = session.knows(role, instance)",
        "known = session.knows(role, instance) or current is not None",
    ),
    Mutant(
        "a role is given away whose holder is there",
        _SESSIONS,
        "if current.unreachable_since is None and self._reach(current):",
        "if False:",
    ),
    Mutant(
        "a peer is lost as soon as its connection breaks",
        _SESSIONS,
        "now - since >= self._config.timeout",
        "now >= since",
    ),
    Mutant(
        "a seat is not freed",
        _SESSIONS,
        "            self._unseat(current)\n",
        "",
    ),
    Mutant(
        "memory of a connection is not given back",
        _CHANNELS,
        "        self.switchboard.memory.hold(channel, 0)\n",
        "",
    ),
    Mutant(
        "the hub forgets what a crowded connection did not take",
        _CONNECTION,
        "            self._unsent += memoryview(data)[sent:]",
        "            return",
    ),
    Mutant(
        "a player drops the answer that it has to keep",
        _ANSWERS,
        "if message == self._last_call:",
        "if False:",
    ),
    Mutant(
        "a player keeps its numbers at another hub",
        _ANSWERS,
        "        self._last_seq = 0\n\n    def answer",
        "        pass\n\n    def answer",
    ),
    Mutant(
        "an experiment does not repeat its request",
        _EXPERIMENT,
        "                    link.send(request)\n                    unreceived += 1",
        "                    unreceived += 1",
    ),
    Mutant(
        "an experiment goes on at a hub that does not know it",
        _EXPERIMENT,
        "if not resumed and self._answered:",
        "if False:",
    ),
    Mutant(
        "a peer greets only over its first connection",
        _LINK,
        "if self._transport.connections != self._greeted:\n            self._greet()",
        "if not self._greeted:\n            self._greet()",
    ),
    Mutant(
        "a peer thinks it is welcome over every connection",
        _LINK,
        "        self._welcomed.clear()\n",
        "",
    ),
    Mutant(
        "the hub accepts an answer of the other role",
        _SESSION,
        "seq != outstanding[2] or _CALLEES[outstanding[0]] is not peer.role:",
        "seq != outstanding[2]:",
    ),
    Mutant(
        "a later message overtakes the steps that were joined",
        _CHANNELS,
        "        if kind not in STEPS:\n            self.send_joined()\n",
        "        if kind not in STEPS:\n",
    ),
    Mutant(
        "a large step overtakes the steps that were joined",
        _CHANNELS,
        "            self.send_joined()\n            connection.send(head)",
        "            connection.send(head)",
    ),
    Mutant(
        "a later message overtakes what a crowded connection did not take",
        _CONNECTION,
        "        if not self.unsent:\n            try:",
        "        if True:\n            try:",
    ),
    Mutant(
        "a loss during the last request is not repeated after a return",
        _SESSION,
        "            for role, label in self._lost.items():\n                self._notify(Event.LOST, role, label)\n",
        "",
    ),
    Mutant(
        "a loss since the last reply is not repeated after a return",
        _SESSION,
        "for role, label in self._lost_since_reply.items():",
        "for role, label in ():",
    ),
    Mutant(
        "moments that an observer misses are not counted",
        _OBSERVERS,
        "                view.number += 1\n            elif",
        "                pass\n            elif",
    ),
    Mutant("an observer is shown more than it wants", _OBSERVERS, "view.wanted -= 1", "pass"),
    Mutant("observers see no new episode", _OBSERVERS, "self._episode += 1", "pass"),
    Mutant(
        "observers see the next step's number",
        _OBSERVERS,
        "engine.num_steps, engine.total_reward",
        "engine.num_steps + 1, engine.total_reward",
    ),
    Mutant(
        "a truncated episode goes on",
        "glue/engine/engine.py",
        "            if terminal:\n                return (CUT_OFF,), None\n",
        "",
    ),
    Mutant(
        "a HELLO of a member lets it join again",
        _SESSIONS,
        "Sending more again would let it fill the hub's memory.\n                return None\n",
        "Sending more again would let it fill the hub's memory.\n                pass\n",
    ),
    Mutant(
        "a forgotten experiment leaves its engine",
        _SESSION,
        "        self._engine = Engine(Action().body)\n        self._outstanding = None\n        self._request_seq",
        "        self._outstanding = None\n        self._request_seq",
    ),
    Mutant(
        "the length of a step of another shape is remembered",
        "glue/wire/steps.py",
        "        self.end = end\n        # A number",
        "        self.end = end\n        self._size = end - at\n        # A number",
    ),
)


def first_seed(mutant: Mutant, seeds: int = SEEDS) -> tuple[int, str] | None:
    """Return the first seed that breaks a promise, and the promise; None if no seed does."""
    with TemporaryDirectory() as folder:
        for part in ("glue", "tests/simulation"):
            shutil.copytree(ROOT / part, Path(folder) / part, ignore=shutil.ignore_patterns("__pycache__"))
        changed = Path(folder) / mutant.file
        source = changed.read_text(encoding="utf-8")
        if source.count(mutant.before) != 1:
            raise ValueError(f"{mutant.mistake}: its text occurs {source.count(mutant.before)} times")
        changed.write_text(source.replace(mutant.before, mutant.after), encoding="utf-8")
        command = [sys.executable, "-m", "tests.simulation", "--seeds", str(seeds), "--stop"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    found = re.search(r"^seed (\d+): (.*)", done.stdout, re.MULTILINE)
    if found is None and done.returncode:
        raise ValueError(f"{mutant.mistake}: {done.stderr[-2000:]}")
    return None if found is None else (int(found[1]), found[2])


def main() -> None:
    """Print the table of docs/verification.md."""
    print("| mistake | seed | what is noticed |\n| --- | --- | --- |")
    for mutant in MUTANTS:
        found = first_seed(mutant)
        seed, noticed = ("none", "") if found is None else found
        print(f"| {mutant.mistake} | {seed} | {noticed:.100} |", flush=True)


if __name__ == "__main__":
    main()

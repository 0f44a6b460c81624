"""The faults of a simulated run: a list, drawn before the run begins.

Each fault happens at the n-th system call that sends something over the simulated network. So a fault hits
before, in and after every message, and a run can be repeated with some of its faults only."""

from __future__ import annotations

from random import Random
from typing import Final, NamedTuple


class Fault(NamedTuple):
    """One fault.

    Attributes:
        at: number of the system call of the network at which it happens.
        kind: name of the kind of fault.
        which: selects the target, and the position in the bytes.
        seconds: duration or delay.
    """

    at: int
    kind: str
    which: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.kind}@{self.at}/{self.which % 1000}/{self.seconds:.3f}s"


WEIGHTS: Final[dict[str, int]] = {
    "break": 30,
    "close": 8,
    "dribble": 8,
    "late": 8,
    "clog": 8,
    "silence": 3,
    "again": 6,
    "narrow": 4,
    "kill": 5,
    "twin": 2,
    "hub": 1,
    "experiment": 2,
    "jump": 2,
    "stop": 5,
    "stranger": 6,
    "observer": 2,
}
"""Relative frequencies of the kinds.

`break` and `close` end a connection in or after the bytes that are sent; `dribble` lets bytes arrive one by
one; `late` delays some, `clog` all in one direction and then the other, `silence` beyond every timeout;
`again` repeats sent bytes; `narrow` leaves room for few bytes; `kill` ends a player, which is started again
with its state or without, `twin` starts a second program of a role; `hub` and `experiment` restart these;
`jump` sets the clock ahead; `stop` takes the core from a program; `stranger` connects and misbehaves;
`observer` observes."""

QUIET: Final = frozenset({"hub", "experiment", "kill", "twin", "jump", "silence"})
"""Kinds that make episodes void; some runs have none of them, so that any void episode is an error."""

SENDS: Final = 20
"""Unit of a run's length, in system calls that send: faults last for 10 to 100 units at any density."""


def drawn(seed: int) -> list[Fault]:
    """Return the faults of a seed."""
    random = Random(seed * 2 + 1)
    kinds = dict(WEIGHTS)
    calm = random.random() < 0.35
    if calm:
        for kind in QUIET:
            del kinds[kind]
    # Some runs concentrate on few kinds.
    if random.random() < 0.4:
        chosen = random.sample(sorted(kinds), random.randint(1, 4))
        kinds = dict.fromkeys(chosen, 1)
    gap = random.choice((2, 3, 6, 20))
    names, weights = list(kinds), list(kinds.values())
    at, faults = random.randint(0, 3 * gap), []
    end = at + SENDS * random.randint(10, 100)
    while at < end:
        kind = random.choices(names, weights)[0]
        longest = 12.0 if kind == "silence" else 2.0 if calm else 6.0
        seconds = random.choice((0.001, 0.05, 0.5, longest)) * random.random()
        if kind == "silence":
            seconds += 3.0
        faults.append(Fault(at, kind, random.randrange(2**31), seconds))
        at += random.randint(0, 2 * gap)
    return faults

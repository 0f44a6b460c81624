"""Simulated runs keep every promise; the simulator is deterministic and finds known mistakes."""

from __future__ import annotations

import threading
from typing import Final

import pytest

from glue.system import chance, clock
from tests.proof import size
from tests.simulation.__main__ import many
from tests.simulation.faults import Fault
from tests.simulation.mutants import MUTANTS, ROOT, Mutant, first_seed
from tests.simulation.run import simulate

SITUATIONS: Final = (
    "experiment: forgotten by the hub",
    "fault: again",
    *(f"hub: ERROR {code}" for code in ("malformed", "not-asked", "peer-lost", "unknown-peer")),
    "hub: a late action",
    "hub: an action in time",
    *(f"hub: NOTICE {event}" for event in ("joined", "lost", "returned", "slow")),
    *(f"hub: REFUSE {code}" for code in ("full", "malformed", "no-session", "role-taken", "version")),
    *(f"hub: WELCOME {resumed}" for resumed in (False, True)),
    "hub: a player returned, a call outstanding",
    "hub: a player returned, no call outstanding",
    "hub: an experiment returned, a reply to repeat",
    "hub: an experiment returned, no reply to repeat",
    *(
        f"hub: lost an {role} {when}"
        for role in ("agent", "environment", "experiment")
        for when in ("between verbs", "in a verb", "in an episode")
    ),
    "log: it used",
    "observer: saw something",
    "player: answered again what it had kept",
    "player: repeated an answer",
    "player: the hub said goodbye",
    "void: a player was lost between two verbs",
    "void: a player was replaced while its connection was broken",
    "void: a player was unreachable for the timeout",
)
"""Situations of greeting, resumption, refusal, voiding and eviction that many seeds have to reach."""


@pytest.mark.proof
@pytest.mark.timeout(1800)
def test_every_promise_is_kept_and_every_situation_reached() -> None:
    total = many(0, size(10, 400), stop=False)

    assert not total.problems
    assert total.blocks > 40
    if size(False, True):
        faults = sum(number for name, number in total.reached.items() if name.startswith("fault: "))
        assert faults > 100_000
        assert [name for name in SITUATIONS if not total.reached[name]] == []


HALF_AN_EPISODE: Final = (
    *((24, "close", 0), (29, "break", 0), (29, "twin", 0), (39, "close", 0), (43, "twin", 0)),
    *((58, "break", 0), (95, "kill", 41)),
)


@pytest.mark.parametrize(
    ("seed", "faults"),
    [
        pytest.param(
            13557,
            [Fault(*fault, 0.0) for fault in HALF_AN_EPISODE],
            id="half an episode does not begin with a newcomer",
        ),
        pytest.param(26567, None, id="an experiment inside gets the loop though the clock jumps"),
        pytest.param(35634, None, id="a player that is refused in one session is lost in the others"),
        pytest.param(2973, None, id="a player that is told goodbye in one session is lost in the others"),
        pytest.param(2163, None, id="a late call of a session that is over is none of its successor"),
        pytest.param(3775, None, id="nothing arrives over a connection that has failed"),
    ],
)
def test_what_once_broke_a_promise_does_so_no_more(seed: int, faults: list[Fault] | None) -> None:
    assert simulate(seed, faults).problems == []


def test_a_seed_is_always_the_same_run() -> None:
    ended = threading.Event()

    def work() -> None:
        while not ended.is_set():
            clock.monotonic()
            chance.random_bytes(1)

    one = simulate(4, trace=True)
    thread = threading.Thread(target=work)  # as one that an earlier test has left
    thread.start()
    other = simulate(4, trace=True)
    ended.set()
    thread.join()
    assert one.trace == other.trace
    assert one.faults == other.faults


def test_every_mistake_can_be_made() -> None:
    counts = {
        mutant.mistake: (ROOT / mutant.file).read_text("utf-8").count(mutant.before) for mutant in MUTANTS
    }

    assert set(counts.values()) == {1}, counts


@pytest.mark.proof
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "mutant", MUTANTS[: size(2, len(MUTANTS))], ids=lambda mutant: mutant.mistake.replace(" ", "-")
)
def test_a_mistake_is_found(mutant: Mutant) -> None:
    assert first_seed(mutant) is not None

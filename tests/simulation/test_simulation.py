"""Simulated runs keep every promise; the simulator is deterministic and finds known mistakes."""

from __future__ import annotations

from typing import Final

import pytest

from tests.proof import size
from tests.simulation.__main__ import many
from tests.simulation.diagram import diagram
from tests.simulation.faults import Fault, drawn
from tests.simulation.mutants import MUTANTS, ROOT, Mutant, first_seed
from tests.simulation.run import simulate
from tests.simulation.shrinking import needed

SITUATIONS: Final = (
    "experiment: forgotten by the hub",
    "fault: again",
    "hub: ERROR malformed",
    "hub: ERROR not-asked",
    "hub: ERROR peer-lost",
    "hub: ERROR unknown-peer",
    "hub: NOTICE joined",
    "hub: NOTICE lost",
    "hub: NOTICE returned",
    "hub: NOTICE slow",
    "hub: REFUSE full",
    "hub: REFUSE malformed",
    "hub: REFUSE no-session",
    "hub: REFUSE role-taken",
    "hub: REFUSE version",
    "hub: WELCOME False",
    "hub: WELCOME True",
    "hub: a player returned, a call outstanding",
    "hub: a player returned, no call outstanding",
    "hub: an experiment returned, a reply to repeat",
    "hub: an experiment returned, no reply to repeat",
    "hub: lost an agent between verbs",
    "hub: lost an agent in a verb",
    "hub: lost an agent in an episode",
    "hub: lost an environment between verbs",
    "hub: lost an environment in a verb",
    "hub: lost an environment in an episode",
    "hub: lost an experiment between verbs",
    "hub: lost an experiment in a verb",
    "hub: lost an experiment in an episode",
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
    total, failed, _ = many(0, size(10, 400), stop=False)

    assert not failed, total.problems
    assert total.blocks > 40
    if size(False, True):
        faults = sum(number for name, number in total.reached.items() if name.startswith("fault: "))
        assert faults > 100_000
        assert [name for name in SITUATIONS if not total.reached[name]] == []


def faults_at(*faults: tuple[int, str, int]) -> list[Fault]:
    return [Fault(at, kind, which, 0.0) for at, kind, which in faults]


def test_half_an_episode_does_not_begin_with_a_newcomer() -> None:
    faults = faults_at(
        *((24, "close", 0), (29, "break", 0), (29, "twin", 0), (39, "close", 0), (43, "twin", 0)),
        *((58, "break", 0), (95, "kill", 41)),
    )

    assert simulate(13557, faults).problems == []


def test_an_experiment_inside_gets_the_loop_though_the_clock_jumps() -> None:
    assert simulate(26567).problems == []


def test_a_player_that_is_refused_in_one_session_is_lost_in_the_others() -> None:
    assert simulate(35634).problems == []


def test_a_seed_is_always_the_same_run() -> None:
    one, other = simulate(4, trace=True), simulate(4, trace=True)

    assert one.trace == other.trace
    assert one.faults == other.faults


def test_seeds_differ() -> None:
    assert drawn(1) != drawn(2)


def test_the_faults_that_matter_are_those_that_remain() -> None:
    faults = [Fault(at, "break", 0, 0.0) for at in range(40)]

    def fails(tried: list[Fault]) -> bool:
        return {3, 17} <= {fault.at for fault in tried}

    assert [fault.at for fault in needed(faults, fails)] == [3, 17]


def test_the_diagram_shows_faults_and_messages() -> None:
    lines = list(diagram(simulate(4, trace=True).trace))

    assert any("***" in line for line in lines)
    assert any("HELLO" in line for line in lines)


def test_every_mistake_can_be_made() -> None:
    counts = {
        mutant.mistake: (ROOT / mutant.file).read_text("utf-8").count(mutant.before) for mutant in MUTANTS
    }

    assert set(counts.values()) == {1}, counts


@pytest.mark.proof
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "mutant", MUTANTS[: size(3, len(MUTANTS))], ids=lambda mutant: mutant.mistake.replace(" ", "-")
)
def test_a_mistake_is_found(mutant: Mutant) -> None:
    assert first_seed(mutant) is not None

"""Judge a client: one rule after the other, each by its scene; or by scripts of faults, which are episodes in
which the connection breaks at random, as drawn from a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from glue.conform.clients import common_rules, experiment_rules, player_rules
from glue.conform.clients.connection import Connection, Gone, Listener
from glue.conform.clients.experiment_harness import ExperimentHarness
from glue.conform.clients.harness import BEAT, QUIET, Exchange, Harness, PlayerHarness
from glue.conform.clients.process import Start
from glue.conform.rules import Broken, NotJudged, Outcome, Rule, Tier, Verdict
from glue.system import clock
from glue.wire import zmtp
from glue.wire.messages import Role

_EPISODES: Final = 2
_MOST_PIECES: Final = 12
_LONGEST: Final = 0.05
"""Maximum time between two pieces of a message, and before a break, in seconds."""

_LONGEST_ABSENCE: Final = 0.3
"""Maximum time without a hub, in seconds."""

Fault = Callable[[Harness, np.random.Generator, Exchange], None]
"""A function that carries out an exchange in spite of a fault."""


def play_script(kit: Harness, seed: int) -> None:
    """Carry out episodes, with faults in most exchanges.

    Args:
        kit: the harness of a client that is idle.
        seed: seed of the choices; the same seed chooses the same faults.

    Raises:
        Broken: an answer was not as expected; the message lists the faults until then.
    """
    rng = np.random.default_rng(seed)
    known = [fault for fault in _FAULTS if kit.role is not Role.EXPERIMENT or fault not in _OF_PLAYERS]
    script: list[str] = []
    try:
        for _ in range(_EPISODES * kit.exchanges()):
            exchange = kit.prepare()
            fault = known[rng.integers(len(known))]
            script.append((fault.__doc__ or "").removesuffix(".").lower())
            fault(kit, rng, exchange)
        kit.exchange()
    except Broken as broken:
        expected = f"{broken.expected}, after {', '.join(script)}"
        raise Broken(expected, broken.received, broken.frames) from None


def _undisturbed(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """Nothing."""
    kit.run(exchange)


def _pieces(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """A message in pieces."""
    data = zmtp.encode(exchange.frames)
    ends = np.sort(rng.integers(0, len(data), rng.integers(1, _MOST_PIECES)))
    for begin, end in zip([0, *ends], [*ends, len(data)], strict=True):
        kit.send_bytes(data[begin:end])
        clock.sleep(rng.uniform(0, _LONGEST / _MOST_PIECES))
    kit.take(exchange.expected)


def _heartbeats(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """HEARTBEATs around a message."""
    beat = zmtp.encode(BEAT)
    before, after = rng.integers(0, 20, 2)
    kit.send_bytes(beat * int(before) + zmtp.encode(exchange.frames) + beat * int(after))
    kit.take(exchange.expected)


def _broken_within(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """A break within a message."""
    data = zmtp.encode(exchange.frames)
    kit.send_bytes(data[: rng.integers(len(data))])
    _break(kit, rng)
    kit.reconnect()
    kit.run(exchange)


def _broken_behind(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """A break after a call, whose answer is lost or has not been given."""
    kit.send_frames(exchange.frames)
    clock.sleep(rng.choice([0.0, rng.uniform(0, _LONGEST)]))
    _break(kit, rng)
    kit.reconnect(queued=exchange.expected)
    kit.run(exchange)


def _repeated(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """A call repeated over the same connection."""
    frames = kit.run(exchange)
    for _ in range(rng.integers(1, 4)):
        kit.repeat(exchange, frames)


def _answers_lost(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """Breaks after an answer, as if it had been lost."""
    frames = kit.run(exchange)
    for _ in range(rng.integers(1, 4)):
        _break(kit, rng)
        kit.connect()
        kit.welcome()
        kit.repeat(exchange, frames)


def _handshakes_lost(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """Breaks in handshakes and greetings."""

    def step(connection: Connection) -> None:
        if rng.integers(3):
            connection.greet(kit.wait)
        else:
            connection.send_bytes(zmtp.GREETING[: rng.integers(len(zmtp.GREETING) + 1)])

    for _ in range(rng.integers(1, 4)):
        _break(kit, rng)
        with suppress(Gone):  # libzmq sometimes gives a connection up before its greeting
            step(kit.accept())
    if rng.integers(2):
        kit.connect()
        _break(kit, rng)  # HELLO was heard, and never answered
    kit.reconnect()
    kit.run(exchange)


def _no_hub(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """No hub for a while."""
    kit.listener.close()
    try:
        _break(kit, rng)
        clock.sleep(rng.uniform(0, _LONGEST_ABSENCE))
    finally:
        kit.listener.open()
    kit.reconnect()
    kit.run(exchange)


def _forgotten(kit: Harness, rng: np.random.Generator, exchange: Exchange) -> None:
    """The error unknown-peer."""
    kit.greet_again()
    kit.run(exchange)


def _break(kit: Harness, rng: np.random.Generator) -> None:
    kit.cut(reset=bool(rng.integers(2)))


_OF_PLAYERS: Final = (_broken_behind, _repeated)
"""Faults for players only: an experiment may or may not have sent its next request, and both are right."""

_FAULTS: Final[tuple[Fault, ...]] = (
    *(_undisturbed, _pieces, _heartbeats, _broken_within, _broken_behind),
    *(_repeated, _answers_lost, _handshakes_lost, _no_hub, _forgotten),
)


def rules_of(role: Role, tier: Tier = Tier.COMPLETE) -> list[Rule]:
    """Return the rules for a role in `tier` and the tiers before it, in the order of judging."""
    tiers = list(Tier)[: list(Tier).index(tier) + 1]
    own = experiment_rules if role is Role.EXPERIMENT else player_rules
    rules = [*common_rules.FIRST, *own.RULES, *common_rules.RULES, *common_rules.LAST]
    return [rule for rule in rules if role in rule.roles and rule.tier in tiers]


def judge(
    role: Role,
    start: Start,
    *,
    transport: str = "tcp",
    tier: Tier = Tier.COMPLETE,
    mirror: bool = False,
    wait: float = 5.0,
    quiet: float = QUIET,
    only: Container[str] | None = None,
) -> Iterator[Verdict]:
    """Judge the clients that `start` starts by the rules of their role; yield a verdict on each.

    Args:
        role: the client's role.
        start: starts a client; most rules are judged with the same one.
        transport: `tcp` or `ipc`.
        tier: the highest tier to judge.
        mirror: the client is the mirror of docs/clients.md, whatever its name.
        wait: timeout of each message, in seconds.
        quiet: seconds of silence after which no message is expected any more.
        only: names of the rules to judge; None judges all.

    Raises, while iterating:
        ConfigError: the client cannot be started.
    """
    rules = [rule for rule in rules_of(role, tier) if only is None or rule.name in only]
    return _judge(role, start, rules, transport, mirror, wait, quiet)


def judge_scripts(
    role: Role,
    start: Start,
    seeds: Iterable[int],
    *,
    transport: str = "tcp",
    mirror: bool = False,
    wait: float = 5.0,
    quiet: float = QUIET,
) -> Iterator[Verdict]:
    """Judge clients by a script of faults for each of `seeds`; the rest is as for `judge`."""
    rules = [
        Rule(
            f"seed-{seed}",
            Tier.SURVIVES,
            "breaks-replacements-and-void-episodes",
            "each call is carried out once, whatever happens to connections",
            (role,),
            partial(play_script, seed=seed),
        )
        for seed in seeds
    ]
    return _judge(role, start, rules, transport, mirror, wait, quiet)


def _judge(
    role: Role, start: Start, rules: Iterable[Rule], transport: str, mirror: bool, wait: float, quiet: float
) -> Iterator[Verdict]:
    listener = Listener(transport)
    harness = ExperimentHarness if role is Role.EXPERIMENT else PlayerHarness
    kit: Harness = harness(role, start, listener, mirror, wait, quiet)
    broken: set[str] = set()
    try:
        for rule in rules:
            verdict = replace(_judged(rule, kit, transport, broken), mirror=kit.mirror)
            if verdict.outcome is Outcome.FAILED:
                broken.add(rule.name)
            yield verdict
    finally:
        kit.drop()
        listener.remove()


def _judged(rule: Rule, kit: Harness, transport: str, others: set[str]) -> Verdict:
    verdict = Verdict(rule, transport)
    try:
        if rule not in common_rules.FIRST:
            kit.ready()
        if rule.capability and rule.capability not in kit.capabilities:
            raise NotJudged(f"the client does not offer {rule.capability}, as it may")
        if rule.mirror and not kit.mirror:
            raise NotJudged("it needs the mirror that docs/clients.md describes")
        rule.scene(kit)
    except NotJudged as why:
        return verdict.not_judged(str(why))
    except Broken as broken:
        kit.abandon()
        if lacking := sorted(others.intersection(rule.needs)):
            return verdict.not_judged(f"it rests on {', '.join(lacking)}, which the client breaks")
        return verdict.failed(broken)
    return verdict

"""The contract check for hubs: each rule is broken by a hub made for it, and found by name."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from glue.client.experiment import connect
from glue.conform.hubs.rules import RULES
from glue.conform.hubs.scripted import did, reward
from glue.errors import ConfigError, RemoteProtocolError
from glue.hub.channel import Channel
from glue.hub.config import HubConfig
from glue.hub.session import Peer
from glue.hub.sessions import Sessions
from glue.pace import Pace
from glue.testing import ContractBroken, HubRule, check_hub
from glue.types import Action, has_beside
from glue.wire.beside import readable
from glue.wire.messages import CALLS, EXTRAS, MASK, ErrorCode, Event, Kind, Message, Role, Value
from tests.hubs import hub_with

WAIT = 60.0
"""Seconds to wait; generous, as machines are busy. Only hubs that say nothing use them up."""


hub = partial(hub_with, heartbeat=0.05, timeout=0.3)


def test_our_hub_keeps_every_rule_also_while_it_is_at_work(tmp_path: Path) -> None:
    with hub(bind=f"ipc://{tmp_path}/hub") as url, connect(url) as glue:
        check_hub(url, wait=WAIT)
        assert glue.rl_num_episodes() == 0


def test_hub_that_is_not_there_is_no_hub() -> None:
    with pytest.raises(ContractBroken, match=r"WELCOME .* was not received in time"):
        check_hub("tcp://127.0.0.1:1", wait=0.1)
    with pytest.raises(ConfigError, match="tcp://host:port"):
        check_hub("localhost")


# Hubs that break one rule


Seen = dict[Any, Any]
Change = Callable[[Message, Seen], Message]
"""A change of a message, by what the hub remembers of those before it."""


def as_it_is(message: Message, seen: Seen) -> Message:
    return message


class Spoiled(Sessions):
    """Our sessions, with changes to outgoing and incoming messages."""

    said: Change = staticmethod(as_it_is)
    heard: Change = staticmethod(as_it_is)

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.seen: Seen = {}

    def send(self, channel: Channel, message: Message) -> bool:
        return channel.deliver(self.said(message, self.seen))

    def deliver(self, peer: Peer, message: Message) -> None:
        self.send(peer.channel, message)

    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        return super().receive(channel, self.heard(message, self.seen), now)


class LeavesOutWhatWasNotOffered(Spoiled):
    """Passes on the observations of an environment as if it had sent only what it has offered."""

    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        offered = self.capabilities(message.session, Role.ENVIRONMENT)
        if message.kind is Kind.ENV_START and offered is not None:
            message = message._replace(body=readable(message.body, offered))
        return super().receive(channel, message, now)


class NeverWelcomes(Spoiled):
    def send(self, channel: Channel, message: Message) -> bool:
        return message.kind is Kind.WELCOME or super().send(channel, message)


class AsksTheAgentBeforeTheEnvironment(Spoiled):
    def send(self, channel: Channel, message: Message) -> bool:
        if message.kind is Kind.AGENT_INIT:
            self.seen[message.session] = channel
        if message.kind is Kind.ENV_START:
            early = message._replace(kind=Kind.AGENT_START, seq=message.seq + 1, body=Action().body)
            super().send(self.seen[message.session], early)
        return message.kind is Kind.AGENT_START or super().send(channel, message)


class KnowsOneSessionOfAConnection(Spoiled):
    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        session = self.seen.setdefault(channel, message.session)
        return super().receive(channel, message._replace(session=session), now)


class DropsWhoSaysWhatIsUnknown(Spoiled):
    def malformed(self, channel: Channel, error: RemoteProtocolError, now: float) -> None:
        super().malformed(channel, RemoteProtocolError(str(error)), now)


class CountsAHelloForAnAnswer(Spoiled):
    """Counts an instance as known from its first HELLO until its goodbye."""

    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        if message.kind is Kind.HELLO:
            self.seen[channel, message.session] = message.session, message.scalars[2]
        if message.kind is Kind.GOODBYE:
            self.seen.pop(self.seen.get((channel, message.session)), None)
        return super().receive(channel, message, now)

    def send(self, channel: Channel, message: Message) -> bool:
        if message.kind is Kind.WELCOME:
            peer = self.seen[channel, message.session]
            version, resumed, *rest = message.scalars
            message = message._replace(scalars=(version, resumed or peer in self.seen, *rest))
            self.seen[peer] = True
        return super().send(channel, message)


class DoesNotWait(Spoiled):
    """Time passes with each answer of the agent, and by the clock only half a second after a step was due.

    So a judge who was kept from answering in time, on a busy machine, is not late.
    """

    def __init__(self, config: HubConfig, *more: Any) -> None:
        super().__init__(replace(config, pace=Pace(rate=50.0)), *more)
        by_the_clock = self.at

        def at(time: float, work: Callable[[float], None]) -> None:
            self.due[time] = partial(work, time)
            by_the_clock(time + 0.5, lambda now: self.carry_out(time))

        self.due: dict[float, Callable[[], None]] = {}
        self.at = at

    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        kept = super().receive(channel, message, now)
        if message.kind is Kind.AGENT_STEP:
            self.carry_out(*self.due)
        return kept

    def carry_out(self, *times: float) -> None:
        """Carry out the steps that were due at these times, if that was not done."""
        for due in [self.due.pop(time) for time in times if time in self.due]:
            due()


class CallsALateAgentAgain(DoesNotWait):
    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        if message.kind is Kind.AGENT_STEP:
            self.seen.pop(message.session, None)
        return super().receive(channel, message, now)

    def send(self, channel: Channel, message: Message) -> bool:
        if message.kind is Kind.AGENT_STEP:
            self.seen[message.session] = channel, message
        elif message.kind is Kind.ENV_STEP and message.session in self.seen:
            super().send(*self.seen[message.session])
        return super().send(channel, message)


class WaitsForEver(Spoiled):
    def tick(self, now: float) -> None:
        super().tick(0.0)


def of_kinds(change: Change, kinds: Container[Kind]) -> Any:
    return staticmethod(lambda m, seen: change(m, seen) if m.kind in kinds else m)


def saying(change: Change, *kinds: Kind, base: type[Spoiled] = Spoiled) -> type[Spoiled]:
    """Return a hub that changes its outgoing messages of some kinds."""
    return type("Saying", (base,), {"said": of_kinds(change, kinds)})


def hearing(change: Change, *kinds: Kind) -> type[Spoiled]:
    """Return a hub that changes incoming messages of some kinds."""
    return type("Hearing", (Spoiled,), {"heard": of_kinds(change, kinds)})


def remembers(message: Message, seen: Seen) -> Message:
    """Remember what the environment of a session has answered last."""
    seen[message.session] = message
    return message


Remembering = hearing(remembers, Kind.ENV_INIT, Kind.ENV_START, Kind.ENV_STEP)


def last_reward(message: Message, seen: Seen) -> Message:
    before = seen.get(message.session)
    return message._replace(scalars=(before.scalars or (0.0,))[:1] if before else (0.0,))


def last_observation(kept: str) -> Change:
    """Return a change of a step into the environment's last observation, with its mask or its extras."""

    def change(message: Message, seen: Seen) -> Message:
        body = seen[message.session].body
        return message._replace(body=readable(body, {kept})) if has_beside(body) else message

    return change


def forgets_late_answers(message: Message, seen: Seen) -> Message:
    """Carry out the action before once more, in place of the answer of a late agent."""
    if message.kind is Kind.AGENT_STEP and message.scalars[0] == LATE:
        seen[message.session] = True
    return message._replace(body=message.body.replace(did(1), did(0))) if message.session in seen else message


def backwards(message: Message, seen: Seen) -> Message:
    called = message.kind in CALLS and CALLS[message.kind].callee is not None
    return message._replace(seq=1000 - message.seq) if called and message.seq < 1000 else message


class CountsBackwards(Spoiled):
    said = heard = staticmethod(backwards)


def the_body_before(message: Message, seen: Seen) -> Message:
    before = seen.get(message.session, message.body)
    seen[message.session] = message.body
    return message._replace(body=before)


def another_number_if_repeated(message: Message, seen: Seen) -> Message:
    key = message.session, message.kind, message.seq
    again, seen[key] = key in seen, True
    return message._replace(seq=message.seq + again)


def start_of_a_newcomer(message: Message, seen: Seen) -> Message:
    if message.kind is Kind.ENV_INIT and message.session in seen:
        return message._replace(kind=Kind.ENV_START)
    if message.scalars[:2] == (Event.LOST, Role.ENVIRONMENT):
        seen[message.session] = True
    return message


def scalars(start: int, *values: Value, stop: int | None = None) -> Change:
    """Return a change of the scalars from `start` to `stop`, by default as many as there are values."""
    end = start + len(values) if stop is None else stop
    return lambda m, seen: m._replace(scalars=(*m.scalars[:start], *values, *m.scalars[end:]))


def first(change: Callable[[Any], Value]) -> Change:
    """Return a change of the first scalar."""
    return lambda m, seen: m._replace(scalars=(change(m.scalars[0]), *m.scalars[1:]))


def without(code: ErrorCode) -> type[Spoiled]:
    """Return a hub that says `full` instead of an error code."""
    return saying(first(lambda said: "full" if said == code else said), Kind.ERROR)


def instead(kind: Kind, *values: Value) -> Change:
    """Return a change to a message of another kind, unless its number is 0 and it is a heartbeat."""
    return lambda m, seen: m if (m.kind, m.seq) == (Kind.HEARTBEAT, 0) else Message(kind, *m[1:3], values)


FIRST_ACTION = Action([0]).body
LATE = reward(2) + reward(3)

BROKEN_HUBS: dict[str, tuple[HubRule, type[Spoiled]]] = {
    "welcomes with its own number": (
        HubRule.GREETING,
        saying(lambda m, seen: m._replace(seq=0), Kind.WELCOME),
    ),
    "knows everybody": (HubRule.GREETING, saying(scalars(1, True), Kind.WELCOME)),
    "does not answer heartbeats": (
        HubRule.HEARTBEAT,
        saying(instead(Kind.ERROR, "unknown-kind", ""), Kind.HEARTBEAT),
    ),
    "asks the agent before the environment": (HubRule.CALLS, AsksTheAgentBeforeTheEnvironment),
    "shows an old observation": (HubRule.CALLS, saying(the_body_before, Kind.AGENT_START, Kind.AGENT_STEP)),
    "rounds rewards": (HubRule.CALLS, saying(first(lambda reward: float(round(reward))), Kind.AGENT_STEP)),
    "tells the outcome unasked": (HubRule.CALLS, saying(scalars(1, 0.0, 1, stop=1), Kind.RL_EPISODE)),
    "counts backwards": (HubRule.NUMBERS, CountsBackwards),
    "returns the last reward": (HubRule.COUNTERS, saying(last_reward, Kind.RL_RETURN, base=Remembering)),
    "counts no start": (HubRule.COUNTERS, saying(first(lambda n: max(0, n - 1)), Kind.RL_NUM_STEPS)),
    "takes the limit for the end": (HubRule.CUTOFF, saying(scalars(0, True), Kind.RL_EPISODE)),
    "tells another outcome": (
        HubRule.OUTCOME,
        saying(lambda m, seen: scalars(2, 0)(m, seen) if m.scalars[1:] else m, Kind.RL_EPISODE),
    ),
    "forgets the rewards of late agents": (
        HubRule.PACE,
        saying(first(lambda given: reward(3) if given == LATE else given), Kind.AGENT_STEP, base=DoesNotWait),
    ),
    "forgets them at the end": (
        HubRule.PACE,
        saying(
            first(lambda given: reward(5) if given == reward(4) + reward(5) else given),
            Kind.AGENT_END,
            base=DoesNotWait,
        ),
    ),
    "forgets late answers": (
        HubRule.PACE,
        saying(forgets_late_answers, Kind.AGENT_STEP, Kind.ENV_STEP, Kind.RL_STEP, base=DoesNotWait),
    ),
    "calls a late agent again": (HubRule.PACE, CallsALateAgentAgain),
    "counts no late actions": (
        HubRule.PACE,
        saying(
            lambda m, seen: scalars(1, 0)(m, seen) if m.scalars[1:] else m,
            Kind.RL_NUM_STEPS,
            base=DoesNotWait,
        ),
    ),
    "acts before any action": (
        HubRule.LAST_ACTION,
        saying(lambda m, seen: m._replace(body=FIRST_ACTION) if len(m.body) == 16 else m, Kind.ENV_STEP),
    ),
    "ends texts at a zero": (
        HubRule.MESSAGES,
        saying(
            lambda m, seen: m._replace(body=m.body.partition(b"\0")[0]), Kind.AGENT_MESSAGE, Kind.ENV_MESSAGE
        ),
    ),
    "speaks every version": (HubRule.VERSION, hearing(scalars(0, (1,)), Kind.HELLO)),
    "takes everybody for the same": (HubRule.ROLE_TAKEN, hearing(scalars(2, bytes(16)), Kind.HELLO)),
    "does not say unknown-peer": (HubRule.UNKNOWN_PEER, without(ErrorCode.UNKNOWN_PEER)),
    "gives one seed": (HubRule.SEED, saying(scalars(0, 1), Kind.ENV_SEED)),
    "does not say unsupported": (HubRule.UNSUPPORTED, without(ErrorCode.UNSUPPORTED)),
    "knows one session of a connection": (HubRule.SESSIONS, KnowsOneSessionOfAConnection),
    "does not say busy": (HubRule.BUSY, without(ErrorCode.BUSY)),
    "carries out what is repeated": (HubRule.REPEATED, hearing(another_number_if_repeated, Kind.RL_STEP)),
    "does not say not-asked": (HubRule.NOT_ASKED, without(ErrorCode.NOT_ASKED)),
    "drops a peer of an unknown kind": (HubRule.UNKNOWN_KIND, DropsWhoSaysWhatIsUnknown),
    "drops a peer that fails": (HubRule.EXCEPTION, hearing(instead(Kind.GOODBYE, ""), Kind.ERROR)),
    "does not say malformed": (HubRule.MALFORMED, without(ErrorCode.MALFORMED)),
    "calls again with a new number": (HubRule.RESUMED, saying(another_number_if_repeated, Kind.ENV_STEP)),
    "counts a hello for an answer": (HubRule.WELCOME_LOST, CountsAHelloForAnAnswer),
    "sends off with an error": (HubRule.GOODBYE, saying(instead(Kind.ERROR, "full", ""), Kind.GOODBYE)),
    "does not say peer-lost": (HubRule.LOST, without(ErrorCode.PEER_LOST)),
    "shows the agent extras": (
        HubRule.BESIDE,
        saying(last_observation(EXTRAS), Kind.AGENT_STEP, base=Remembering),
    ),
    "shows every agent masks": (
        HubRule.BESIDE,
        saying(last_observation(MASK), Kind.AGENT_STEP, base=Remembering),
    ),
    "keeps extras to itself": (
        HubRule.BESIDE,
        saying(lambda m, seen: m._replace(body=readable(m.body, {MASK})), Kind.RL_ENV_STEP),
    ),
    "confirms what was not offered": (
        HubRule.BESIDE,
        saying(lambda m, seen: scalars(5, (EXTRAS, MASK))(m, seen) if m.scalars[5:] else m, Kind.WELCOME),
    ),
    "leaves out what was not offered": (HubRule.UNOFFERED, LeavesOutWhatWasNotOffered),
    "initialises no newcomer": (HubRule.REPLACED, saying(start_of_a_newcomer, Kind.NOTICE, Kind.ENV_INIT)),
}


def caught(monkeypatch: pytest.MonkeyPatch, broken: type[Spoiled], wait: float = WAIT) -> ContractBroken:
    monkeypatch.setattr("glue.hub.io.server.Sessions", broken)
    with hub() as url, pytest.raises(ContractBroken) as error:
        check_hub(url, wait=wait)
    return error.value


@pytest.mark.parametrize("broken", BROKEN_HUBS)
def test_broken_hub_is_found_by_name(monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    rule, made = BROKEN_HUBS[broken]
    assert caught(monkeypatch, made).rule is rule


@pytest.mark.parametrize(
    ("broken", "rule"), [(NeverWelcomes, HubRule.GREETING), (WaitsForEver, HubRule.SILENT)]
)
def test_hub_that_says_nothing_is_found_when_the_wait_is_over(
    monkeypatch: pytest.MonkeyPatch, broken: type[Spoiled], rule: HubRule
) -> None:
    only = [each for each in RULES if each.text == rule]
    monkeypatch.setattr("glue.conform.hubs.judge.RULES", only)
    assert caught(monkeypatch, broken, wait=0.5).rule is rule


def test_a_hub_that_does_not_wait_keeps_every_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glue.hub.io.server.Sessions", DoesNotWait)
    with hub() as url:
        check_hub(url, wait=WAIT)


def test_every_rule_is_broken_by_a_hub() -> None:
    assert {rule for rule, _ in BROKEN_HUBS.values()} == set(HubRule) - {HubRule.SILENT}

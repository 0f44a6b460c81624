"""The contract check for hubs: each rule is broken by a hub made for it, and found by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from glue.client.experiment import connect
from glue.core.config import HubConfig
from glue.core.peer import Peer
from glue.core.sessions import Route, Switchboard
from glue.errors import ConfigError, RemoteProtocolError
from glue.hub.server import Hub
from glue.protocol.messages import CALLS, ErrorCode, Event, Kind, Message, Role
from glue.protocol.steps import Step, StepFormat
from glue.testing import ContractBroken, HubRule, check_hub
from glue.types import Action

WAIT = 5.0
"""Seconds. Only the hubs that say nothing let it pass."""


@contextmanager
def hub(url: str = "tcp://127.0.0.1:*") -> Iterator[str]:
    config = HubConfig(bind=(url,), heartbeat=0.05, timeout=0.3)
    with Hub(config).in_background() as running:
        yield running.endpoints[0]


@pytest.mark.parametrize("scheme", ["tcp", "ipc"])
def test_our_hub_keeps_every_rule_also_while_it_is_at_work(scheme: str, tmp_path: Path) -> None:
    address = "tcp://127.0.0.1:*" if scheme == "tcp" else f"ipc://{tmp_path}/hub"
    with hub(address) as url, connect(url) as glue:
        check_hub(url, wait=WAIT)
        assert glue.rl_num_episodes() == 0


def test_hub_that_is_not_there_is_no_hub() -> None:
    with pytest.raises(ContractBroken, match=r"WELCOME .* was not received in time"):
        check_hub("tcp://127.0.0.1:1", wait=0.1)
    with pytest.raises(ConfigError, match="tcp://host:port"):
        check_hub("localhost")


# Hubs that break one rule


class Spoiled(Switchboard):
    """Ours, but for what is changed on its way out and on its way in."""

    def __init__(self, config: HubConfig, log: Callable[[str], None], clock: Callable[[], float]) -> None:
        super().__init__(config, log, clock)
        self.seen: dict[Any, Any] = {}

    def send(self, route: Route, message: Message) -> bool:
        arrived = [to.deliver(sent) for to, sent in self.out(route, message)]
        return all(arrived)

    def deliver(self, peer: Peer, message: Message) -> None:
        self.send(peer.route, message)

    def receive(self, route: Route, message: Message, now: float) -> bool:
        in_turn = [super(Spoiled, self).receive(route, heard, now) for heard in self.heard(route, message)]
        return all(in_turn)

    def receive_step(self, route: Route, form: StepFormat, step: Step, now: float) -> bool:
        return False  # by the long way, where what is heard can be changed

    def out(self, route: Route, message: Message) -> list[tuple[Route, Message]]:
        return [(route, self.says(message))]

    def heard(self, route: Route, message: Message) -> list[Message]:
        return [self.expects(message)]

    def says(self, message: Message) -> Message:
        return message

    def expects(self, message: Message) -> Message:
        return message


class NeverWelcomes(Spoiled):
    def out(self, route: Route, message: Message) -> list[tuple[Route, Message]]:
        return [] if message.kind is Kind.WELCOME else [(route, message)]


class WelcomesWithItsOwnNumber(Spoiled):
    def says(self, message: Message) -> Message:
        return message._replace(seq=0) if message.kind is Kind.WELCOME else message


class KnowsEverybody(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is not Kind.WELCOME:
            return message
        return message._replace(scalars=(message.scalars[0], True, *message.scalars[2:]))


class DoesNotAnswerHeartbeats(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is Kind.HEARTBEAT and message.seq:
            return message._replace(kind=Kind.ERROR, scalars=("unknown-kind", ""))
        return message


class AsksTheAgentBeforeTheEnvironment(Spoiled):
    def out(self, route: Route, message: Message) -> list[tuple[Route, Message]]:
        if message.kind is Kind.AGENT_INIT:
            self.seen[message.session] = route
        if message.kind is Kind.ENV_START:
            early = message._replace(kind=Kind.AGENT_START, seq=message.seq + 1, body=Action().body)
            return [(self.seen[message.session], early), (route, message)]
        return [] if message.kind is Kind.AGENT_START else [(route, message)]


class ShowsAnOldObservation(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind not in (Kind.AGENT_START, Kind.AGENT_STEP):
            return message
        before = self.seen.get(message.session, message.body)
        self.seen[message.session] = message.body
        return message._replace(body=before)


class RoundsRewards(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is not Kind.AGENT_STEP:
            return message
        return message._replace(scalars=(float(round(float(str(message.scalars[0])))),))


class CountsBackwards(Spoiled):
    def says(self, message: Message) -> Message:
        return self.expects(message)

    def expects(self, message: Message) -> Message:
        called = message.kind in CALLS and CALLS[message.kind].callee is not None
        return message._replace(seq=1000 - message.seq) if called and message.seq < 1000 else message


class ReturnsTheLastReward(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is Kind.RL_RETURN:
            return message._replace(scalars=(self.seen.get(message.session, 0.0),))
        return message

    def expects(self, message: Message) -> Message:
        if message.kind is Kind.ENV_STEP:
            self.seen[message.session] = message.scalars[0]
        if message.kind in (Kind.ENV_INIT, Kind.ENV_START):
            self.seen[message.session] = 0.0
        return message


class CountsNoStart(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is not Kind.RL_NUM_STEPS:
            return message
        return message._replace(scalars=(max(0, int(str(message.scalars[0])) - 1),))


class TakesTheLimitForTheEnd(Spoiled):
    def says(self, message: Message) -> Message:
        return message._replace(scalars=(True,)) if message.kind is Kind.RL_EPISODE else message


class TellsTheOutcomeUnasked(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is not Kind.RL_EPISODE:
            return message
        return message._replace(scalars=(message.scalars[0], 0.0, 1))


class TellsAnotherOutcome(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is not Kind.RL_EPISODE or len(message.scalars) == 1:
            return message
        return message._replace(scalars=(*message.scalars[:2], 0))


class ActsBeforeAnyAction(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is Kind.ENV_STEP and message.body == Action().body:
            return message._replace(body=Action([0]).body)
        return message


class EndsTextsAtAZero(Spoiled):
    def says(self, message: Message) -> Message:
        is_text = message.kind in (Kind.AGENT_MESSAGE, Kind.ENV_MESSAGE)
        return message._replace(body=message.body.partition(b"\0")[0]) if is_text else message


class SpeaksEveryVersion(Spoiled):
    def expects(self, message: Message) -> Message:
        if message.kind is not Kind.HELLO:
            return message
        return message._replace(scalars=((1,), *message.scalars[1:]))


class TakesEverybodyForTheSame(Spoiled):
    def expects(self, message: Message) -> Message:
        if message.kind is not Kind.HELLO:
            return message
        return message._replace(scalars=(*message.scalars[:2], bytes(16), *message.scalars[3:]))


class SaysAnotherCode(Spoiled):
    said: ErrorCode

    def says(self, message: Message) -> Message:
        if message.kind is Kind.ERROR and message.scalars[0] == self.said:
            return message._replace(scalars=("full", message.scalars[1]))
        return message


class DoesNotSayUnknownPeer(SaysAnotherCode):
    said = ErrorCode.UNKNOWN_PEER


class DoesNotSayUnsupported(SaysAnotherCode):
    said = ErrorCode.UNSUPPORTED


class DoesNotSayBusy(SaysAnotherCode):
    said = ErrorCode.BUSY


class DoesNotSayNotAsked(SaysAnotherCode):
    said = ErrorCode.NOT_ASKED


class DoesNotSayMalformed(SaysAnotherCode):
    said = ErrorCode.MALFORMED


class DoesNotSayPeerLost(SaysAnotherCode):
    said = ErrorCode.PEER_LOST


class GivesOneSeed(Spoiled):
    def says(self, message: Message) -> Message:
        return message._replace(scalars=(1,)) if message.kind is Kind.ENV_SEED else message


class KnowsOneSessionOfAConnection(Spoiled):
    def heard(self, route: Route, message: Message) -> list[Message]:
        return [message._replace(session=self.seen.setdefault(route, message.session))]


class CarriesOutWhatIsRepeated(Spoiled):
    def expects(self, message: Message) -> Message:
        key = message.session, message.kind, message.seq
        if message.kind is Kind.RL_STEP and key in self.seen:
            return message._replace(seq=message.seq + 1)
        self.seen[key] = message
        return message


class DropsWhoSaysWhatIsUnknown(Spoiled):
    def malformed(self, route: Route, error: RemoteProtocolError, now: float) -> None:
        super().malformed(route, RemoteProtocolError(str(error)), now)


class DropsWhoFails(Spoiled):
    def expects(self, message: Message) -> Message:
        return message._replace(kind=Kind.GOODBYE, scalars=("",)) if message.kind is Kind.ERROR else message


class CallsAgainWithANewNumber(Spoiled):
    def says(self, message: Message) -> Message:
        key = message.session, message.kind, message.seq
        if message.kind is Kind.ENV_STEP and key in self.seen:
            return message._replace(seq=message.seq + 1)
        self.seen[key] = message
        return message


class CountsAHelloForAnAnswer(Spoiled):
    """It takes an instance for known from its first HELLO on, until it says goodbye."""

    def heard(self, route: Route, message: Message) -> list[Message]:
        if message.kind is Kind.HELLO:
            self.seen[route, message.session] = message.session, message.scalars[2]
        if message.kind is Kind.GOODBYE:
            self.seen.pop(self.seen.get((route, message.session)), None)
        return [message]

    def out(self, route: Route, message: Message) -> list[tuple[Route, Message]]:
        if message.kind is Kind.WELCOME:
            peer = self.seen[route, message.session]
            version, resumed, *rest = message.scalars
            message = message._replace(scalars=(version, resumed or peer in self.seen, *rest))
            self.seen[peer] = True
        return [(route, message)]


class SendsOffWithAnError(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is Kind.GOODBYE:
            return message._replace(kind=Kind.ERROR, scalars=("full", ""))
        return message


class WaitsForEver(Spoiled):
    def tick(self, now: float) -> None:
        super().tick(0.0)


class InitialisesNoNewcomer(Spoiled):
    def says(self, message: Message) -> Message:
        if message.kind is Kind.NOTICE and message.scalars[:2] == (Event.LOST, Role.ENVIRONMENT):
            self.seen[message.session] = True
        if message.kind is Kind.ENV_INIT and message.session in self.seen:
            return message._replace(kind=Kind.ENV_START)
        return message


BROKEN_HUBS: list[tuple[type[Spoiled], HubRule]] = [
    (WelcomesWithItsOwnNumber, HubRule.GREETING),
    (KnowsEverybody, HubRule.GREETING),
    (DoesNotAnswerHeartbeats, HubRule.HEARTBEAT),
    (AsksTheAgentBeforeTheEnvironment, HubRule.CALLS),
    (ShowsAnOldObservation, HubRule.CALLS),
    (RoundsRewards, HubRule.CALLS),
    (CountsBackwards, HubRule.NUMBERS),
    (ReturnsTheLastReward, HubRule.COUNTERS),
    (CountsNoStart, HubRule.COUNTERS),
    (TakesTheLimitForTheEnd, HubRule.CUTOFF),
    (TellsTheOutcomeUnasked, HubRule.CALLS),
    (TellsAnotherOutcome, HubRule.OUTCOME),
    (ActsBeforeAnyAction, HubRule.LAST_ACTION),
    (EndsTextsAtAZero, HubRule.MESSAGES),
    (SpeaksEveryVersion, HubRule.VERSION),
    (TakesEverybodyForTheSame, HubRule.ROLE_TAKEN),
    (DoesNotSayUnknownPeer, HubRule.UNKNOWN_PEER),
    (GivesOneSeed, HubRule.SEED),
    (DoesNotSayUnsupported, HubRule.UNSUPPORTED),
    (KnowsOneSessionOfAConnection, HubRule.SESSIONS),
    (DoesNotSayBusy, HubRule.BUSY),
    (CarriesOutWhatIsRepeated, HubRule.REPEATED),
    (DoesNotSayNotAsked, HubRule.NOT_ASKED),
    (DropsWhoSaysWhatIsUnknown, HubRule.UNKNOWN_KIND),
    (DropsWhoFails, HubRule.EXCEPTION),
    (DoesNotSayMalformed, HubRule.MALFORMED),
    (CallsAgainWithANewNumber, HubRule.RESUMED),
    (CountsAHelloForAnAnswer, HubRule.WELCOME_LOST),
    (SendsOffWithAnError, HubRule.GOODBYE),
    (DoesNotSayPeerLost, HubRule.LOST),
    (WaitsForEver, HubRule.SILENT),
    (InitialisesNoNewcomer, HubRule.REPLACED),
]


def caught(monkeypatch: pytest.MonkeyPatch, broken: type[Spoiled], wait: float = WAIT) -> ContractBroken:
    monkeypatch.setattr("glue.hub.server.Switchboard", broken)
    with hub() as url, pytest.raises(ContractBroken) as error:
        check_hub(url, wait=wait)
    return error.value


@pytest.mark.parametrize(("broken", "rule"), BROKEN_HUBS)
def test_broken_hub_is_found_by_name(
    monkeypatch: pytest.MonkeyPatch, broken: type[Spoiled], rule: HubRule
) -> None:
    assert caught(monkeypatch, broken).rule is rule


def test_hub_that_never_welcomes_is_found_when_the_wait_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    error = caught(monkeypatch, NeverWelcomes, wait=0.2)
    assert error.rule is HubRule.GREETING
    assert "WELCOME" in str(error)


def test_every_rule_is_broken_by_somebody() -> None:
    assert {rule for _, rule in BROKEN_HUBS} == set(HubRule)

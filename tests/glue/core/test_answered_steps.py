"""The short way of a step's answer into a session: for what is exactly awaited, and nothing else."""

from __future__ import annotations

import pytest

from glue.core.config import HubConfig
from glue.core.sessions import INSTANCE_SIZE, Switchboard
from glue.protocol.messages import PROTOCOL_VERSION, Kind, Message, Role
from glue.protocol.steps import step_formats
from glue.types import CUT_OFF, Action, Observation

ACTION = Action([1]).body
SEEN = Observation([2]).body
REPLY = step_formats(Kind.ENV_STEP, "s")[1]


class Desk:
    """A route that keeps what it is sent."""

    def __init__(self) -> None:
        self.sent: list[Message] = []

    def deliver(self, message: Message) -> bool:
        self.sent.append(message)
        return True

    def admits(self, role: Role, session: str) -> bool:
        return True


class Table:
    """A session with an environment and an experiment, which has the environment make steps."""

    def __init__(self, *capabilities: str) -> None:
        self.board = Switchboard(HubConfig(), lambda line: None)
        self.environment, self.experiment = Desk(), Desk()
        self.requests = 0
        for role, desk, offered in (
            ("environment", self.environment, capabilities),
            ("experiment", self.experiment, ()),
        ):
            hello = ((PROTOCOL_VERSION,), role, role.encode().ljust(INSTANCE_SIZE), role, "test", offered)
            self.board.receive(desk, Message(Kind.HELLO, "s", 1, hello), 0.0)

    def ask(self) -> int:
        """Have the environment asked for a step; return the call's number."""
        self.requests += 1
        self.board.receive(self.experiment, Message(Kind.RL_ENV_STEP, "s", self.requests, (), ACTION), 0.0)
        call = self.environment.sent[-1]
        assert call.kind is Kind.ENV_STEP
        return call.seq

    def answer(self, seq: int, terminal: bool | int, desk: Desk | None = None) -> bool:
        """Answer by the short way; return whether that was the answer awaited."""
        return self.board.receive_step(desk or self.environment, REPLY, (seq, (1.0, terminal), SEEN), 0.0)

    def confirm(self) -> None:
        """Make one step by the long way."""
        self.board.receive(self.environment, Message(Kind.ENV_STEP, "s", self.ask(), (1.0, False), SEEN), 0.0)


def test_the_answer_awaited_reaches_the_experiment() -> None:
    table = Table()
    table.confirm()
    assert table.answer(table.ask(), True)
    assert table.experiment.sent[-1] == Message(Kind.RL_ENV_STEP, "s", 2, (1.0, True), SEEN)


def test_the_first_answer_of_a_peer_goes_the_long_way_which_confirms_it() -> None:
    table = Table()
    assert not table.answer(table.ask(), True)


@pytest.mark.parametrize("wrong", [-1, 1])
def test_an_answer_to_another_call_is_left_alone(wrong: int) -> None:
    table = Table()
    table.confirm()
    seq = table.ask()
    before = list(table.experiment.sent)
    assert not table.answer(seq + wrong, True)
    assert table.experiment.sent == before
    assert table.answer(seq, True)
    assert not table.answer(seq, True), "it is not awaited any more"


def test_only_the_route_that_has_the_seat_may_answer() -> None:
    table = Table()
    table.confirm()
    seq = table.ask()
    assert not table.answer(seq, True, Desk())
    assert not table.answer(seq, True, table.experiment)
    assert table.answer(seq, True)


@pytest.mark.parametrize(("capabilities", "terminal"), [((), True), (("truncate",), CUT_OFF)])
def test_whether_an_environment_can_cut_off_is_decided_by_the_long_way(
    capabilities: tuple[str, ...], terminal: bool | int
) -> None:
    table = Table(*capabilities)
    table.confirm()
    seq = table.ask()
    assert not table.answer(seq, CUT_OFF)
    table.board.receive(table.environment, Message(Kind.ENV_STEP, "s", seq, (1.0, CUT_OFF), SEEN), 0.0)
    shown = table.experiment.sent[-1].scalars[1]
    assert (shown, type(shown)) == (terminal, type(terminal))

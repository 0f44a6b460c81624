"""The hub's treatment of peers that join, leave, return, repeat messages and misbehave, without sockets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glue.errors import RemoteProtocolError
from glue.hub.config import Bind, HubConfig
from glue.hub.sessions import INSTANCE_SIZE, Sessions
from glue.types import Action, Observation
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import (
    CALLS,
    MAX_NAME,
    PROTOCOL_VERSION,
    THREE_ROLES,
    Body,
    ErrorCode,
    Kind,
    Message,
    Role,
    Shape,
)
from tests.glue.wire.test_wire import messages
from tests.proof import size
from tests.weighing import check_sessions

OBSERVATION = Observation(ints=[3], chars=b"o").body
ACTION = Action(ints=[4]).body
CONFIG = HubConfig(heartbeat=1.0, timeout=5.0, max_sessions=8)


def instance(name: str) -> bytes:
    return name.encode().ljust(INSTANCE_SIZE, b".")


ANSWERS: dict[Kind, tuple[tuple[Any, ...], bytes]] = {
    Kind.ENV_INIT: ((), b"spec"),
    Kind.ENV_START: ((), OBSERVATION),
    Kind.ENV_STEP: ((1.0, False), OBSERVATION),
    Kind.ENV_MESSAGE: ((), b"env answer"),
    Kind.AGENT_START: ((), ACTION),
    Kind.AGENT_STEP: ((), ACTION),
    Kind.AGENT_MESSAGE: ((), b"agent answer"),
}


class Named:
    """A channel of a rig."""

    def __init__(self, rig: Rig, name: str) -> None:
        self._rig = rig
        self._name = name

    def deliver(self, message: Message) -> bool:
        return self._rig.deliver(self._name, message)

    def admits(self, role: Role, session: str) -> bool:
        return self._rig.admits(self._name, role, session)


class Rig:
    """A sessions with named channels; the messages that it sends wait in `inbox` until they are read.

    All messages are encoded and decoded, both ways, so that only legal ones are possible.
    """

    def __init__(self, config: HubConfig = CONFIG, clock: Callable[[], float] | None = None) -> None:
        self.due: list[tuple[float, Callable[[float], None]]] = []
        self.sessions = Sessions(config, self._log, clock, lambda time, work: self.due.append((time, work)))
        self.channels: dict[str, Named] = {}
        self.binds: dict[str, Bind] = {}
        self.inbox: dict[str, list[Message]] = {}
        self.gone: set[str] = set()
        self.full: set[str] = set()
        self.now = 0.0
        self.logged: list[str] = []

    def _log(self, line: str) -> None:
        self.logged.append(line)

    def channel(self, name: str) -> Named:
        """Return the channel of that name."""
        return self.channels.setdefault(name, Named(self, name))

    def admits(self, channel: str, role: Role, session: str) -> bool:
        """Return whether the channel's address admits the role; True if it has none."""
        return channel not in self.binds or self.binds[channel].admits(role, session)

    def deliver(self, channel: str, message: Message) -> bool:
        """Put `message` into the channel's inbox."""
        frames = encode(message, FROM_HUB)
        if channel in self.gone or channel in self.full:
            return False
        self.inbox.setdefault(channel, []).append(decode(frames, FROM_HUB))
        return True

    def put(
        self, channel: str, kind: Kind, seq: int = 0, *scalars: Any, body: bytes = b"", session: str = "s"
    ) -> None:
        """Send a message from `channel`."""
        message = decode(encode(Message(kind, session, seq, scalars, body), TO_HUB), TO_HUB)
        self.sessions.receive(self.channel(channel), message, self.now)

    def say(self, channel: str, *message: Any, **more: Any) -> list[Message]:
        """Send a message from `channel`; return everything it has received since the last call."""
        self.put(channel, *message, **more)
        return self.received(channel)

    def received(self, channel: str) -> list[Message]:
        """Return the messages sent to `channel` since the last call."""
        return self.inbox.pop(channel, [])

    def hello(
        self,
        channel: str,
        role: Role | str,
        who: str | None = None,
        session: str = "s",
        abilities: tuple[str, ...] = (),
    ) -> list[Message]:
        """Let a peer in by `channel`, by default with its name. Return the hub's messages."""
        name = who or channel
        scalars = ((PROTOCOL_VERSION,), str(role), instance(name), name, "test", abilities)
        return self.say(channel, Kind.HELLO, 0, *scalars, session=session)

    def fill(self, **abilities: tuple[str, ...]) -> None:
        """Let in an agent, an environment and an experiment, by channels `a`, `e` and `x`."""
        for channel, role in (("a", Role.AGENT), ("e", Role.ENVIRONMENT), ("x", Role.EXPERIMENT)):
            assert self.hello(channel, role, abilities=abilities.get(role, ()))[0].kind is Kind.WELCOME
        self.received("x")

    def ask(self, kind: Kind, seq: int, *scalars: Any, body: bytes = b"") -> None:
        """Let the experiment request a verb that is not answered at once."""
        self.received("x")
        assert self.say("x", kind, seq, *scalars, body=body) == []

    def carry_out(self, *verb: Any, body: bytes = b"") -> list[Kind]:
        """Let the experiment request a verb, and the players answer until it is done; return their calls."""
        self.ask(*verb, body=body)
        return self.serve()

    def usual(self, kind: Kind) -> tuple[tuple[Any, ...], bytes]:
        """Return scalars and body of a player's usual answer."""
        return ANSWERS.get(kind, ((), b""))

    def called(self, channel: str) -> Message:
        """Return the one call that a player was sent."""
        calls = [message for message in self.received(channel) if message.kind in CALLS]
        assert len(calls) == 1, f"{channel} was asked {calls}"
        return calls[0]

    def answer(self, channel: str, *scalars: Any, body: bytes | None = None) -> Kind:
        """Let a player answer the one call it was sent, with the usual answer or another; return its kind."""
        call = self.called(channel)
        standard, usual = self.usual(call.kind)
        self.put(channel, call.kind, call.seq, *(scalars or standard), body=usual if body is None else body)
        return call.kind

    def serve(self, *players: str) -> list[Kind]:
        """Let players answer every call, until there are no more."""
        made = []
        while channel := next(
            (channel for channel in players or ("a", "e") if self.inbox.get(channel)), None
        ):
            made.append(self.answer(channel))
        return made

    def cut(self, channel: str) -> None:
        """Break the connection of a channel."""
        self.gone.add(channel)

    def tick(self, seconds: float) -> None:
        """Let time pass, with one tick at the end; drop heartbeats."""
        self.now += seconds
        self.sessions.tick(self.now)
        for channel, inbox in self.inbox.items():
            self.inbox[channel] = [message for message in inbox if message.kind is not Kind.HEARTBEAT]

    def wait(self, seconds: float) -> None:
        """Let time pass, without a tick; do what is due meanwhile, in its order."""
        until = self.now + seconds
        while self.due and min(time for time, _ in self.due) <= until:
            first = min(self.due, key=lambda one: one[0])
            self.due.remove(first)
            self.now = first[0]
            first[1](self.now)
        self.now = until

    def lose(self, channel: str) -> None:
        """Break the connection of a channel, and wait until the hub gives it up."""
        self.cut(channel)
        self.tick(CONFIG.heartbeat)
        self.tick(CONFIG.timeout)


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.fill()
    return rig


@pytest.fixture
def playing(rig: Rig) -> Rig:
    """In the middle of an RL_episode: the environment is asked for a step."""
    assert rig.carry_out(Kind.RL_INIT, 1, None) == [Kind.ENV_INIT, Kind.AGENT_INIT]
    rig.received("x")
    rig.ask(Kind.RL_EPISODE, 2, 0)
    assert rig.answer("e") is Kind.ENV_START
    assert rig.answer("a") is Kind.AGENT_START
    return rig


def error(messages: list[Message]) -> tuple[str, str]:
    """Return the code and the text of the only message, which must be an error."""
    (message,) = messages
    assert message.kind in (Kind.ERROR, Kind.REFUSE), message
    code, text = map(str, message.scalars)
    return code, text


def check_error(messages: list[Message], code: str, words: str) -> None:
    """Check that the only message is an error with this code, whose text has these words."""
    found, text = error(messages)
    assert found == code
    assert words in text


def notices(messages: list[Message]) -> list[tuple[str, str]]:
    return [(str(m.scalars[0]), str(m.scalars[1])) for m in messages if m.kind is Kind.NOTICE]


# Greetings


def test_hello_is_welcomed_with_what_the_hub_is_set_to() -> None:
    (welcome,) = Rig().hello("a", Role.AGENT)
    assert welcome == Message(Kind.WELCOME, "s", 0, (1, False, 1.0, 5.0, CONFIG.max_body))


UNNAMED = "the name of a session must have printable characters, and at least one"


@pytest.mark.parametrize(
    ("role", "instance", "session", "complaint"),
    [
        ("king", instance("a"), "s", f"the role must be one of {', '.join(Role)}, not 'king'"),
        ("agent", b"short", "s", "an instance must have 16 bytes, not 5"),
        *(("agent", instance("a"), name, UNNAMED) for name in ("", "a\nb")),
    ],
)
def test_a_hello_without_sense_is_refused(role: str, instance: bytes, session: str, complaint: str) -> None:
    rig = Rig()
    scalars = ((PROTOCOL_VERSION,), role, instance, "a", "test", ())
    assert error(rig.say("a", Kind.HELLO, 0, *scalars, session=session)) == (ErrorCode.MALFORMED, complaint)
    assert error(rig.say("a", Kind.HEARTBEAT, 0, session=session))[0] == ErrorCode.UNKNOWN_PEER


def test_sessions_are_limited_and_a_freed_one_is_given_to_the_next() -> None:
    rig = Rig()
    for n in range(CONFIG.max_sessions):
        assert rig.hello(f"r{n}", Role.AGENT, session=f"s{n}")[0].kind is Kind.WELCOME
    told = error(rig.hello("late", Role.AGENT, session="late"))
    assert told == (ErrorCode.FULL, "this hub serves 8 sessions at once, and all are in use")
    rig.say("r3", Kind.GOODBYE, 0, "enough", session="s3")
    assert rig.hello("late", Role.AGENT, session="late")[0].kind is Kind.WELCOME


def test_a_connection_leaves_three_quarters_of_the_sessions_to_others(rig: Rig) -> None:
    assert CONFIG.max_joined == 2
    rig.hello("a", Role.AGENT, session="t")
    for _ in range(2):
        check_error(rig.hello("a", Role.AGENT, session="u"), ErrorCode.FULL, "2 sessions")
    assert rig.hello("a", Role.AGENT, session="t")[0].kind is Kind.WELCOME, "it is in already"
    rig.say("a", Kind.GOODBYE, 0, "enough", session="t")
    assert rig.hello("a", Role.AGENT, session="u")[0].kind is Kind.WELCOME
    assert rig.hello("b", Role.AGENT, session="v")[0].kind is Kind.WELCOME


def test_a_role_that_is_not_open_at_an_address_cannot_be_taken_there(rig: Rig) -> None:
    rig.binds["b"] = Bind("tcp://127.0.0.1:*", frozenset({Role.AGENT}), frozenset({"s", "t"}))
    rig.say("a", Kind.GOODBYE, 0, "bye")
    for role, session in (
        (Role.ENVIRONMENT, "s"),
        (Role.EXPERIMENT, "t"),
        (Role.OBSERVER, "s"),
        (Role.AGENT, "u"),
    ):
        words = f"no {role} of session {session!r}"
        check_error(rig.hello("b", role, session=session), ErrorCode.NOT_ADMITTED, words)
    for session in ("s", "t"):
        assert rig.hello("b", Role.AGENT, session=session)[0].kind is Kind.WELCOME


def test_an_instance_opens_no_address_that_is_not_open_to_its_role(playing: Rig) -> None:
    playing.binds["b"] = Bind("tcp://127.0.0.1:*", frozenset({Role.AGENT}))
    assert error(playing.hello("b", Role.ENVIRONMENT, who="e"))[0] == ErrorCode.NOT_ADMITTED
    assert playing.answer("e") is Kind.ENV_STEP


def test_the_longest_names_and_texts_still_fit_into_every_header() -> None:
    # Each character takes four bytes; an error that quotes them must not exceed its own limit.
    wide = "\N{GRINNING FACE}" * MAX_NAME
    long = wide[:200]
    rig = Rig()
    for channel, role in (("a", Role.AGENT), ("e", Role.ENVIRONMENT), ("x", Role.EXPERIMENT)):
        scalars = ((PROTOCOL_VERSION,), str(role), instance(channel), long, wide, ())
        rig.put(channel, Kind.HELLO, 0, *scalars, session=wide)
    assert [message.kind for message in rig.received("x")] == [Kind.WELCOME, Kind.NOTICE, Kind.NOTICE]
    assert error(rig.hello("b", Role.AGENT, session=wide))[0] == ErrorCode.ROLE_TAKEN
    rig.received("a")
    rig.say("x", Kind.RL_AGENT_MESSAGE, 1, session=wide)
    (call,) = rig.received("a")
    rig.say("a", Kind.ERROR, call.seq, "exception", wide + wide, session=wide)
    assert error(rig.received("x"))[0] == ErrorCode.PEER_FAILED
    assert error(rig.hello("v", "\0" * 2000, session=wide))[0] == ErrorCode.MALFORMED


def test_when_there_is_no_room_for_more_the_session_that_keeps_most_is_ended_and_told_why() -> None:
    rig = Rig(HubConfig(max_body=100_000, max_memory=560_000, max_sessions=64))
    for n in range(6):
        for channel, role in ((f"a{n}", Role.AGENT), (f"x{n}", Role.EXPERIMENT)):
            assert rig.hello(channel, role, session=f"{n}")[0].kind is Kind.WELCOME
            rig.received(f"x{n}")
        size = 95_000 if n == 2 else 90_000
        start = Observation(chars=bytes(size - 16)).body
        rig.put(f"x{n}", Kind.RL_AGENT_START, 1, body=start, session=f"{n}")
        rig.sessions.memory.enforce()
    for n in range(6):
        ended = [m for channel in (f"x{n}", f"a{n}") for m in rig.received(channel) if m.kind is Kind.GOODBYE]
        # The fifth session ends the largest, number 2; the sixth ends number 0, the first of equals.
        assert len(ended) == (2 if n in (2, 0) else 0)
        assert all("max_memory" in str(message.scalars[0]) for message in ended)


# Exactly once


def test_a_second_hello_over_the_same_connection_is_welcomed_and_nothing_else(playing: Rig) -> None:
    assert len(playing.received("e")) == 1
    assert [message.kind for message in playing.hello("e", Role.ENVIRONMENT)] == [Kind.WELCOME]
    assert playing.received("x") == []


def resumed(messages: list[Message]) -> bool:
    """Return whether the first WELCOME received says `resumed`."""
    assert messages[0].kind is Kind.WELCOME
    return bool(messages[0].scalars[1])


@pytest.mark.parametrize("role", THREE_ROLES)
def test_an_instance_is_unknown_until_it_has_sent_something_that_only_a_welcomed_peer_can(role: Role) -> None:
    # Each WELCOME may have been lost with its connection.
    rig = Rig()
    assert not resumed(rig.hello("1", role, who="p"))
    rig.cut("1")
    assert not resumed(rig.hello("2", role, who="p"))
    assert resumed(rig.hello("2", role, who="p")), "over one connection nothing is lost"
    rig.put("2", Kind.HEARTBEAT, 5)
    rig.put("2", Kind.AGENT_STEP, 2337, body=ACTION)  # an answer to a call of another hub
    rig.cut("2")
    assert not resumed(rig.hello("3", role, who="p"))


def test_an_answer_to_a_call_that_was_dropped_shows_that_the_player_was_welcomed(rig: Rig) -> None:
    # Found by docs/model/Glue.tla: the player would forget its numbers, and carry its next call out twice.
    rig.ask(Kind.RL_INIT, 1, None)
    (call,) = rig.received("e")
    rig.lose("x")
    rig.put("e", call.kind, call.seq, body=b"spec")
    rig.cut("e")
    assert resumed(rig.hello("e2", Role.ENVIRONMENT, who="e"))


def test_a_player_that_never_answered_joins_anew_after_it_was_lost(playing: Rig) -> None:
    playing.say("a", Kind.GOODBYE, 0, "enough")
    playing.hello("new", Role.AGENT)
    playing.lose("new")
    playing.received("x")
    assert not resumed(playing.hello("new2", Role.AGENT, who="new"))
    assert notices(playing.received("x")) == [("joined", "agent")]


def test_a_peer_whose_queue_was_full_gets_what_it_missed_when_there_is_room(playing: Rig) -> None:
    playing.full.add("a")
    assert playing.answer("e") is Kind.ENV_STEP
    playing.tick(1.0)
    assert playing.received("a") == []
    playing.full.clear()
    playing.tick(1.0)
    assert [message.kind for message in playing.received("a")] == [Kind.AGENT_STEP]


def test_an_experiment_whose_queue_was_full_gets_its_reply_when_there_is_room(rig: Rig) -> None:
    rig.ask(Kind.RL_AGENT_MESSAGE, 1)
    rig.full.add("x")
    rig.serve()
    rig.tick(1.0)
    rig.full.clear()
    rig.tick(1.0)
    assert [message.kind for message in rig.received("x")] == [Kind.RL_AGENT_MESSAGE]


def test_a_player_that_does_not_answer_is_mentioned_again_and_again_ever_more_rarely(playing: Rig) -> None:
    playing.logged.clear()
    for _ in range(200):
        playing.tick(1.0)
    expected = [f"environment e has not answered env_step for {seconds} s" for seconds in (5, 30, 180)]
    assert playing.logged == [f"session 's': {line}" for line in expected]
    shown = [m.scalars for m in playing.received("x") if m.kind is Kind.NOTICE]
    assert [f"{role!s} {text!s}" for event, role, text in shown if event == "slow"] == expected
    playing.logged.clear()
    playing.answer("e")
    playing.tick(1.0)
    playing.tick(4.0)
    assert playing.logged == [], "the next call has a time of its own"
    playing.tick(1.0)
    assert "agent a has not answered agent_step for 5 s" in playing.logged[0]


def test_a_player_may_say_once_why_its_answer_takes_long(playing: Rig) -> None:
    playing.received("x")
    playing.logged.clear()
    (call,) = playing.inbox["e"]
    for seq, channel in ((call.seq + 1, "e"), (call.seq, "a"), (call.seq, "x")):
        playing.put(channel, Kind.NOTICE, seq, "slow", "environment", "nothing")
    assert playing.logged == []
    assert playing.received("x") == []
    assert playing.received("a") == []
    for _ in range(2):
        playing.put("e", Kind.NOTICE, call.seq, "slow", "environment", "compiling\n12 s")
    shown = ("slow", "environment", "e: compiling 12 s")
    assert [(m.kind, m.scalars) for m in playing.received("x")] == [(Kind.NOTICE, shown)]
    assert playing.logged == ["session 's': environment e: compiling 12 s"]
    for _ in range(40):
        playing.tick(1.0)
    assert playing.logged[1:] == ["session 's': environment e has not answered env_step for 30 s"]
    assert playing.answer("e") is Kind.ENV_STEP
    assert playing.answer("a") is Kind.AGENT_STEP


def test_an_empty_role_is_not_slow(rig: Rig) -> None:
    rig.say("a", Kind.GOODBYE, 0, "enough")
    rig.ask(Kind.RL_AGENT_MESSAGE, 1)
    rig.logged.clear()
    for _ in range(60):
        rig.tick(1.0)
    assert rig.logged == []


# Lost and replaced


@pytest.mark.parametrize("lost", ["a", "e"])
def test_a_player_unreachable_beyond_the_timeout_makes_the_episode_void(playing: Rig, lost: str) -> None:
    playing.cut(lost)
    playing.tick(CONFIG.heartbeat)
    playing.tick(CONFIG.timeout - 0.1)
    assert playing.received("x") == []
    playing.tick(0.1)
    notice, failed = playing.received("x")
    assert notices([notice]) == [("lost", "agent" if lost == "a" else "environment")]
    check_error([failed], ErrorCode.PEER_LOST, f"{lost} was unreachable for 5.0 s")


def test_a_late_answer_to_a_void_episode_changes_nothing(playing: Rig) -> None:
    (call,) = playing.received("e")
    playing.lose("a")
    playing.received("x")
    scalars, body = ANSWERS[call.kind]
    assert playing.say("e", call.kind, call.seq, *scalars, body=body) == []
    check_error(playing.say("x", Kind.RL_STEP, 3), ErrorCode.PEER_LOST, "start another")


def test_a_player_that_returns_is_not_asked_for_a_capability_it_lacks(rig: Rig) -> None:
    rig.lose("e")
    rig.received("x")
    rig.ask(Kind.RL_INIT, 1, 5)
    _, call = rig.hello("e2", Role.ENVIRONMENT, who="e")
    assert call.kind is Kind.ENV_INIT


def test_a_player_unreachable_just_now_is_replaced_without_waiting(playing: Rig) -> None:
    playing.cut("a")
    assert playing.hello("b", Role.AGENT)[0].kind is Kind.WELCOME
    lost, failed, joined = playing.received("x")
    assert notices([lost, joined]) == [("lost", "agent"), ("joined", "agent")]
    assert error([failed])[0] == ErrorCode.PEER_LOST


# Messages out of place


def test_a_known_peer_is_unknown_in_other_sessions(rig: Rig) -> None:
    assert error(rig.say("a", Kind.HEARTBEAT, session="t"))[0] == ErrorCode.UNKNOWN_PEER


def test_the_number_of_a_request_refused_as_busy_may_be_used_again(playing: Rig) -> None:
    assert error(playing.say("x", Kind.RL_RETURN, 50))[0] == ErrorCode.BUSY
    playing.lose("a")
    playing.received("x")
    (reply,) = playing.say("x", Kind.RL_RETURN, 50)
    assert reply.kind is Kind.RL_RETURN


def test_a_request_below_the_one_before_gets_an_error_and_a_repeated_one_none(rig: Rig) -> None:
    below = "request {} was received after {}; sequence numbers increase from 1"
    assert error(rig.say("x", Kind.RL_RETURN, 0)) == (ErrorCode.NOT_ASKED, below.format(0, 0))
    assert rig.say("x", Kind.RL_RETURN, 5)[0].kind is Kind.RL_RETURN
    assert rig.say("x", Kind.RL_RETURN, 5) == []
    assert error(rig.say("x", Kind.RL_RETURN, 4)) == (ErrorCode.NOT_ASKED, below.format(4, 5))


def test_an_answer_of_the_wrong_kind_fails_the_verb_and_names_the_player(playing: Rig) -> None:
    (call,) = playing.received("e")
    told = error(playing.say("e", Kind.ENV_START, call.seq, body=OBSERVATION))
    assert told == (ErrorCode.NOT_ASKED, "ENV_START was answered; ENV_STEP was asked")
    check_error(playing.received("x"), ErrorCode.PEER_FAILED, "environment e broke the protocol")


@pytest.mark.parametrize(
    "message",
    [
        (Kind.WELCOME, 1, True, 1.0, 1.0, 5),
        (Kind.REFUSE, "code", "text"),
        (Kind.NOTICE, "lost", "agent", "a"),
    ],
)
def test_what_only_the_hub_says_is_an_error_from_a_peer(rig: Rig, message: tuple[Any, ...]) -> None:
    kind, *scalars = message
    told = error(rig.say("a", kind, 0, *scalars))
    assert told == (ErrorCode.NOT_ASKED, f"{kind.name} is not for this agent to send")


def test_every_peer_is_told_when_the_hub_ends(rig: Rig) -> None:
    rig.hello("a", Role.AGENT, session="t")
    rig.sessions.close("SIGTERM")
    told = {channel: [(m.session, m.scalars) for m in rig.received(channel)] for channel in ("a", "e", "x")}
    s = ("s", ("SIGTERM",))
    assert told == {"a": [s, ("t", ("SIGTERM",))], "e": [s], "x": [s]}


# Anything at all

roles = st.sampled_from([*map(str, Role), "king"])
channels = st.sampled_from(["r0", "r1", "r2", "r3", "r4"])
sessions = st.sampled_from(["s", "t", "", "\N{GRINNING FACE}" * MAX_NAME])
instances = st.sampled_from([instance("1"), instance("2"), instance("3"), b""])
texts = st.sampled_from(["", "text", "\0\n", "\N{GRINNING FACE}" * 220])
names = st.sampled_from(["", "name", "\N{GRINNING FACE}" * 60])
sizes = st.sampled_from([3, 3, 2000, 100_000, 150_000])
"""Sizes of bodies: of light ones, and of some for which a session has to account."""


def sized(shape: Shape, size: int) -> bytes:
    """Return a body for a message of this shape."""
    if shape.body is Body.NONE:
        return b""
    kind = {Body.OBSERVATION: Observation, Body.ACTION: Action}.get(shape.body)
    return bytes(size) if kind is None else kind(chars=bytes(size)).body


@st.composite
def events(draw: st.DrawFn) -> tuple[Any, ...]:
    """An event: a legal message from any peer, a connection cut or restored, time, or noise."""
    what = draw(
        st.sampled_from(["hello", "hello", "answer", "answer", "answer", "say", "cut", "time", "noise"])
    )
    channel, session = draw(channels), draw(sessions)
    if what == "hello":
        abilities = draw(st.sampled_from([(), ("seed",), ("save", "seed")]))
        versions = draw(st.sampled_from([(1,), (1, 2), (2,), ()]))
        hello = (versions, draw(roles), draw(instances), draw(texts), draw(names), abilities)
        return "say", channel, Message(Kind.HELLO, session, 0, hello)
    if what == "say":
        kind, _, _, scalars, _ = draw(messages(TO_HUB))
        seq = draw(st.integers(0, 12))
        return "say", channel, Message(kind, session, seq, scalars, sized(TO_HUB[kind], draw(sizes)))
    if what == "cut":
        return "cut", channel, draw(st.booleans())
    if what == "time":
        return "time", draw(st.sampled_from([0.5, 1.0, 5.0]))
    if what == "answer":
        return what, channel, draw(sizes), draw(st.booleans())
    return what, channel


@pytest.mark.proof
@given(st.lists(events(), max_size=60))
@settings(max_examples=size(60, 2000), deadline=None)
def test_sessions_survive_any_behaviour_and_account_for_what_they_keep(story: list[tuple[Any, ...]]) -> None:
    rig = Rig(HubConfig(max_sessions=8))
    for what, *details in story:
        if what == "say":
            channel, message = details
            rig.sessions.receive(rig.channel(channel), decode(encode(message, TO_HUB), TO_HUB), rig.now)
        elif what == "answer":
            channel, size, terminal = details
            calls = [m for m in rig.inbox.get(channel, []) if m.kind in CALLS and CALLS[m.kind].callee]
            if calls:
                kind, session, seq, *_ = calls[-1]
                scalars = (1.0, terminal) if kind is Kind.ENV_STEP else ()
                answer = Message(kind, session, seq, scalars, sized(CALLS[kind].reply, size))
                rig.sessions.receive(rig.channel(channel), decode(encode(answer, TO_HUB), TO_HUB), rig.now)
        elif what == "cut":
            channel, cut = details
            (rig.gone.add if cut else rig.gone.discard)(channel)
        elif what == "time":
            rig.tick(details[0])
        else:
            rig.sessions.malformed(rig.channel(details[0]), RemoteProtocolError("noise"), rig.now)
        check_sessions(rig.sessions)
    rig.sessions.close("over")


# Losses that a returning experiment has not been notified of


def lost_while_away(rig: Rig) -> list[Any]:
    """Replace the agent by a newcomer while the experiment is away.

    Return what the experiment is told at its return: of each notice event and role, of others the kind.
    """
    rig.cut("x")
    rig.cut("a")
    rig.hello("a2", Role.AGENT)
    return gist(rig.hello("x2", Role.EXPERIMENT, "x"))


def gist(messages: list[Message]) -> list[Any]:
    return [each.scalars[:2] if each.kind is Kind.NOTICE else each.kind for each in messages]


def test_an_experiment_that_returns_is_told_of_the_loss_behind_the_reply_that_it_may_know(rig: Rig) -> None:
    rig.carry_out(Kind.RL_INIT, 1, None)

    sent = lost_while_away(rig)
    assert sent[0] is Kind.WELCOME
    assert sent.index(Kind.RL_INIT) < sent.index(("lost", "agent")) < len(sent) - 1
    assert sent[-1] == ("joined", "agent")


def test_a_loss_in_a_request_is_told_before_its_reply(playing: Rig) -> None:
    sent = lost_while_away(playing)
    assert sent.index(("lost", "agent")) < sent.index(Kind.ERROR)


def test_a_loss_is_told_until_the_request_after_the_next(rig: Rig) -> None:
    rig.carry_out(Kind.RL_INIT, 1, None)
    sent = lost_while_away(rig)
    for seq in (2, 3):
        assert ("lost", "agent") in sent
        rig.put(f"x{seq}", Kind.RL_NUM_STEPS, seq)
        rig.cut(f"x{seq}")
        sent = gist(rig.hello(f"x{seq + 1}", Role.EXPERIMENT, "x"))
    assert ("lost", "agent") not in sent

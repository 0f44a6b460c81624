"""What a client says and does, in dialogues with a hub in memory.

That each call is carried out once, whatever happens to connections, is judged by the kit for clients: see
tests/glue/conform/test_own_clients.py. Here is what the kit cannot see: several sessions over one connection,
errors as exceptions, and what is logged.
"""

from __future__ import annotations

import logging
import platform
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from glue.client.experiment import RemoteExperiment, connect
from glue.client.players import serve_agent, serve_environment
from glue.console import LOG
from glue.errors import (
    ConfigError,
    GlueError,
    HubClosed,
    HubUnreachable,
    LocalProtocolError,
    PeerFailed,
    PeerLost,
    Refused,
    Unsupported,
)
from glue.hub.sessions import INSTANCE_SIZE
from glue.types import Action, Observation
from glue.wire.messages import ErrorCode, Kind, Message, Role
from tests.glue.client.dialogue import HEARTBEAT, Dialogue, Script, experiment, greet, serve
from tests.players import ScriptedAgent, ScriptedEnvironment, SeededAgent, failing

SHOWN = Observation(ints=[3]).body


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> Iterator[list[str]]:
    """The lines logged by the client under test."""
    logged: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: logged.append(record.getMessage())  # type: ignore[method-assign]
    LOG.addHandler(handler)
    with caplog.at_level(logging.INFO, LOG.name):
        yield logged
    LOG.removeHandler(handler)


# Greetings


def test_hello_says_who_speaks_and_what_it_can_do() -> None:
    def hub(hub: Dialogue) -> Script:
        hello = yield from hub.welcome()
        versions, role, instance, name, codec, abilities = hello.scalars
        assert (versions, role, name, abilities) == ((1,), "agent", "SeededAgent", ("seed",))
        assert codec == f"Python {platform.python_version()}"
        assert len(instance) == INSTANCE_SIZE

    assert greet(hub, {"default": SeededAgent()}) == "the test is over"


def test_a_refusal_is_an_error_with_the_hubs_reason() -> None:
    def hub(hub: Dialogue) -> Script:
        yield Kind.HELLO
        hub.say(Kind.REFUSE, 0, "role-taken", "there is one\r\x1b[2J\nError: forged")

    with pytest.raises(Refused, match=r"refused this environment: there is one \?\[2J Error: forged"):
        greet(hub, {"default": ScriptedEnvironment()}, Role.ENVIRONMENT)


def test_a_hub_that_does_not_answer_is_greeted_once_and_mentioned(lines: list[str]) -> None:
    def hub(hub: Dialogue) -> Script:
        hello = yield Kind.HELLO
        hub.say_later(30.0, Message(Kind.WELCOME, "default", hello.seq, (1, False, 1.0, 10.0, 10_000)))
        yield Kind.HEARTBEAT

    greet(hub, {"default": ScriptedAgent()})
    assert lines[0].startswith("no hub answers at tcp://hub:1 yet")
    assert "glue-hub" in lines[0]
    assert lines[1] == "the hub at tcp://hub:1 is there"


def silent(hub: Dialogue) -> Script:
    while True:
        yield None


def test_a_hub_that_never_answers_is_given_up_after_the_time_allowed() -> None:
    with pytest.raises(HubUnreachable, match=r"tcp://hub:1 for 30 s"):
        greet(silent, {"default": ScriptedAgent()}, wait=30.0)
    assert 0 < (connect.__kwdefaults__ or {})["wait"] < 60


def test_a_hub_that_has_answered_may_be_away_for_longer_than_the_time_allowed() -> None:
    def hub(hub: Dialogue) -> Script:
        yield from hub.welcome()
        yield Kind.HEARTBEAT
        hub.reconnect()
        hello = yield Kind.HELLO
        hub.say_later(99.0, Message(Kind.WELCOME, "default", hello.seq, (1, False, 1.0, 10.0, 10_000)))
        yield Kind.HEARTBEAT

    greet(hub, {"default": ScriptedAgent()}, wait=30.0)


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), float("-inf"), 0.0])
def test_a_hub_whose_times_are_none_is_listened_to_all_the_same(seconds: float) -> None:
    def hub(hub: Dialogue) -> Script:
        hello = yield Kind.HELLO
        hub.say(Kind.WELCOME, hello.seq, 1, False, seconds, seconds, 10_000)
        yield Kind.HEARTBEAT

    greet(hub, {"default": ScriptedAgent()})


def test_a_client_that_hears_a_heartbeat_of_the_hub_sends_none_of_its_own() -> None:
    def hub(hub: Dialogue) -> Script:
        for second in range(1, 6):
            hub.say_later(second * HEARTBEAT, Message(Kind.HEARTBEAT, "", 0))
        yield Kind.HEARTBEAT
        assert hub.now == 7 * HEARTBEAT

    serve(hub, ScriptedAgent())


@pytest.mark.parametrize(
    ("hub", "how", "words"),
    [
        ("tcp://127.0.0.1:9", {"wait": -1.0}, "0 or more"),
        ("tcp://127.0.0.1:9", {"wait": float("nan")}, "0 or more"),
        ("tcp://127.0.0.1:9", {"session": "a\nb"}, "session"),
        ("localhost", {}, "localhost"),
        ("tcp://no-such-host.invalid:4097", {}, "no-such-host.invalid"),
        (f"tcp://{'a' * 300}:4097", {}, "a" * 300),
    ],
)
def test_a_mistake_in_the_arguments_is_an_error_before_anything_is_sent(
    hub: str, how: dict[str, Any], words: str, lines: list[str]
) -> None:
    with pytest.raises(ConfigError, match=words):
        serve_environment(ScriptedEnvironment(), hub, **how)
    with pytest.raises(ConfigError, match=words):
        connect(hub, **how)
    assert lines == []


# Several sessions over one connection


def test_a_peer_unknown_in_one_session_greets_the_hub_in_all() -> None:
    # One session may be so busy that the connection is never idle; the others must not be forgotten.
    def hub(hub: Dialogue) -> Script:
        hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first", session="b")
        for session in "ab":
            hello = yield Kind.HELLO
            assert hello.session == session

    serve(hub, {"a": ScriptedAgent(), "b": ScriptedAgent()})


def test_each_session_has_its_own_player_and_its_own_count() -> None:
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}

    def hub(hub: Dialogue) -> Script:
        steps = [("a", 2), ("b", 7), ("a", 2), ("b", 7), ("a", 3), ("b", 8)]
        hub.say(Kind.AGENT_STEP, 6, 1.0, body=SHOWN, session="a")
        yield Kind.AGENT_STEP
        for session, seq in [(session, seq + 10) for session, seq in steps]:
            hub.say(Kind.AGENT_STEP, seq, 1.0, body=SHOWN, session=session)
        for session, seq in steps:
            answer = yield Kind.AGENT_STEP
            assert answer[1:3] == (session, seq + 10)
        hub.say(Kind.AGENT_STEP, 11, 1.0, body=SHOWN, session="b")  # outdated there
        yield from hub.call(Kind.AGENT_MESSAGE, 20, session="b")

    serve(hub, agents)
    assert [len(agent.calls) for agent in agents.values()] == [3, 3]


def test_a_step_whose_answer_was_lost_is_not_carried_out_again_in_any_session() -> None:
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}

    def hub(hub: Dialogue) -> Script:
        first = yield from hub.call(Kind.AGENT_STEP, 7, 1.0, body=SHOWN, session="b")
        hub.reconnect()
        for session in agents:
            yield from hub.welcome(session=session)
        yield from hub.call(Kind.AGENT_MESSAGE, 1, session="a")
        again = yield from hub.call(Kind.AGENT_STEP, 7, 1.0, body=SHOWN, session="b")
        assert again == first

    serve(hub, agents)
    assert agents["b"].calls == ["agent_step 1 [3]"]


def test_a_goodbye_in_one_session_ends_the_player_and_the_others_are_told_why() -> None:
    def hub(hub: Dialogue) -> Script:
        hub.say(Kind.GOODBYE, 0, "the session was ended", session="a")
        goodbye = yield Kind.GOODBYE
        assert goodbye.session == "b"
        assert "another session: the session was ended" in str(goodbye.scalars[0])

    assert serve(hub, {"a": ScriptedAgent(), "b": ScriptedAgent()}) == "the session was ended"


# Mistakes of a user's player


def fail(error: Exception) -> tuple[list[Message], PeerFailed]:
    """Return what the hub is told of an exception, and the error that `serve_agent` raises."""
    told = []

    def hub(hub: Dialogue) -> Script:
        hub.say(Kind.AGENT_STEP, 7, 1.0, body=SHOWN)
        for kind in (Kind.ERROR, Kind.GOODBYE):
            told.append((yield kind))

    with pytest.raises(PeerFailed) as caught:
        serve(hub, ScriptedAgent(before=failing("agent_step", error)))
    assert len(told) == 2
    return told, caught.value


def test_an_exception_in_one_of_several_sessions_is_told_there_and_all_others_are_answered() -> None:
    def hub(hub: Dialogue) -> Script:
        for session, seq in (("a", 1), ("a", 2), ("b", 7)):
            hub.say(Kind.AGENT_STEP, seq, 1.0, body=SHOWN, session=session)
        for seq in (1, 2):
            answer = yield Kind.AGENT_STEP
            assert answer.seq == seq
        error = yield Kind.ERROR
        assert error[1:3] == ("b", 7)

    fails = ScriptedAgent(before=failing("agent_step", ValueError("no")))
    with pytest.raises(PeerFailed, match="agent_step"):
        serve(hub, {"a": ScriptedAgent(), "b": fails, "c": ScriptedAgent()})


def test_an_exception_is_told_in_a_few_words_and_shown_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    cause = ValueError("no such thing")
    (error, goodbye), raised = fail(cause)
    assert (error.seq, error.scalars) == (7, (ErrorCode.EXCEPTION, "ValueError: no such thing"))
    assert goodbye.scalars == ("ValueError in agent_step",)
    assert str(raised) == "agent ScriptedAgent raised in agent_step: ValueError: no such thing"
    assert raised.__cause__ is cause
    shown = capsys.readouterr().err
    assert "Traceback" in shown
    assert "raise error" in shown


def test_an_error_of_ours_is_told_without_its_name_or_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    (error, _), _ = fail(LocalProtocolError("ints must be whole"))
    assert error.scalars[1] == "ints must be whole"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "text", ["x" * 10_000, "\N{GRINNING FACE}" * 5000, "file \udcff", "two\nlines\x1b[2J"]
)
def test_any_text_of_an_exception_can_be_told(text: str) -> None:
    (error, _), _ = fail(ValueError(text))
    assert str(error.scalars[1]).isprintable()


def test_a_call_of_a_capability_that_was_not_offered_is_a_failure() -> None:
    def hub(hub: Dialogue) -> Script:
        hub.say(Kind.AGENT_SAVE, 1)
        yield Kind.ERROR

    with pytest.raises(PeerFailed, match="the hub asked ScriptedAgent for AGENT_SAVE"):
        serve(hub, ScriptedAgent())


def test_a_player_without_a_method_is_refused_before_anything_is_sent() -> None:
    with pytest.raises(PeerFailed, match="ScriptedEnvironment is not an agent: it has no agent_start"):
        serve_agent(ScriptedEnvironment())  # type: ignore[arg-type]


# The experiment

REPLIES: dict[Kind, tuple[tuple[Any, ...], bytes]] = {
    Kind.RL_INIT: ((), b"spec"),
    Kind.RL_START: ((), SHOWN + Action(ints=[4]).body),
    Kind.RL_EPISODE: ((True,), b""),
    Kind.RL_RETURN: ((-2.5,), b""),
    Kind.RL_NUM_STEPS: ((7,), b""),
    Kind.RL_NUM_EPISODES: ((8,), b""),
    Kind.RL_ENV_MESSAGE: ((), b"any \xff bytes"),
    Kind.RL_AGENT_SAVE: ((), b"\x00\xff"),
}


def answer_all(hub: Dialogue) -> Script:
    """Reply to requests until the experiment leaves."""
    while (request := (yield None)).kind is not Kind.GOODBYE:
        scalars, body = REPLIES[request.kind]
        hub.say(request.kind, request.seq, *scalars, body=body)


def noticed(*notices: tuple[str, str, str]) -> Callable[[Dialogue], Script]:
    """Return a hub that begins with notices, and replies to all requests."""

    def hub(hub: Dialogue) -> Script:
        for notice in notices:
            hub.say(Kind.NOTICE, 0, *notice)
        yield from answer_all(hub)

    return hub


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (ErrorCode.PEER_LOST, PeerLost),
        (ErrorCode.PEER_FAILED, PeerFailed),
        (ErrorCode.UNSUPPORTED, Unsupported),
        (ErrorCode.BUSY, LocalProtocolError),
        (ErrorCode.NOT_ASKED, LocalProtocolError),
        ("a code of the future", LocalProtocolError),
    ],
)
def test_an_error_of_the_hub_is_raised_as_what_it_is(code: str, error: type[GlueError]) -> None:
    def hub(hub: Dialogue) -> Script:
        request = yield Kind.RL_STEP
        hub.say(Kind.ERROR, request.seq, code, "what happened")

    with pytest.raises(error, match=r"^what happened$") as caught:
        experiment(hub, lambda glue: glue.rl_step())
    assert caught.type is error


SLOW = ("slow", "agent", "Jumper: compiling its rules")
LOST = ("lost", "agent", "a")


def test_why_a_player_is_slow_is_logged(lines: list[str]) -> None:
    experiment(noticed(SLOW), lambda glue: glue.rl_num_steps())
    assert lines == ["agent Jumper: compiling its rules"]


def test_notices_reach_the_program(lines: list[str]) -> None:
    seen: list[tuple[str, str, str]] = []
    experiment(noticed(LOST, SLOW), lambda glue: glue.rl_num_steps(), on_notice=lambda *it: seen.append(it))
    assert seen == [LOST, SLOW]
    assert lines == []


@pytest.mark.parametrize("verb", ["rl_start", "rl_episode", "rl_agent_save"])
def test_a_player_lost_between_two_verbs_fails_the_next_that_depends_on_it(verb: str) -> None:
    def verbs(glue: RemoteExperiment) -> None:
        assert glue.rl_num_steps() == 7
        with pytest.raises(PeerLost, match="the agent a was lost between two verbs, and another is in its"):
            getattr(glue, verb)()
        getattr(glue, verb)()

    experiment(noticed(LOST, ("joined", "agent", "b")), verbs)


def test_a_player_lost_before_the_beginning_is_nobodys_loss() -> None:
    experiment(noticed(LOST), lambda glue: (glue.rl_init(), glue.rl_episode()))


def test_a_loss_that_a_verb_has_failed_of_is_told_once() -> None:
    def hub(hub: Dialogue) -> Script:
        request = yield Kind.RL_EPISODE
        hub.say(Kind.NOTICE, 0, *LOST)
        hub.say(Kind.ERROR, request.seq, ErrorCode.PEER_LOST, "it was killed")
        yield from answer_all(hub)

    def verbs(glue: RemoteExperiment) -> None:
        with pytest.raises(PeerLost, match="it was killed"):
            glue.rl_episode()
        glue.rl_episode()

    experiment(hub, verbs)


def test_an_outcome_that_was_told_is_not_asked_for_until_the_next_verb() -> None:
    def hub(hub: Dialogue) -> Script:
        for told in ((2, -3.5, 5), None):
            request = yield Kind.RL_EPISODE
            hub.say(Kind.RL_EPISODE, request.seq, *(told or (True, 1.0, 2)))
            if told:
                continue
            request = yield Kind.RL_EPISODE
            hub.say(Kind.ERROR, request.seq, ErrorCode.PEER_LOST, "it was killed")
        yield from answer_all(hub)

    def verbs(glue: RemoteExperiment) -> list[Any]:
        told = [glue.rl_episode(), glue.rl_return(), glue.rl_num_steps(), glue.rl_return()]
        told += [glue.rl_episode(), glue.rl_num_steps()]
        with pytest.raises(PeerLost):
            glue.rl_episode()
        return [*told, glue.rl_return(), glue.rl_num_steps()]

    assert experiment(hub, verbs) == [False, -3.5, 5, -3.5, True, 2, -2.5, 7]


def test_waiting_for_players_tells_who_is_missing() -> None:
    told: list[frozenset[Role]] = []

    def hub(hub: Dialogue) -> Script:
        hub.say(Kind.NOTICE, 0, "joined", "environment", "e")
        yield Kind.HEARTBEAT  # it waits
        hub.say(Kind.NOTICE, 0, "joined", "agent", "a")

    experiment(hub, lambda glue: glue.wait_for_players(told.append))
    assert told[-1:] == [frozenset({Role.AGENT})]


def test_an_experiment_can_be_given_up() -> None:
    made: list[RemoteExperiment] = []

    def hub(hub: Dialogue) -> Script:
        yield Kind.RL_STEP
        made[0].give_up("the agent could not be started")
        yield Kind.GOODBYE

    def verbs(glue: RemoteExperiment) -> None:
        made.append(glue)
        glue.rl_step()

    with pytest.raises(HubClosed, match="could not be started"):
        experiment(hub, verbs)


def test_a_request_that_cannot_be_sent_is_an_error_and_the_next_one_is_sent() -> None:
    def verbs(glue: RemoteExperiment) -> tuple[str, int]:
        with pytest.raises(LocalProtocolError, match="has 20000 bytes; the hub takes 10000"):
            glue.rl_env_message("x" * 20_000)
        with pytest.raises(LocalProtocolError, match=r"'half a pair \\ud800' is not a text that UTF-8 can"):
            glue.rl_env_message("half a pair \ud800")
        return glue.rl_env_message("any \udcff bytes"), glue.rl_num_steps()

    assert experiment(answer_all, verbs) == ("any \udcff bytes", 7)

"""A peer's side of the protocol, against a hub that a test drives by hand."""

from __future__ import annotations

import logging
import platform
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import suppress
from functools import partial
from typing import Any

import pytest
import zmq

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
from glue.types import Action, Observation, Step
from glue.wire.messages import CALLS, ErrorCode, Kind, Message, Role
from tests.players import ScriptedAgent, ScriptedEnvironment, SeededAgent
from tests.scripted.hub import HEARTBEAT, ScriptedHub

TIMEOUT = 30.0
OBSERVATION = Observation(ints=[3])


class Hub(ScriptedHub):
    """A hub with the programs that connect to it."""

    def __init__(self) -> None:
        super().__init__()
        self._programs: list[Future[Any]] = []

    def run(self, program: Callable[..., Any], *arguments: Any, **named: Any) -> Future[Any]:
        """Run a program that connects to this hub, in a thread."""
        future: Future[Any] = Future()

        def target() -> None:
            try:
                future.set_result(program(*arguments, **named))
            except BaseException as error:
                future.set_exception(error)

        threading.Thread(target=target, daemon=True).start()
        self._programs.append(future)
        return future

    def close(self) -> None:
        """Say goodbye to a peer that is still connected, and wait for the programs."""
        if self.route:
            with suppress(zmq.ZMQError):
                self.say(Kind.GOODBYE, 0, "the test is over")
        wait(self._programs, TIMEOUT)
        super().close()


def wait_for(lines: list[str]) -> None:
    """Wait until something was logged."""
    deadline = time.monotonic() + TIMEOUT
    while not lines:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def hub() -> Iterator[Hub]:
    hub = Hub()
    with hub:
        yield hub


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


def serve(hub: Hub, agent: Any) -> Future[Any]:
    """Serve an agent, and welcome it."""
    future = hub.run(serve_agent, agent, hub.url)
    hub.welcome()
    return future


def experiment(hub: Hub, verbs: Callable[[RemoteExperiment], Any], **how: Any) -> Future[Any]:
    """Run an experiment that calls `verbs`, and welcome it."""

    def program() -> Any:
        with connect(hub.url, **how) as glue:
            return verbs(glue)

    future = hub.run(program)
    hub.welcome()
    return future


# Greetings


def test_hello_says_who_speaks_and_what_it_can_do(hub: Hub) -> None:
    hub.run(serve_agent, SeededAgent(), hub.url)
    versions, role, instance, name, codec, abilities = hub.welcome().scalars
    assert (versions, role, name, abilities) == ((1,), "agent", "SeededAgent", ("seed",))
    assert codec == f"Python {platform.python_version()}"
    assert isinstance(instance, bytes)
    assert len(instance) == INSTANCE_SIZE


def test_instances_differ(hub: Hub) -> None:
    seen = set()
    for _ in range(2):
        serving = hub.run(serve_agent, ScriptedAgent(), hub.url)
        seen.add(hub.welcome().scalars[2])
        hub.say(Kind.GOODBYE, 0, "enough")
        serving.result(TIMEOUT)
    assert len(seen) == 2


def test_goodbye_ends_the_service_with_the_hubs_reason_and_has_no_answer(hub: Hub) -> None:
    serving = serve(hub, ScriptedAgent())
    hub.say(Kind.GOODBYE, 0, "the experiment is over")
    assert serving.result(TIMEOUT) == "the experiment is over"
    serve(hub, ScriptedAgent())  # whose HELLO is the next message that the hub receives


def test_an_unknown_kind_is_answered_with_an_error_and_changes_nothing(hub: Hub) -> None:
    serve(hub, ScriptedAgent())
    hub.say_unknown(999, 7)
    error = hub.hear(Kind.ERROR)
    assert (error.session, error.seq) == ("default", 7)
    assert error.scalars == (ErrorCode.UNKNOWN_KIND, "message kind 999 is not one of protocol version 1")
    assert hub.call(Kind.AGENT_INIT, 1, body=b"").seq == 1


def test_a_refusal_is_an_error_with_the_hubs_reason(hub: Hub) -> None:
    serving = hub.run(serve_environment, ScriptedEnvironment(), hub.url)
    hub.hear(Kind.HELLO)
    hub.say(Kind.REFUSE, 0, "role-taken", "there is one\r\x1b[2J\nError: forged")
    with pytest.raises(Refused, match=r"refused this environment: there is one \?\[2J Error: forged"):
        serving.result(TIMEOUT)


def test_a_hub_that_does_not_answer_is_greeted_once_and_mentioned(hub: Hub, lines: list[str]) -> None:
    serving = hub.run(serve_agent, ScriptedAgent(), hub.url)
    hello = hub.hear(Kind.HELLO)
    wait_for(lines)
    hub.say(Kind.WELCOME, hello.seq, 1, False, HEARTBEAT, 10.0, 10_000)
    assert hub.next().kind is Kind.HEARTBEAT, "no other HELLO came in between"
    hub.say(Kind.GOODBYE, 0, "enough")
    serving.result(TIMEOUT)
    assert hub.url in lines[0]
    assert "glue-hub" in lines[0]
    assert lines[1] == f"the hub at {hub.url} is there"


def test_one_hello_waits_for_a_hub_that_comes_late(hub: Hub, lines: list[str]) -> None:
    # The peer waits for many heartbeats, in each of which it could repeat its HELLO.
    hub.stop()
    hub.run(serve_agent, ScriptedAgent(), hub.url)
    wait_for(lines)
    hub.start()
    hub.welcome()
    assert hub.next().kind is Kind.HEARTBEAT, "no other HELLO was waiting"


def test_over_each_new_connection_a_hub_is_greeted_once(hub: Hub) -> None:
    hub.run(serve_agent, ScriptedAgent(), hub.url)
    first = hub.welcome()
    hub.call(Kind.AGENT_INIT, 1)
    for _ in range(2):
        hub.stop()
        hub.start()
        again = hub.welcome(resumed=True)
        assert again.scalars == first.scalars
        assert hub.call(Kind.AGENT_END, 2, 1.0).seq == 2, "nothing but heartbeats came in between"


def test_no_hub_within_the_time_allowed_is_an_error(hub: Hub) -> None:
    hub.stop()
    for program in (
        partial(serve_agent, ScriptedAgent()),
        partial(serve_environment, ScriptedEnvironment()),
        connect,
    ):
        with pytest.raises(HubUnreachable, match=f"{hub.url} for 0.1 s"):
            program(hub.url, wait=0.1)
    hub.start()


def test_a_hub_that_has_answered_may_be_away_for_longer_than_the_time_allowed(hub: Hub) -> None:
    serving = hub.run(serve_agent, ScriptedAgent(), hub.url, wait=60.0)
    hub.welcome()
    hub.stop()
    hub.start()
    hub.welcome()
    assert not serving.done()


@pytest.mark.parametrize("wait", [-1.0, float("nan")])
def test_a_time_allowed_that_is_none_is_refused(wait: float) -> None:
    with pytest.raises(ConfigError, match="0 or more"):
        connect(wait=wait)


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a" * 300])
def test_a_host_that_nobody_knows_is_an_error_at_once(host: str, lines: list[str]) -> None:
    with pytest.raises(ConfigError, match=host):
        serve_agent(ScriptedAgent(), f"tcp://{host}:4097")
    assert lines == []


@pytest.mark.parametrize(("url", "session"), [("localhost", "s"), ("tcp://127.0.0.1:9", "a\nb")])
def test_a_malformed_address_or_session_is_refused_before_anything_is_sent(url: str, session: str) -> None:
    with pytest.raises(ConfigError):
        serve_agent(ScriptedAgent(), url, session)
    with pytest.raises(ConfigError):
        connect(url, session)


# Heartbeats


def test_an_idle_peer_shows_signs_of_life_as_often_as_the_hub_wants(hub: Hub) -> None:
    serve(hub, ScriptedAgent())
    for _ in range(5):
        assert hub.next() == Message(Kind.HEARTBEAT, "default", 0)


def test_a_peer_that_the_hub_does_not_know_greets_it_as_the_same_again(hub: Hub) -> None:
    agent = ScriptedAgent()
    hub.run(serve_agent, agent, hub.url)
    hello = hub.welcome()
    hub.call(Kind.AGENT_INIT, 1, body=b"task")
    hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    assert hub.welcome(resumed=True) == hello
    hub.call(Kind.AGENT_INIT, 1, body=b"task")
    assert agent.calls == ["agent_init task"]


def test_a_peer_unknown_in_one_session_greets_the_hub_in_all(hub: Hub) -> None:
    # One session may be so busy that the connection is never idle; the others must not be forgotten.
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}
    hub.run(serve_agent, agents, hub.url)
    hub.welcome(session="a")
    hub.welcome(session="b")
    hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first", session="b")
    assert [hub.hear(Kind.HELLO).session for _ in agents] == ["a", "b"]
    hub.say(Kind.GOODBYE, 0, "enough", session="a")


# Exactly once


def test_a_call_is_carried_out_and_answered(hub: Hub) -> None:
    serve(hub, ScriptedAgent())
    answer = hub.call(Kind.AGENT_START, 1, body=OBSERVATION.body)
    assert answer == Message(Kind.AGENT_START, "default", 1, (), Action(ints=[103]).body)


def test_a_repeated_call_is_answered_alike_and_not_carried_out_again(hub: Hub) -> None:
    agent = ScriptedAgent()
    serve(hub, agent)
    first = hub.call(Kind.AGENT_STEP, 5, 1.0, body=OBSERVATION.body)
    assert hub.call(Kind.AGENT_STEP, 5, 1.0, body=OBSERVATION.body) == first
    assert agent.calls == ["agent_step 1 [3]"]


def test_an_outdated_call_is_ignored(hub: Hub) -> None:
    agent = ScriptedAgent()
    serve(hub, agent)
    hub.call(Kind.AGENT_STEP, 5, 1.0, body=OBSERVATION.body)
    hub.say(Kind.AGENT_START, 4, body=OBSERVATION.body)
    assert hub.call(Kind.AGENT_END, 6, 2.0).seq == 6
    assert agent.calls == ["agent_step 1 [3]", "agent_end 2"]


def test_a_hub_that_was_started_anew_counts_from_the_start(hub: Hub) -> None:
    agent = ScriptedAgent()
    serve(hub, agent)
    hub.call(Kind.AGENT_STEP, 5, 1.0, body=OBSERVATION.body)
    hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=False)
    assert hub.call(Kind.AGENT_INIT, 1, body=b"new").seq == 1
    assert agent.calls == ["agent_step 1 [3]", "agent_init new"]


def test_a_first_call_whose_answer_was_lost_is_not_carried_out_again(hub: Hub) -> None:
    # The hub calls a player unknown until it has an answer.
    agent = ScriptedAgent()
    serve(hub, agent)
    first = hub.call(Kind.AGENT_START, 1, body=OBSERVATION.body)
    hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=False)
    assert hub.call(Kind.AGENT_START, 1, body=OBSERVATION.body) == first
    assert agent.calls == ["agent_start [3]"]
    other = Observation(ints=[4])
    hub.say(Kind.ERROR, 0, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=False)
    hub.call(Kind.AGENT_START, 1, body=other.body)
    assert agent.calls == ["agent_start [3]", "agent_start [4]"], "another hub's call is another"


def test_each_session_has_its_own_player_and_its_own_count(hub: Hub) -> None:
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}
    hub.run(serve_agent, agents, hub.url)
    for session in agents:
        hub.welcome(session=session)
    for session, seq in (("a", 9), ("b", 1), ("a", 10)):
        hub.say(Kind.AGENT_MESSAGE, seq, body=session.encode(), session=session)
        assert hub.hear(Kind.AGENT_MESSAGE)[1:3] == (session, seq)
    assert agents["a"].calls == ["agent_message a"] * 2
    assert agents["b"].calls == ["agent_message b"]
    hub.say(Kind.GOODBYE, 0, "enough", session="a")


def test_steps_of_several_sessions_are_each_carried_out_once(hub: Hub) -> None:
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}
    hub.run(serve_agent, agents, hub.url)
    for session in agents:
        hub.welcome(session=session)
    hub.say(Kind.AGENT_MESSAGE, 1, session="a")
    hub.hear(Kind.AGENT_MESSAGE)
    steps = [("a", 2), ("b", 7), ("a", 2), ("b", 6), ("b", 7), ("a", 3), ("b", 8)]
    for session, seq in steps:
        hub.say(Kind.AGENT_STEP, seq, 1.0, body=OBSERVATION.body, session=session)
    answers = [hub.hear(Kind.AGENT_STEP) for step in steps if step != ("b", 6)]
    for session, numbers in (("a", [2, 2, 3]), ("b", [7, 7, 8])):
        mine = [answer for answer in answers if answer.session == session]
        assert sorted(answer.seq for answer in mine) == numbers
        assert mine[0].body == mine[1].body
        assert sum(call.startswith("agent_step") for call in agents[session].calls) == 2
    hub.say(Kind.GOODBYE, 0, "enough", session="a")


def test_a_step_whose_answer_was_lost_is_not_carried_out_again_in_any_of_several_sessions(hub: Hub) -> None:
    agents = {"a": ScriptedAgent(), "b": ScriptedAgent()}
    hub.run(serve_agent, agents, hub.url)
    for _ in range(2):
        for session in agents:
            hub.welcome(session=session)
        hub.say(Kind.AGENT_MESSAGE, 1, session="a")
        hub.hear(Kind.AGENT_MESSAGE)
        hub.say(Kind.AGENT_STEP, 7, 1.0, body=OBSERVATION.body, session="b")
        assert hub.hear(Kind.AGENT_STEP).session == "b"
        hub.stop()
        hub.start()
    assert sum(call.startswith("agent_step") for call in agents["b"].calls) == 1
    for session in agents:
        hub.welcome(session=session)
    hub.say(Kind.GOODBYE, 0, "enough", session="a")


# Mistakes of a user's player


class Failing(ScriptedAgent):
    """An agent that raises at its first step."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self._error = error

    def agent_step(self, reward: float, observation: Observation) -> Action:
        raise self._error


def fail(hub: Hub, error: Exception) -> tuple[Message, PeerFailed]:
    """Return the message that the hub receives about an exception, and the error raised by `serve_agent`."""
    serving = serve(hub, Failing(error))
    hub.say(Kind.AGENT_STEP, 7, 1.0, body=OBSERVATION.body)
    told = hub.hear(Kind.ERROR)
    with pytest.raises(PeerFailed) as caught:
        serving.result(TIMEOUT)
    return told, caught.value


def test_an_exception_in_one_of_several_sessions_is_told_there_and_all_others_are_answered(hub: Hub) -> None:
    agents = {"a": ScriptedAgent(), "b": Failing(ValueError("no")), "c": ScriptedAgent()}
    serving = hub.run(serve_agent, agents, hub.url)
    for session in agents:
        hub.welcome(session=session)
    for session, seq in (("a", 1), ("a", 2), ("b", 7)):
        hub.say(Kind.AGENT_STEP, seq, 1.0, body=OBSERVATION.body, session=session)
    assert [hub.hear(Kind.AGENT_STEP).seq for _ in range(2)] == [1, 2]
    assert hub.hear(Kind.ERROR)[1:3] == ("b", 7)
    with pytest.raises(PeerFailed, match="agent_step"):
        serving.result(TIMEOUT)


def test_an_exception_is_told_to_the_hub_in_a_few_words_and_shown_in_full(
    hub: Hub, capsys: pytest.CaptureFixture[str]
) -> None:
    cause = ValueError("no such thing")
    told, raised = fail(hub, cause)
    assert (told.seq, told.scalars) == (7, (ErrorCode.EXCEPTION, "ValueError: no such thing"))
    assert str(raised) == "agent Failing raised in agent_step: ValueError: no such thing"
    assert raised.__cause__ is cause
    shown = capsys.readouterr().err
    assert "Traceback" in shown
    assert "raise self._error" in shown
    assert hub.hear(Kind.GOODBYE).scalars == ("ValueError in agent_step",)


def test_an_error_of_ours_is_told_without_its_name_and_shown_without_a_traceback(
    hub: Hub, capsys: pytest.CaptureFixture[str]
) -> None:
    told, _ = fail(hub, LocalProtocolError("ints must be whole"))
    assert told.scalars[1] == "ints must be whole"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "text", ["x" * 10_000, "\N{GRINNING FACE}" * 5000, "file \udcff", "two\nlines\x1b[2J"]
)
def test_any_text_of_an_exception_can_be_told(hub: Hub, text: str) -> None:
    told, _ = fail(hub, ValueError(text))
    assert str(told.scalars[1]).isprintable()


def test_an_answer_that_the_hub_will_not_take_is_a_failure(hub: Hub) -> None:
    class Verbose(ScriptedAgent):
        def agent_message(self, message: str) -> str:
            return "x" * 20_000

    serving = serve(hub, Verbose())
    hub.say(Kind.AGENT_MESSAGE, 1)
    told = hub.hear(Kind.ERROR).scalars
    assert told == (
        ErrorCode.EXCEPTION,
        "the body of AGENT_MESSAGE has 20000 bytes; the hub takes 10000",
    )
    with pytest.raises(PeerFailed, match="agent Verbose raised in agent_message"):
        serving.result(TIMEOUT)


def test_a_call_of_a_capability_that_was_not_offered_is_a_failure(hub: Hub) -> None:
    serving = serve(hub, ScriptedAgent())
    hub.say(Kind.AGENT_SAVE, 1)
    with pytest.raises(PeerFailed, match="the hub asked ScriptedAgent for AGENT_SAVE"):
        serving.result(TIMEOUT)


def test_a_player_without_a_method_is_refused_before_anything_is_sent() -> None:
    with pytest.raises(PeerFailed, match="ScriptedEnvironment is not an agent: it has no agent_start"):
        serve_agent(ScriptedEnvironment())  # type: ignore[arg-type]


# The experiment


def answer_all(hub: Hub, replies: dict[Kind, tuple[tuple[Any, ...], bytes]]) -> None:
    """Reply to requests until the experiment leaves."""
    while (request := hub.hear(*CALLS, Kind.GOODBYE)).kind is not Kind.GOODBYE:
        scalars, body = replies[request.kind]
        hub.say(request.kind, request.seq, *scalars, body=body)


PAIR = OBSERVATION.body + Action(ints=[4]).body
REPLIES: dict[Kind, tuple[tuple[Any, ...], bytes]] = {
    Kind.RL_INIT: ((), b"spec"),
    Kind.RL_START: ((), PAIR),
    Kind.RL_STEP: ((0.5, True), PAIR),
    Kind.RL_EPISODE: ((True,), b""),
    Kind.RL_RETURN: ((-2.5,), b""),
    Kind.RL_NUM_STEPS: ((7,), b""),
    Kind.RL_NUM_EPISODES: ((8,), b""),
    Kind.RL_AGENT_MESSAGE: ((), "agént".encode()),
    Kind.RL_ENV_MESSAGE: ((), b"any \xff bytes"),
    Kind.RL_CLEANUP: ((), b""),
    Kind.RL_ENV_START: ((), OBSERVATION.body),
    Kind.RL_ENV_STEP: ((0.5, False), OBSERVATION.body),
    Kind.RL_AGENT_START: ((), Action(ints=[4]).body),
    Kind.RL_AGENT_STEP: ((), Action(ints=[5]).body),
    Kind.RL_AGENT_END: ((), b""),
    Kind.RL_AGENT_SAVE: ((), b"\x00\xff"),
    Kind.RL_AGENT_LOAD: ((), b""),
    Kind.RL_ENV_SAVE: ((), b"\x01"),
    Kind.RL_ENV_LOAD: ((), b""),
    Kind.RL_AGENT_METRICS: ((), Observation([], [0.5], b"epsilon").body),
}


def test_every_verb_asks_and_returns_what_came(hub: Hub) -> None:
    def verbs(glue: RemoteExperiment) -> list[Any]:
        glue.rl_cleanup()
        glue.rl_agent_end(1)
        glue.rl_agent_load(b"x")
        glue.rl_env_load(b"x")
        return [
            glue.rl_init(seed=3),
            glue.rl_start(),
            glue.rl_step(),
            glue.rl_episode(9),
            glue.rl_return(),
            glue.rl_num_steps(),
            glue.rl_num_episodes(),
            glue.rl_agent_message("?"),
            glue.rl_env_message("?"),
            glue.rl_env_start(),
            glue.rl_env_step(Action()),
            glue.rl_agent_start(OBSERVATION),
            glue.rl_agent_step(1, OBSERVATION),
            glue.rl_agent_save(),
            glue.rl_env_save(),
            glue.rl_agent_metrics(),
        ]

    running = experiment(hub, verbs)
    assert set(REPLIES) == {kind for kind, call in CALLS.items() if call.callee is None}
    answer_all(hub, REPLIES)
    action = Action(ints=[4])
    assert running.result(TIMEOUT) == [
        "spec",
        (OBSERVATION, action),
        Step(0.5, OBSERVATION, True, action=action),
        True,
        -2.5,
        7,
        8,
        "agént",
        "any \udcff bytes",
        OBSERVATION,
        Step(0.5, OBSERVATION, False),
        action,
        Action(ints=[5]),
        b"\x00\xff",
        b"\x01",
        {"epsilon": 0.5},
    ]


def test_bytes_that_are_no_text_survive_the_way_there_and_back(hub: Hub) -> None:
    running = experiment(hub, lambda glue: glue.rl_env_message("any \udcff bytes"))
    request = hub.hear(Kind.RL_ENV_MESSAGE)
    assert request.body == b"any \xff bytes"
    hub.say(Kind.RL_ENV_MESSAGE, request.seq)
    running.result(TIMEOUT)


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
def test_an_error_of_the_hub_is_raised_as_what_it_is(hub: Hub, code: str, error: type[GlueError]) -> None:
    running = experiment(hub, lambda glue: glue.rl_step())
    request = hub.hear(Kind.RL_STEP)
    hub.say(Kind.ERROR, request.seq, code, "what happened")
    with pytest.raises(error, match=r"^what happened$") as caught:
        running.result(TIMEOUT)
    assert caught.type is error


def test_a_repeated_or_outdated_reply_is_ignored(hub: Hub) -> None:
    running = experiment(hub, lambda glue: (glue.rl_num_steps(), glue.rl_num_steps()))
    first = hub.hear(Kind.RL_NUM_STEPS).seq
    hub.say(Kind.RL_NUM_STEPS, first, 1)
    hub.say(Kind.RL_NUM_STEPS, first, 1)
    second = hub.hear(Kind.RL_NUM_STEPS).seq
    hub.say(Kind.ERROR, first, ErrorCode.PEER_LOST, "old")
    hub.say(Kind.RL_NUM_STEPS, second, 2)
    assert running.result(TIMEOUT) == (1, 2)


def test_a_request_is_repeated_after_a_reconnect(hub: Hub) -> None:
    running = experiment(hub, lambda glue: glue.rl_num_steps())
    request = hub.hear(Kind.RL_NUM_STEPS)
    hub.say(Kind.ERROR, request.seq, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=True)
    assert hub.hear(Kind.RL_NUM_STEPS) == request
    hub.say(Kind.RL_NUM_STEPS, request.seq, 5)
    assert running.result(TIMEOUT) == 5


def test_a_welcome_that_answers_no_hello_repeats_no_request_and_forgets_nothing(hub: Hub) -> None:
    running = experiment(hub, lambda glue: (glue.rl_num_steps(), glue.rl_num_steps()))
    request = hub.hear(Kind.RL_NUM_STEPS)
    hub.say(Kind.WELCOME, 1, 1, True, HEARTBEAT, 10.0, 10_000)
    hub.say(Kind.RL_NUM_STEPS, request.seq, 5)
    following = hub.hear(Kind.RL_NUM_STEPS)
    assert following.seq == request.seq + 1, "the first was not sent again"
    hub.say(Kind.WELCOME, 1, 1, False, HEARTBEAT, 10.0, 10_000)
    hub.say(Kind.RL_NUM_STEPS, following.seq, 6)
    assert running.result(TIMEOUT) == (5, 6)


def test_a_hub_that_does_not_know_the_experiment_any_more_ends_it(hub: Hub) -> None:
    running = experiment(hub, lambda glue: (glue.rl_init(), glue.rl_step()))
    hub.say(Kind.RL_INIT, hub.hear(Kind.RL_INIT).seq)
    request = hub.hear(Kind.RL_STEP)
    hub.say(Kind.ERROR, request.seq, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=False)
    with pytest.raises(HubClosed, match="knows nothing of this experiment"):
        running.result(TIMEOUT)


def test_an_unanswered_first_request_is_sent_again_to_a_hub_that_does_not_know_it(hub: Hub) -> None:
    # The hub has nothing to forget: it has answered no request of the experiment.
    running = experiment(hub, lambda glue: glue.rl_init())
    request = hub.hear(Kind.RL_INIT)
    hub.say(Kind.ERROR, request.seq, ErrorCode.UNKNOWN_PEER, "say HELLO first")
    hub.welcome(resumed=False)
    assert hub.hear(Kind.RL_INIT) == request
    hub.say(Kind.RL_INIT, request.seq, body=b"spec")
    assert running.result(TIMEOUT) == "spec"


def test_a_request_waits_for_the_welcome_over_the_latest_connection(hub: Hub) -> None:
    # Sent directly after the HELLO, the step could reach a hub that has never seen the episode.
    def verbs(glue: RemoteExperiment) -> None:
        glue.rl_num_steps()
        waiting.set()
        glue.wait_for_players(lambda missing: None)
        glue.rl_step()

    waiting = threading.Event()
    running = experiment(hub, verbs)
    request = hub.hear(Kind.RL_NUM_STEPS)
    hub.say(Kind.RL_NUM_STEPS, request.seq, 5)
    assert waiting.wait(TIMEOUT)
    hub.stop()
    hub.start()
    hello = hub.hear(Kind.HELLO)
    for role in ("agent", "environment"):
        hub.say(Kind.NOTICE, 0, "joined", role, "p")
    hub.say(Kind.WELCOME, hello.seq - 1, 1, True, HEARTBEAT, 10.0, 10_000)
    for role in ("agent", "environment"):
        hub.say(Kind.NOTICE, 0, "joined", role, "p")
    hub.say(Kind.HEARTBEAT, 9)
    hub.say(Kind.WELCOME, hello.seq, 1, False, HEARTBEAT, 10.0, 10_000)
    with pytest.raises(HubClosed, match="knows nothing of this experiment"):
        running.result(TIMEOUT)
    assert hub.hear(Kind.GOODBYE).kind is Kind.GOODBYE, "the step was never sent"


SLOW = "Jumper: compiling its rules"


def test_why_a_player_is_slow_is_logged(hub: Hub, lines: list[str]) -> None:
    running = experiment(hub, lambda glue: glue.rl_num_steps())
    hub.say(Kind.NOTICE, 0, "slow", "agent", SLOW)
    answer_all(hub, REPLIES)
    running.result(TIMEOUT)
    assert lines == [f"agent {SLOW}"]


def test_goodbye_of_the_hub_ends_the_verb(hub: Hub) -> None:
    running = experiment(hub, lambda glue: glue.rl_step())
    hub.hear(Kind.RL_STEP)
    hub.say(Kind.GOODBYE, 0, "SIGTERM")
    with pytest.raises(HubClosed, match=r"^SIGTERM$"):
        running.result(TIMEOUT)


def test_notices_reach_the_program(hub: Hub, lines: list[str]) -> None:
    seen: list[tuple[str, str, str]] = []
    running = experiment(hub, lambda glue: glue.rl_num_steps(), on_notice=lambda *notice: seen.append(notice))
    hub.say(Kind.NOTICE, 0, "lost", "agent", "its name")
    hub.say(Kind.NOTICE, 0, "slow", "agent", SLOW)
    answer_all(hub, REPLIES)
    running.result(TIMEOUT)
    assert seen == [("lost", "agent", "its name"), ("slow", "agent", SLOW)]
    assert lines == []


@pytest.mark.parametrize("kind", [Kind.RL_START, Kind.RL_EPISODE, Kind.RL_AGENT_SAVE])
def test_a_player_lost_between_two_verbs_fails_the_next_that_depends_on_it(hub: Hub, kind: Kind) -> None:
    verbs: dict[Kind, Callable[[RemoteExperiment], Any]] = {
        Kind.RL_START: lambda glue: glue.rl_start(),
        Kind.RL_EPISODE: lambda glue: glue.rl_episode(),
        Kind.RL_AGENT_SAVE: lambda glue: glue.rl_agent_save(),
    }

    def program(glue: RemoteExperiment) -> None:
        assert glue.rl_num_steps() == 7
        with pytest.raises(PeerLost, match="the agent a was lost between two verbs, and another is in its"):
            verbs[kind](glue)
        verbs[kind](glue)

    running = experiment(hub, program)
    hub.say(Kind.NOTICE, 0, "lost", "agent", "a")
    hub.say(Kind.NOTICE, 0, "joined", "agent", "b")
    answer_all(hub, REPLIES)
    running.result(TIMEOUT)


def test_an_outcome_that_was_told_is_not_asked_for_until_the_next_verb(hub: Hub) -> None:
    def program(glue: RemoteExperiment) -> list[Any]:
        told = [glue.rl_episode(), glue.rl_return(), glue.rl_num_steps(), glue.rl_return()]
        return [*told, glue.rl_num_episodes(), glue.rl_return(), glue.rl_num_steps()]

    running = experiment(hub, program)
    request = hub.hear(Kind.RL_EPISODE)
    hub.say(Kind.RL_EPISODE, request.seq, 2, -3.5, 5)
    answer_all(hub, REPLIES)
    assert running.result(TIMEOUT) == [False, -3.5, 5, -3.5, 8, -2.5, 7]


def test_an_older_hub_is_asked_for_return_and_steps(hub: Hub) -> None:
    running = experiment(hub, lambda glue: (glue.rl_episode(), glue.rl_return(), glue.rl_num_steps()))
    answer_all(hub, REPLIES)
    assert running.result(TIMEOUT) == (True, -2.5, 7)


def test_an_outcome_is_forgotten_when_the_next_episode_fails(hub: Hub) -> None:
    def program(glue: RemoteExperiment) -> float:
        glue.rl_episode()
        with pytest.raises(PeerLost):
            glue.rl_episode()
        return glue.rl_return()

    running = experiment(hub, program)
    hub.say(Kind.RL_EPISODE, hub.hear(Kind.RL_EPISODE).seq, True, -3.5, 5)
    hub.say(Kind.ERROR, hub.hear(Kind.RL_EPISODE).seq, ErrorCode.PEER_LOST, "it was killed")
    answer_all(hub, REPLIES)
    assert running.result(TIMEOUT) == -2.5


def test_a_player_lost_before_the_beginning_is_nobodys_loss(hub: Hub) -> None:
    def program(glue: RemoteExperiment) -> None:
        glue.rl_init()
        glue.rl_episode()

    running = experiment(hub, program)
    hub.say(Kind.NOTICE, 0, "lost", "agent", "a")
    answer_all(hub, REPLIES)
    running.result(TIMEOUT)


def test_a_loss_that_a_verb_has_failed_of_is_told_once(hub: Hub) -> None:
    def program(glue: RemoteExperiment) -> None:
        with pytest.raises(PeerLost, match="it was killed"):
            glue.rl_episode()
        glue.rl_episode()

    running = experiment(hub, program)
    request = hub.hear(Kind.RL_EPISODE)
    hub.say(Kind.NOTICE, 0, "lost", "agent", "a")
    hub.say(Kind.ERROR, request.seq, ErrorCode.PEER_LOST, "it was killed")
    answer_all(hub, REPLIES)
    running.result(TIMEOUT)


def test_waiting_for_players_tells_who_is_missing(hub: Hub) -> None:
    told: list[frozenset[Role]] = []

    def verbs(glue: RemoteExperiment) -> None:
        glue.wait_for_players(told.append)

    running = experiment(hub, verbs)
    hub.say(Kind.NOTICE, 0, "joined", "environment", "e")
    assert hub.next().kind is Kind.HEARTBEAT, "it waits"
    hub.say(Kind.NOTICE, 0, "joined", "agent", "a")
    running.result(TIMEOUT)
    assert told[-1:] == [frozenset({Role.AGENT})]


def test_an_experiment_can_be_given_up_from_another_thread(hub: Hub) -> None:
    made: list[RemoteExperiment] = []

    def verbs(glue: RemoteExperiment) -> None:
        made.append(glue)
        glue.rl_step()

    running = experiment(hub, verbs)
    hub.hear(Kind.RL_STEP)
    made[0].give_up("the agent could not be started")
    with pytest.raises(HubClosed, match="could not be started"):
        running.result(TIMEOUT)


def test_a_request_too_large_is_not_sent_and_the_next_one_is(hub: Hub) -> None:
    def verbs(glue: RemoteExperiment) -> int:
        with pytest.raises(LocalProtocolError, match="has 20000 bytes; the hub takes 10000"):
            glue.rl_env_message("x" * 20_000)
        return glue.rl_num_steps()

    running = experiment(hub, verbs)
    answer_all(hub, REPLIES)
    assert running.result(TIMEOUT) == 7


def test_a_text_that_utf_8_cannot_carry_is_a_local_error(hub: Hub) -> None:
    def verbs(glue: RemoteExperiment) -> None:
        glue.rl_env_message("half a pair \ud800")

    running = experiment(hub, verbs)
    with pytest.raises(LocalProtocolError, match=r"'half a pair \\ud800' is not a text that UTF-8 can carry"):
        running.result(TIMEOUT)


def test_a_hub_that_never_answers_is_given_up_by_default() -> None:
    assert 0 < (connect.__kwdefaults__ or {})["wait"] < 60

"""Programs that die, stall or break the protocol: the effect on their session, and none on any other."""

from __future__ import annotations

import re
import struct
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np
import pytest

from glue import Action, HubClosed, LocalProtocolError, Observation, PeerFailed, PeerLost
from glue.client.experiment import RemoteExperiment
from glue.hub.channel import Channel
from glue.hub.config import HubConfig, LegacyPort
from glue.hub.io.server import Hub
from glue.legacy.experiment import LegacyExperiment
from glue.legacy.gateway import Gateway
from glue.legacy.peers import LegacyPlayer
from glue.wire.messages import Kind, Message
from tests import weighing
from tests.players import At, ScriptedAgent, ScriptedEnvironment
from tests.system.conformance import SCENARIOS, FiveStepEnvironment, MirrorAgent
from tests.system.legacy.legacy_client import TIMEOUT, Closed, Connection, Die, Id, OriginalExperiment, pack
from tests.system.legacy.legacy_rig import Log, Rig, gateway

ROLES = (Id.AGENT_CONNECTION, Id.ENVIRONMENT_CONNECTION, Id.EXPERIMENT_CONNECTION)
EMPTY = pack(Action())
TERMINATE = struct.pack(">iI", Id.RL_TERM, 0)


def join(rig: Rig, role: Id, session: str = "default") -> Connection:
    """Return the connection of a program driven by hand."""
    connection = rig.connect(session=session)
    connection.send(role)
    return connection


def ending(connection: Connection) -> bytes:
    """Return the bytes received until the server closes, and close as well."""
    with closing(connection):
        return connection.receive_until_closed()


def assert_reset(connection: Connection) -> None:
    """Check that the server reset the connection, rather than merely closed it."""
    with closing(connection), pytest.raises(ConnectionResetError):
        connection.receive_until_closed()


def run_test_1(rig: Rig) -> None:
    """Let an original trio show that everything works."""
    rig.originals(MirrorAgent(), FiveStepEnvironment())
    with rig.experiment() as glue:
        SCENARIOS["test_1"].run(glue)
    rig.join()


def die() -> NoReturn:
    raise Die


STEPS = ("agent_step", "env_step")


def let_die(rig: Rig, step: str) -> None:
    """Let two original players play, of which one dies in its third step."""
    before = At(step, 3, die)
    rig.originals(ScriptedAgent(before=before), ScriptedEnvironment(5, before=before))


def send_another(rig: Rig, step: str) -> None:
    """Let a healthy player replace the one that died."""
    rig.originals(ScriptedAgent() if step == "agent_step" else ScriptedEnvironment(5))


@pytest.mark.parametrize("step", STEPS)
def test_an_episode_is_run_again_when_a_player_was_lost_and_replaced(rig: Rig, step: str) -> None:
    let_die(rig, step)
    glue = rig.experiment()
    glue.rl_init()
    glue.connection.send(Id.RL_EPISODE, struct.pack(">I", 0))
    rig.log.wait_for("to begin RL_EPISODE again")
    send_another(rig, step)
    assert glue.connection.receive() == (Id.RL_EPISODE, struct.pack(">i", 1))
    assert (glue.rl_num_steps(), glue.rl_num_episodes(), glue.rl_return()) == (5, 1, 5.0)


@pytest.mark.parametrize("step", STEPS)
def test_an_experiment_that_makes_its_own_steps_is_cut_off_and_the_other_player_stays(
    rig: Rig, step: str
) -> None:
    let_die(rig, step)
    glue = rig.experiment()
    glue.rl_init()
    glue.rl_start()
    assert glue.rl_step().terminal == glue.rl_step().terminal == 0
    with pytest.raises(ConnectionResetError):
        glue.rl_step()
    rig.log.wait_for("was cut off: its protocol cannot say that RL_STEP failed")
    send_another(rig, step)
    play(rig)


@pytest.mark.parametrize("request_id", [Id.RL_INIT, Id.RL_START, Id.RL_CLEANUP, Id.RL_ENV_MESSAGE])
def test_any_call_that_can_be_made_anew_is(rig: Rig, request_id: Id) -> None:
    rig.originals(MirrorAgent())
    environment = join(rig, Id.ENVIRONMENT_CONNECTION)
    glue = rig.experiment()
    if request_id == Id.RL_ENV_MESSAGE:
        glue.connection.send_text(request_id, "who are you?")
    else:
        glue.connection.send(request_id)
    environment.receive()
    environment.reset()
    rig.originals(FiveStepEnvironment())
    assert glue.connection.receive()[0] == request_id


ONE = pack(Action([1]))


def void_the_start(rig: Rig, observation: bytes = ONE) -> tuple[Connection, Connection, OriginalExperiment]:
    """Return agent, environment, experiment: the agent is still at work on a start that was made again."""
    agent, environment = join(rig, Id.AGENT_CONNECTION), join(rig, Id.ENVIRONMENT_CONNECTION)
    glue = rig.experiment()
    glue.connection.send(Id.RL_START)
    environment.receive()
    environment.send(Id.ENV_START, EMPTY)
    assert agent.receive() == (Id.AGENT_START, EMPTY)
    environment.close()
    rig.log.wait_for("to begin RL_START again")
    environment = join(rig, Id.ENVIRONMENT_CONNECTION)
    assert environment.receive()[0] == Id.ENV_START
    environment.send(Id.ENV_START, observation)
    rig.settle()
    assert agent.nothing_received()
    return agent, environment, glue


def test_an_agent_that_still_thinks_about_a_void_step_is_sent_nothing_until_it_has_answered(rig: Rig) -> None:
    """And the call that had to wait is kept no longer than the session keeps it."""
    large = pack(Action([1] * 30_000))
    agent, environment, glue = void_the_start(rig, large)
    agent.send(Id.AGENT_START, ONE)
    assert agent.receive() == (Id.AGENT_START, large)
    agent.send(Id.AGENT_START, EMPTY)
    assert glue.connection.receive() == (Id.RL_START, large + EMPTY)
    glue.connection.send(Id.RL_STEP)
    assert environment.receive() == (Id.ENV_STEP, EMPTY)
    environment.send(Id.ENV_STEP, struct.pack(">id", 0, 0.0) + ONE)
    assert agent.receive()[0] == Id.AGENT_STEP
    agent.send(Id.AGENT_STEP, EMPTY)
    assert glue.connection.receive()[0] == Id.RL_STEP
    rig.settle()
    weighing.check(rig.hub)
    glue.close()
    for player in (agent, environment):
        assert ending(player) == TERMINATE


def test_what_was_to_be_asked_next_is_forgotten_when_the_experiment_leaves(rig: Rig) -> None:
    agent, environment, glue = void_the_start(rig)
    glue.close()
    assert ending(environment) == TERMINATE
    rig.settle()
    assert agent.nothing_received()
    agent.send(Id.AGENT_START, EMPTY)
    assert ending(agent) == TERMINATE


def test_an_experiment_that_died_in_a_call_is_noticed_at_once_and_another_may_join(rig: Rig) -> None:
    agent = join(rig, Id.AGENT_CONNECTION)
    glue = rig.experiment()
    glue.connection.send(Id.RL_AGENT_START, EMPTY)
    assert agent.receive() == (Id.AGENT_START, EMPTY)
    glue.close()
    rig.log.wait_for("it has closed its connection during RL_AGENT_START")
    run_test_1(rig)
    agent.send(Id.AGENT_START, EMPTY)
    assert ending(agent) == TERMINATE


@pytest.mark.parametrize(("requests", "end"), [(0, "close"), (0, "reset"), (100_000, "reset")])
def test_an_experiment_that_leaves_while_no_player_can_answer_is_noticed_at_once(
    rig: Rig, requests: int, end: str
) -> None:
    glue = rig.experiment()
    glue.connection.send(Id.RL_INIT)
    glue.connection.flood(struct.pack(">iI", Id.RL_NUM_STEPS, 0) * requests)
    rig.settle()
    getattr(glue.connection, end)()
    rig.log.wait_for("it has closed its connection during RL_INIT")
    run_test_1(rig)


def test_a_silent_connection_is_dropped_after_the_timeout() -> None:
    with gateway(timeout=0.2) as rig:
        silent, halting = rig.connect(), rig.connect()
        halting.send_raw(b"\0\0\0\2\0\0")  # a part of a frame
        for connection in (silent, halting):
            assert ending(connection) == b""
    reason = "it did not say which role it is to have"
    assert f" was dropped: {reason}" in str(rig.log)
    assert f"1 more connection was dropped: {reason}" in str(rig.log)


def test_a_port_probe_is_not_noticed_at_any_time(rig: Rig) -> None:
    rig.connect().close()
    rig.originals(MirrorAgent())
    rig.connect().close()
    rig.originals(FiveStepEnvironment())
    rig.connect().reset()
    glue = rig.experiment()
    rig.connect().close()
    glue.rl_init()
    rig.connect().close()
    assert glue.rl_episode(0) == 1
    rig.connect().reset()
    glue.close()
    rig.join()
    rig.settle()
    assert [line for line in str(rig.log).splitlines() if "aside" not in line] == [
        line for line in str(rig.log).splitlines() if "session 'default'" in line
    ]


def test_a_crowd_of_silent_connections_keeps_no_program_out_and_is_summed_up_in_the_log() -> None:
    with gateway() as rig:
        crowd = [rig.connect() for _ in range(300)]
        run_test_1(rig)
    for connection in crowd:
        connection.close()
    dropped = [line for line in str(rig.log).splitlines() if "dropped" in line]
    assert len(dropped) <= 4, "for each of two reasons the first one, and a sum"
    (summed_up,) = re.findall(r"^(\d+) more connections were dropped: 256 newer", str(rig.log), re.MULTILINE)
    assert int(summed_up) >= 300 - 256 - 1


def test_no_session_has_more_than_one_request_taken_up_in_a_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = Counter[tuple[str, float]]()
    hub = Hub(HubConfig(("tcp://127.0.0.1:*",)))
    (port,) = Gateway(hub, [LegacyPort(0)]).ports
    receive = hub.sessions.receive

    def note(channel: Channel, message: Message, now: float) -> None:
        turns[message.kind.name, now] += 1  # `now` does not change within a turn of the loop
        receive(channel, message, now)

    monkeypatch.setattr(hub.sessions, "receive", note)
    greedy = Connection(port.port)
    greedy.send(Id.EXPERIMENT_CONNECTION)
    greedy.send_raw(struct.pack(">iI", Id.RL_NUM_STEPS, 0) * 500)
    with hub.in_background(), closing(greedy):
        for _ in range(500):
            greedy.receive()
    assert sum(count for (kind, _), count in turns.items() if kind == "RL_NUM_STEPS") == 500
    assert max(turns.values()) == 1


def test_all_requests_before_a_half_close_are_answered_behind_calls_of_players_too(rig: Rig) -> None:
    rig.originals(MirrorAgent(), FiveStepEnvironment())
    glue = rig.experiment()
    glue.rl_init()
    requests = [(Id.RL_START, b""), *[(Id.RL_STEP, b"")] * 4, (Id.RL_EPISODE, struct.pack(">i", 0))] * 20
    glue.connection.send_raw(b"".join(struct.pack(">iI", kind, len(body)) + body for kind, body in requests))
    glue.connection.close_writing()
    stream = ending(glue.connection)
    kinds = []
    while stream:
        kind, size = struct.unpack_from(">iI", stream)
        kinds.append(kind)
        stream = stream[8 + size :]
    assert kinds == [kind for kind, _ in requests]
    rig.experiment().close()  # the role is free again


def test_requests_before_a_half_close_wait_for_no_player_longer_than_the_timeout() -> None:
    log = Log()
    hub = Hub(HubConfig(("tcp://127.0.0.1:*",), 0.02, 0.2), log)
    (port,) = Gateway(hub, [LegacyPort(0)], log).ports
    connection = Connection(port.port)
    connection.send(Id.EXPERIMENT_CONNECTION)
    connection.send_raw(struct.pack(">iI", Id.RL_INIT, 0) * 2)
    connection.close_writing()
    with hub.in_background():
        assert ending(connection) == b""
        log.wait_for("it has closed its connection during RL_INIT")


@pytest.mark.parametrize("role", ROLES)
def test_a_second_of_a_role_is_turned_away_and_the_first_stays(rig: Rig, role: Id) -> None:
    rig.originals(MirrorAgent(), FiveStepEnvironment())
    glue = rig.experiment()
    glue.rl_init()
    glue.rl_start()
    second = join(rig, role)
    if role == Id.EXPERIMENT_CONNECTION:
        assert_reset(second)
    else:
        assert ending(second) == TERMINATE
    rig.log.wait_for("refused a peer of session 'default'")
    assert glue.rl_step().terminal == 0
    assert glue.rl_agent_message("still there") == "still there|1.|still there"


@pytest.mark.parametrize("role", [None, *ROLES])
def test_a_program_with_an_unknown_id_is_dropped_and_others_play(rig: Rig, role: Id | None) -> None:
    liar = rig.connect() if role is None else join(rig, role)
    liar.send(99)
    if role is None:
        assert ending(liar) == b""
        rig.log.wait_for("is not an RL-Glue program")
    else:
        if role == Id.EXPERIMENT_CONNECTION:
            assert_reset(liar)
        else:
            assert ending(liar) == TERMINATE
        rig.log.wait_for("malformed")
    run_test_1(rig)


def test_a_wrong_answer_costs_its_sender_the_place_and_an_original_episode_is_run_again(rig: Rig) -> None:
    rig.ours(ScriptedEnvironment())
    liar = join(rig, Id.AGENT_CONNECTION)
    glue = rig.experiment()
    glue.connection.send(Id.RL_EPISODE, struct.pack(">I", 0))
    liar.receive()
    liar.send(Id.AGENT_START, EMPTY)
    assert liar.receive()[0] == Id.AGENT_STEP
    liar.send(Id.AGENT_END)
    assert ending(liar) == TERMINATE
    rig.originals(MirrorAgent())
    assert glue.connection.receive() == (Id.RL_EPISODE, struct.pack(">i", 1))
    assert glue.rl_num_steps() == 3


def test_an_answer_without_a_call_is_a_fault(rig: Rig) -> None:
    liar = join(rig, Id.AGENT_CONNECTION)
    liar.send(Id.AGENT_STEP, EMPTY)
    assert ending(liar) == TERMINATE
    rig.log.wait_for("received AGENT_STEP; nothing was asked")
    run_test_1(rig)


def let_our_environment_raise() -> None:
    def fall(call: str) -> None:
        if call.startswith("env_step"):
            raise LocalProtocolError("fell over")

    with gateway() as rig:
        rig.ours(ScriptedEnvironment(before=fall))
        rig.originals(MirrorAgent())
        glue = rig.experiment()
        glue.rl_init()
        glue.connection.send(Id.RL_EPISODE, struct.pack(">I", 0))
        assert_reset(glue.connection)
        rig.log.wait_for("cannot say that RL_EPISODE failed: environment ScriptedEnvironment")


def test_a_step_ends_the_wait_for_the_end_of_a_text(rig: Rig) -> None:
    rig.originals(MirrorAgent(), FiveStepEnvironment())
    with closing(join(rig, Id.EXPERIMENT_CONNECTION)) as glue:
        glue.send(Id.RL_INIT)
        glue.receive()
        glue.send(Id.RL_START)
        glue.receive()
        glue.send(Id.RL_AGENT_MESSAGE, struct.pack(">I", 2) + "é".encode())
        glue.receive()
        glue.send(Id.RL_STEP)
        glue.receive()
        glue.send_raw(8 * b"\xa9")
        with pytest.raises(ConnectionResetError):
            glue.receive()


def test_an_original_experiment_is_cut_off_when_a_player_of_ours_raises() -> None:
    with pytest.raises(PeerFailed, match="fell over"):
        let_our_environment_raise()


def test_what_an_original_experiment_cannot_be_sent_cuts_it_off(rig: Rig) -> None:
    rig.ours(LongWinded())
    glue = rig.experiment()
    glue.connection.send_text(Id.RL_AGENT_MESSAGE, "tell me")
    assert_reset(glue.connection)
    rig.log.wait_for("at most 1000000 bytes")


class LongWinded(ScriptedAgent):
    """An agent whose answer is longer than an original program may be sent."""

    def agent_message(self, message: str) -> str:
        return "x" * 1_000_001


def test_an_experiment_that_does_not_read_is_not_answered_any_further(rig: Rig) -> None:
    calls: list[str] = []
    rig.ours(BigEnvironment(calls=calls))
    glue = rig.experiment()
    count = 200
    for _ in range(count):
        glue.connection.send(Id.RL_ENV_START)
    rig.ours(ScriptedAgent(), session="other")
    with rig.native("other") as other:
        for _ in range(2 * count):
            other.rl_agent_message("how are you?")
    assert len(calls) < count // 2, "the system's own buffers hold a few megabytes"
    for _ in range(count):
        message_id, payload = glue.connection.receive()
        assert (message_id, len(payload)) == (Id.RL_ENV_START, 12 + 8 * 100_000)
    assert len(calls) == count


class BigEnvironment(ScriptedEnvironment):
    """An environment that shows 100 000 doubles."""

    def env_start(self) -> Observation:
        self._note("env_start")
        return Observation(doubles=np.zeros(100_000))


def test_a_hub_that_ends_lets_an_agent_finish_its_thought() -> None:
    begun, ended = threading.Event(), threading.Event()

    class Thinker(MirrorAgent):
        def agent_start(self, observation: Observation) -> Action:
            begun.set()
            assert ended.wait(TIMEOUT)
            return super().agent_start(observation)

    def ask(glue: RemoteExperiment) -> None:
        with glue, suppress(HubClosed):
            glue.rl_agent_start(Observation())
        ended.set()

    with gateway() as rig:
        rig.originals(Thinker())
        asking = threading.Thread(target=ask, args=(rig.native(),))
        asking.start()
        assert begun.wait(TIMEOUT)
    asking.join(TIMEOUT)


def test_a_hub_that_ends_does_not_wait_forever() -> None:
    with gateway() as rig:
        agent, experiment = join(rig, Id.AGENT_CONNECTION), join(rig, Id.EXPERIMENT_CONNECTION)
        silent = rig.connect()
        experiment.send(Id.RL_AGENT_START, EMPTY)
        agent.receive()
    assert ending(agent) == TERMINATE
    assert ending(silent) == b""
    assert_reset(experiment)


# Errors of the gateway itself, its log, and its share of the hub's memory: no other session notices them.

FAULTY = "faulty"


@pytest.fixture
def pair() -> Iterator[Rig]:
    """A hub with a session that plays, and another one without players."""
    with gateway("default", FAULTY, max_body=2**18, max_memory=2**20) as rig:
        rig.originals(MirrorAgent(), FiveStepEnvironment())
        rig.log.wait_for("joined", times=2)
        yield rig


def raise_fault(*_: object) -> None:
    raise ZeroDivisionError("a fault of the gateway")


def check_ended(connection: Connection) -> None:
    """Check that the program's connection was reset or closed."""
    with closing(connection), pytest.raises((ConnectionResetError, Closed)):
        connection.receive()


def play(rig: Rig) -> None:
    """Play an episode in the session without a fault."""
    with rig.experiment() as glue:
        glue.rl_init()
        assert glue.rl_episode(0) == 1


@pytest.mark.parametrize("role", [Id.AGENT_CONNECTION, Id.EXPERIMENT_CONNECTION])
def test_an_error_in_a_handler_costs_its_connection_and_role_alone(
    pair: Rig, role: Id, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = join(pair, role, FAULTY)
    pair.log.wait_for("joined", times=3)
    with monkeypatch.context() as patch:
        patch.setattr(LegacyPlayer if role is Id.AGENT_CONNECTION else LegacyExperiment, "_work", raise_fault)
        connection.send(Id.RL_NUM_STEPS)
        pair.log.wait_for("please report this")
    check_ended(connection)
    pair.log.wait_for("was dropped after an error of the hub", times=2)  # its connection, and its role
    assert "ZeroDivisionError: a fault of the gateway" in str(pair.log)
    play(pair)


def test_an_error_in_a_delivery_costs_the_receiver_and_not_the_sender(
    pair: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    deliver = LegacyPlayer._take

    def take(player: LegacyPlayer, message: Message) -> bool:
        if message.session == FAULTY and message.kind is Kind.AGENT_MESSAGE:
            raise_fault()
        return deliver(player, message)

    monkeypatch.setattr(LegacyPlayer, "_take", take)
    agent = join(pair, Id.AGENT_CONNECTION, FAULTY)
    pair.log.wait_for("joined", times=3)
    with pair.native(FAULTY) as experiment:
        # All have joined; from now on the hub waits only briefly for one that cannot be reached.
        monkeypatch.setattr(
            pair.hub.sessions, "_config", replace(pair.hub.config, heartbeat=0.1, timeout=0.1)
        )
        with pytest.raises(PeerLost, match="unreachable"):
            experiment.rl_agent_message("hello")
        assert experiment.rl_num_steps() == 0
    check_ended(agent)
    play(pair)


def test_a_body_that_is_larger_than_the_hub_takes_is_a_fault(pair: Rig) -> None:
    liar = join(pair, Id.EXPERIMENT_CONNECTION, FAULTY)
    liar.send(Id.RL_AGENT_MESSAGE, struct.pack(">I", 2**18 + 1) + b"x" * (2**18 + 1))
    assert_reset(liar)
    pair.log.wait_for(f"RL_AGENT_MESSAGE has a body of {2**18 + 1} bytes; this hub takes {2**18}")
    play(pair)


def test_bytes_of_original_programs_count_and_the_largest_holder_is_dropped(pair: Rig) -> None:
    announced = 12 + 4 * 500_000
    program = join(pair, Id.EXPERIMENT_CONNECTION, FAULTY)
    with suppress(ConnectionError):  # dropped before all is sent
        program.send_raw(struct.pack(">iI", Id.RL_ENV_STEP, announced) + bytes(announced - 1))
    pair.log.wait_for("was dropped: it used 1 MiB")
    program.reset()
    play(pair)

"""Whatever comes in, the hub answers or drops it, keeps its memory, and other sessions do not notice.

A hub runs in a process of its own. Beside it a healthy session runs all the while; each test then sees
that it has gone on, and in the end its returns are those of a run without any of this.
"""

from __future__ import annotations

import os
import random
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from glue.client.experiment import connect
from glue.core.config import HubConfig
from glue.core.local import local
from glue.core.sessions import INSTANCE_SIZE
from glue.hub.router import MAX_UNSEATED
from glue.hub.server import Hub
from glue.protocol.messages import ErrorCode, Kind, Message
from glue.protocol.wire import FROM_HUB, MAX_BODY, MAX_HEADER, TO_HUB, decode, encode
from glue.protocol.zmtp import encode as encode_frames
from glue.types import Action, Observation
from tests.players import ChainAgent, ChainEnvironment
from tests.system.peer import TIMEOUT, peer, running
from tests.system.proxy import ABORT

SESSIONS = 64
ROOM = 150
"""Megabytes that the hub may grow by in one test: some of the largest bodies, not hundreds."""


def quiet(line: str) -> None:
    """Log nothing."""


class HealthySession:
    """An agent and an environment in processes of their own, and an experiment in a thread: all play on."""

    def __init__(self, hub: subprocess.Popen[str], url: str) -> None:
        self._hub = hub
        self._returns: list[float] = []
        self._more = threading.Condition()
        self._stop = False
        self._failure: Exception | None = None
        self._players = ExitStack()
        for role, player in (("agent", "ChainAgent"), ("environment", "ChainEnvironment")):
            self._players.enter_context(running(*peer(role, url, f"tests.players:{player}")))
        self._glue = connect(url, log=quiet)
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        try:
            with self._glue as glue:
                glue.rl_init()
                while not self._stop:
                    assert glue.rl_episode()
                    with self._more:
                        self._returns.append(glue.rl_return())
                        self._more.notify()
        except Exception as error:
            self._failure = error

    def goes_on(self) -> None:
        """Wait for a few more episodes."""
        deadline = time.monotonic() + TIMEOUT
        with self._more:
            wanted = len(self._returns) + 3
            while len(self._returns) < wanted:
                assert self._hub.poll() is None, "the hub has died"
                assert self._failure is None
                assert time.monotonic() < deadline, "the session stands still"
                self._more.wait(1.0)

    def finish(self) -> list[float]:
        """Stop playing, and return the returns of all episodes."""
        self._stop = True
        self._thread.join(TIMEOUT)
        assert self._failure is None
        return self._returns

    def close(self) -> None:
        """Let everybody end, whether there is still a hub or not."""
        self._glue.give_up("the test is over")
        self._thread.join(TIMEOUT)
        self._players.close()


class Target:
    """The hub under attack."""

    def __init__(self, url: str, process: subprocess.Popen[str], healthy: HealthySession) -> None:
        self.url = url
        self.port = int(url.rpartition(":")[2])
        self._process = process
        self.healthy = healthy

    def megabytes(self) -> int:
        """Memory that the hub's process holds."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) // 1024


@contextmanager
def target() -> Iterator[Target]:
    """A hub in a process of its own, with a session that plays."""
    program = "from glue.hub.command import main; main()"
    settings = [
        "--heartbeat",
        "0.2",
        "--timeout",
        "1",
        "--max-sessions",
        str(SESSIONS),
        "--max-memory",
        "64",
    ]
    with running("-c", program, "--bind", "tcp://127.0.0.1:*", *settings) as process:
        assert process.stderr is not None
        url = process.stderr.readline().split()[-1]
        # Its log of refusals must not fill the pipe.
        threading.Thread(target=process.stderr.read, daemon=True).start()
        healthy = HealthySession(process, url)
        try:
            healthy.goes_on()
            yield Target(url, process, healthy)
        finally:
            healthy.close()
            process.terminate()
            process.wait(TIMEOUT)


@pytest.fixture(scope="module")
def _hub() -> Iterator[Target]:
    with target() as hub:
        yield hub
        returns = hub.healthy.finish()
    glue = local(ChainAgent(), ChainEnvironment())
    glue.rl_init()
    for number, total in enumerate(returns):
        assert glue.rl_episode()
        assert glue.rl_return() == total, f"episode {number}"


@pytest.fixture
def hub(_hub: Target) -> Iterator[Target]:
    before = _hub.megabytes()
    yield _hub
    _hub.healthy.goes_on()
    assert _hub.megabytes() < before + ROOM


class Client:
    """A DEALER that sends what a test wants."""

    def __init__(self, url: str, **options: Any) -> None:
        self._instance = os.urandom(INSTANCE_SIZE)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket = self._context.socket(zmq.DEALER)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.RCVTIMEO, int(TIMEOUT * 1000))
        self.socket.setsockopt(zmq.SNDTIMEO, int(TIMEOUT * 1000))
        for name, value in options.items():
            self.socket.setsockopt(getattr(zmq, name), value)
        self.socket.connect(url)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy(linger=0)

    def send(self, *frames: bytes) -> None:
        """Send frames."""
        self.socket.send_multipart(frames)

    def say(self, kind: Kind, seq: int, *scalars: Any, body: bytes = b"", session: str = "bad") -> None:
        """Send a message."""
        self.send(*encode(Message(kind, session, seq, scalars, body), TO_HUB))

    def receive(self) -> Message:
        """The next message that is not a heartbeat."""
        while (message := decode(self.socket.recv_multipart(), FROM_HUB)).kind is Kind.HEARTBEAT:
            pass
        return message

    def error(self) -> tuple[str, str]:
        """The next message, which must be an error or a refusal: its code and text."""
        message = self.receive()
        assert message.kind in (Kind.ERROR, Kind.REFUSE), message
        code, text = map(str, message.scalars)
        return code, text

    def hello(self, role: str, session: str = "bad", version: int = 1) -> None:
        """Say hello."""
        self.say(Kind.HELLO, 0, (version,), role, self._instance, "client", "test", (), session=session)

    def join(self, role: str, session: str = "bad") -> None:
        """Say hello, and be welcomed."""
        self.hello(role, session)
        assert self.receive().kind is Kind.WELCOME


@pytest.fixture
def client(hub: Target) -> Iterator[Client]:
    with Client(hub.url) as client:
        yield client


# Bytes


GREETING = b"\xff" + bytes(8) + b"\x7f" + b"\x03\x01" + b"NULL" + bytes(16) + b"\x00" + bytes(31)
READY = b"\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER\x08Identity\x00\x00\x00\x00"


def raw(hub: Target) -> socket.socket:
    """A TCP connection to the hub."""
    connection = socket.create_connection(("127.0.0.1", hub.port), TIMEOUT)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


@contextmanager
def zmtp(hub: Target) -> Iterator[socket.socket]:
    """A connection that has shaken hands as a DEALER does."""
    with raw(hub) as connection:
        connection.sendall(GREETING)
        left = len(GREETING)
        while left:
            answer = connection.recv(left)
            assert answer
            left -= len(answer)
        connection.sendall(b"\x04" + bytes([len(READY)]) + READY)
        assert connection.recv(1000)
        yield connection


def say(connection: socket.socket, message: Message) -> None:
    """Send a message."""
    connection.sendall(encode_frames(encode(message, TO_HUB)))


@contextmanager
def seated(hub: Target, session: str) -> Iterator[socket.socket]:
    """A connection that is the agent of a session."""
    with zmtp(hub) as connection:
        scalars = ((1,), "agent", os.urandom(INSTANCE_SIZE), "", "", ())
        say(connection, Message(Kind.HELLO, session, 0, scalars))
        yield connection


def test_random_bytes(hub: Target) -> None:
    noise = random.Random(1)
    for start in (b"", b"\xff", GREETING[:10], GREETING) * 20:
        with raw(hub) as connection:
            connection.sendall(start + noise.randbytes(noise.randint(1, 2000)))


def test_random_bytes_after_a_handshake(hub: Target) -> None:
    noise = random.Random(2)
    for _ in range(40):
        with zmtp(hub) as connection:
            connection.sendall(noise.randbytes(noise.randint(1, 2000)))


def test_connections_that_say_nothing(hub: Target) -> None:
    with ExitStack() as silent:
        for _ in range(100):
            silent.enter_context(raw(hub))
            silent.enter_context(zmtp(hub))
        hub.healthy.goes_on()


@pytest.mark.parametrize("size", [MAX_BODY + 2 * MAX_HEADER, 2**40, 2**63 - 1])
def test_a_frame_that_claims_to_be_giant_costs_its_sender_the_connection(hub: Target, size: int) -> None:
    with zmtp(hub) as connection:
        connection.sendall(b"\x02" + struct.pack(">Q", size) + bytes(1000))
        with suppress(ConnectionResetError):
            while connection.recv(1000):
                pass


def test_frames_that_break_off_hold_no_memory(hub: Target) -> None:
    for _ in range(20):
        with zmtp(hub) as connection:
            connection.sendall(b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(100_000))


def flood_and_reset(hub: Target, frames: bytes) -> None:
    """Send more than the hub reads ahead, and break the connection while it is held back."""
    for _ in range(20):
        with zmtp(hub) as connection:
            connection.sendall(frames)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)


NOISE = b"\x00\x01x"
PING = b"\x04\x07\x04PING\x00\x00"


def test_floods_that_break_off(hub: Target) -> None:
    flood_and_reset(hub, NOISE * 5000)


def test_floods_with_heartbeats_in_them_that_break_off(hub: Target) -> None:
    flood_and_reset(hub, (NOISE * 10 + PING) * 500)


def test_a_message_without_an_end_is_not_kept(hub: Target) -> None:
    with seated(hub, "endless") as connection:
        for _ in range(2 * ROOM):
            connection.sendall(b"\x03" + struct.pack(">Q", 2**20) + bytes(2**20))


def test_messages_that_do_not_come_to_their_end_are_dropped_when_they_are_too_many(hub: Target) -> None:
    before = hub.megabytes()
    with ExitStack() as stack:
        for _ in range(40):
            connection = stack.enter_context(zmtp(hub))
            with suppress(ConnectionError):
                connection.sendall(b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(MAX_BODY - 1))
            assert hub.megabytes() < before + ROOM


def test_a_peer_that_sends_little_may_finish_while_others_fill_the_memory(hub: Target) -> None:
    with ExitStack() as stack:
        modest = stack.enter_context(seated(hub, "modest"))
        for number in range(4):
            frame = b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(MAX_BODY - 100)
            stack.enter_context(seated(hub, f"greedy {number}")).sendall(frame)
        hub.healthy.goes_on()
        say(modest, Message(Kind.AGENT_MESSAGE, "modest", 9, (), bytes(2**20)))
        received = b""
        while ErrorCode.NOT_ASKED.encode() not in received:
            received += (more := modest.recv(2**16))
            assert more, "the modest one was dropped"


def test_of_connections_without_a_seat_the_oldest_make_room() -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=600.0))
    port = int(hub.endpoints[0].rpartition(":")[2])
    with hub.in_background(), ExitStack() as stack:
        connections = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), TIMEOUT)) for _ in range(300)
        ]
        for connection in connections[300 - MAX_UNSEATED :]:
            assert connection.recv(64) == GREETING
        for connection in connections[: 300 - MAX_UNSEATED]:
            while connection.recv(64):
                pass
        connections[-MAX_UNSEATED].settimeout(0.01)
        with pytest.raises(TimeoutError):
            connections[-MAX_UNSEATED].recv(1)


def test_a_connection_without_a_seat_does_not_stay(hub: Target) -> None:
    with raw(hub) as silent, zmtp(hub) as greeted:
        for connection in (silent, greeted):
            while connection.recv(1000):
                pass


@pytest.mark.parametrize(
    "start",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n".ljust(64),
        GREETING[:10] + b"\x02" + GREETING[11:],
        GREETING[:12] + b"CURVE".ljust(20, b"\0") + GREETING[32:],
        GREETING + b"\x04" + bytes([len(READY) - 3]) + READY.replace(b"\x06DEALER", b"\x03REQ"),
        GREETING + b"\x04\x06\x05READY",
        GREETING + b"\x00\x01x",
        GREETING + b"\x04" + bytes([len(READY)]) + READY + b"\x05\x01x",
        GREETING + b"\x04" + bytes([len(READY)]) + READY + b"\x08\x01x",
        GREETING + b"\x06" + struct.pack(">Q", 2**20),
    ],
    ids=[
        "http",
        "an older version",
        "another mechanism",
        "another socket",
        "no socket",
        "a message before READY",
        "a command with more",
        "unknown flags",
        "a giant command",
    ],
)
def test_a_peer_that_is_not_a_dealer_is_dropped(hub: Target, start: bytes) -> None:
    with raw(hub) as connection:
        connection.sendall(start)
        with suppress(ConnectionResetError):
            while connection.recv(1000):
                pass


# Frames


def test_random_frames_are_answered_with_an_error(hub: Target) -> None:
    noise = random.Random(3)
    for _ in range(50):
        with Client(hub.url) as client:
            client.send(*[noise.randbytes(noise.randint(0, 60)) for _ in range(noise.randint(1, 4))])
            assert client.error()[0] in (ErrorCode.MALFORMED, ErrorCode.UNKNOWN_KIND)


def test_a_connection_without_a_seat_ends_at_its_first_malformed_message(hub: Target) -> None:
    with zmtp(hub) as connection:
        connection.sendall(NOISE * 1000)
        answers = b""
        with suppress(ConnectionResetError):
            while data := connection.recv(2**16):
                answers += data
        assert answers.count(ErrorCode.MALFORMED.encode()) == 1


BOMBS = {
    "an array of four billion": b"\xdd\xff\xff\xff\xff",
    "a map of four billion": b"\xdf\xff\xff\xff\xff",
    "a text of four billion": b"\xdb\xff\xff\xff\xff",
    "binary of four billion": b"\xc6\xff\xff\xff\xff",
    "an extension of four billion": b"\xc9\xff\xff\xff\xff\x05",
    "arrays in arrays": b"\x91" * MAX_HEADER,
    "a megabyte of arrays in arrays": b"\x91" * 2**20,
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_msgpack_bomb_is_answered_with_an_error(client: Client, name: str) -> None:
    client.send(BOMBS[name])
    assert client.error()[0] == ErrorCode.MALFORMED


@pytest.mark.parametrize("count", [3, 1000, 100_000])
def test_a_message_of_many_frames_is_answered_with_an_error(client: Client, count: int) -> None:
    client.join("agent", session=f"{count} frames")
    client.send(*[b"frame"] * count)
    assert client.error() == (ErrorCode.MALFORMED, "a message has one or two frames; 3 received")


def test_a_body_too_large_is_answered_with_an_error(client: Client) -> None:
    client.send(msgpack.packb([19, "bad", 1]), bytes(MAX_BODY + 1))
    code, text = client.error()
    assert code == ErrorCode.MALFORMED
    assert f"the body of ENV_MESSAGE has {MAX_BODY + 1} bytes; {MAX_BODY} are allowed" in text


def test_counts_that_do_not_add_up_are_answered_with_an_error(client: Client) -> None:
    client.send(msgpack.packb([12, "bad", 1]), struct.pack("<4I", 2**32 - 1, 2**32 - 1, 2**32 - 1, 0))
    code, text = client.error()
    assert code == ErrorCode.MALFORMED
    assert "the counts in the body of ENV_START say" in text


def test_the_largest_bodies_leave_no_trace(hub: Target, client: Client) -> None:
    client.join("environment")
    for _ in range(20):
        client.send(msgpack.packb([19, "bad", 1]), bytes(MAX_BODY))
        assert client.error()[0] == ErrorCode.NOT_ASKED


# Messages out of place


def test_an_unknown_kind(client: Client) -> None:
    client.send(msgpack.packb([999, "bad", 5]))
    message = client.receive()
    assert (message.kind, message.seq, message.scalars[0]) == (Kind.ERROR, 5, ErrorCode.UNKNOWN_KIND)


def test_an_unknown_version(client: Client) -> None:
    client.hello("agent", version=2)
    assert client.error() == (ErrorCode.VERSION, "this hub supports protocol version 1, the peer [2]")


def test_an_unknown_role(client: Client) -> None:
    client.hello("king")
    assert client.error()[0] == ErrorCode.MALFORMED


def test_no_hello(client: Client) -> None:
    client.say(Kind.RL_START, 1, session="default")
    assert client.error()[0] == ErrorCode.UNKNOWN_PEER


@pytest.mark.parametrize("role", ["agent", "environment", "experiment"])
def test_a_second_of_each_role(client: Client, role: str) -> None:
    client.hello(role, session="default")
    code, text = client.error()
    assert code == ErrorCode.ROLE_TAKEN
    assert f"session 'default' already has an {role}" in text


def test_replies_without_a_call(client: Client) -> None:
    client.join("environment")
    for seq in (0, 1, 2**63 - 1):
        client.say(Kind.ENV_STEP, seq, 1.0, True, body=Observation().body)
        assert client.error()[0] == ErrorCode.NOT_ASKED


def test_messages_of_another_role(client: Client) -> None:
    client.join("agent")
    for kind, body in ((Kind.ENV_START, Observation().body), (Kind.RL_START, b"")):
        client.say(kind, 1, body=body)
        assert client.error()[0] == ErrorCode.NOT_ASKED


def test_a_malformed_message_costs_its_sender_its_seat(client: Client) -> None:
    client.join("agent")
    client.send(b"nonsense")
    assert client.error()[0] == ErrorCode.MALFORMED
    client.say(Kind.HEARTBEAT, 0)
    assert client.error()[0] == ErrorCode.UNKNOWN_PEER


def test_a_routing_id_of_ones_own_is_of_no_account(hub: Target) -> None:
    with Client(hub.url, ROUTING_ID=b"mine") as client:
        client.join("agent")


# Floods


def test_a_flood_of_hellos_leaves_room_for_others(hub: Target) -> None:
    with Client(hub.url) as flood, Client(hub.url) as late:
        outcomes = []
        for number in range(2000):
            flood.hello("agent", session=f"flood {number}")
            outcomes.append(flood.receive())
        assert sum(message.kind is Kind.WELCOME for message in outcomes) == SESSIONS // 4
        code, text = map(str, outcomes[-1].scalars)
        assert (code, f"{SESSIONS // 4} sessions" in text) == (ErrorCode.FULL, True)
        late.join("agent", session="late")


def test_floods_of_hellos_from_many_connections_fill_no_more_than_the_sessions_there_are(
    hub: Target,
) -> None:
    with ExitStack() as stack:
        floods = [stack.enter_context(Client(hub.url)) for _ in range(4)]
        outcomes = []
        for number in range(SESSIONS):
            flood = floods[number % len(floods)]
            flood.hello("agent", session=f"flood {number}")
            outcomes.append(flood.receive())
        assert outcomes[-1].scalars == (
            ErrorCode.FULL,
            f"this hub serves {SESSIONS} sessions at once, and all are in use",
        )
        # Once the floods have gone their seats are free again.
        for number in range(SESSIONS):
            floods[number % len(floods)].say(Kind.GOODBYE, 0, "over", session=f"flood {number}")
        for flood in floods:
            flood.say(Kind.HEARTBEAT, 1, session="flood 0")
            assert flood.error()[0] == ErrorCode.UNKNOWN_PEER
        with Client(hub.url) as late:
            late.join("agent", session="late")


def test_a_flood_of_hellos_and_goodbyes(hub: Target, client: Client) -> None:
    for number in range(2000):
        client.join("agent", session=f"{number}")
        client.say(Kind.GOODBYE, 0, "x" * 3000, session=f"{number}")


def test_a_flood_of_heartbeats_from_one_that_never_reads(hub: Target) -> None:
    with Client(hub.url, RCVHWM=1) as client:
        client.join("agent", session="never read")
        for _ in range(50_000):
            client.say(Kind.HEARTBEAT, 1, session="never read")


def test_a_hub_whose_log_nobody_reads_goes_on() -> None:
    program = "from glue.hub.command import main; main()"
    with running("-c", program, "--bind", "tcp://127.0.0.1:*") as process:
        assert process.stderr is not None
        url = process.stderr.readline().split()[-1]
        with connect(url, "s", log=quiet) as glue, Client(url) as refused:
            refused.join("agent", session="so that it may stay")
            for _ in range(3000):
                refused.hello("experiment", session="s")
                assert refused.error()[0] == ErrorCode.ROLE_TAKEN
            assert glue.rl_num_episodes() == 0
        process.kill()


def test_an_experiment_that_never_reads_its_replies(hub: Target) -> None:
    large = bytes(2**20)
    with (
        Client(hub.url) as agent,
        Client(hub.url, RCVHWM=1, RCVBUF=4096) as experiment,
    ):
        agent.join("agent", session="unread")
        experiment.hello("experiment", session="unread")
        experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
        call = agent.receive()
        agent.say(Kind.AGENT_MESSAGE, call.seq, body=large, session="unread")
        for _ in range(5000):
            experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
            experiment.hello("experiment", session="unread")


def test_many_sessions_with_the_largest_bodies_have_a_bound_in_all(hub: Target) -> None:
    huge = Observation(chars=bytes(MAX_BODY - 16)).body
    before = hub.megabytes()
    with Client(hub.url) as agent, Client(hub.url) as experiment:
        for number in range(12):
            session = f"huge {number}"
            agent.hello("agent", session=session)
            experiment.hello("experiment", session=session)
            experiment.say(Kind.RL_AGENT_START, 1, body=huge, session=session)
        while (message := experiment.receive()).kind is not Kind.GOODBYE:
            assert hub.megabytes() < before + ROOM
        assert "--max-memory" in str(message.scalars[0])
        hub.healthy.goes_on()
        assert hub.megabytes() < before + ROOM


def test_a_player_that_answers_everything_with_the_largest_body(hub: Target) -> None:
    huge = Action(chars=bytes(MAX_BODY - 16)).body
    with Client(hub.url) as agent, Client(hub.url) as experiment:
        agent.join("agent")
        experiment.join("experiment")
        while experiment.receive().kind is not Kind.NOTICE:
            pass
        for seq in (1, 2):
            experiment.say(Kind.RL_AGENT_START, seq, body=Observation().body)
            agent.say(Kind.AGENT_START, agent.receive().seq, body=huge)
            assert experiment.receive().body == huge

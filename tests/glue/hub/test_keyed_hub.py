"""A hub with keys, and libzmq's own client: who gets in, as what, and for how long."""

from __future__ import annotations

import queue
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import pytest
import zmq

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.client.experiment import RemoteExperiment, connect
from glue.client.players import serve_agent, serve_environment
from glue.core.config import Bind, HubConfig
from glue.core.keys import Keys
from glue.errors import ConfigError, GlueError, HubUnreachable, LocalProtocolError, Refused
from glue.hub.server import Hub
from glue.keys.allowed import read_keys
from glue.keys.certificates import encode, read_pair, read_public
from glue.protocol import zmtp
from glue.protocol.messages import Kind, Message, Role
from glue.protocol.wire import TO_HUB
from glue.protocol.wire import encode as encode_message
from tests.curve_client import GREETING, CurveClient, Pair, command
from tests.keyed import KeyFolder
from tests.players import ScriptedAgent, ScriptedEnvironment

TIMEOUT = 20.0
"""Seconds until a test gives up waiting. Generous: machines are busy."""


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    made = KeyFolder(tmp_path)
    for name in ("agent", "environment", "experiment", "observer", "stranger"):
        made.entrant(name)
    made.allow("".join(f'[{role}]\nrole = "{role}"\nsession = "a"\n' for role in Role))
    return made


def ignore(line: str) -> None:
    """Say nothing."""


class Log:
    """A hub's log, of which one can wait for a line."""

    def __init__(self) -> None:
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def __call__(self, line: str) -> None:
        self.lines.put(line)

    def wait_for(self, words: str) -> str:
        while words not in (line := self.lines.get(timeout=TIMEOUT)):
            pass
        return line


@contextmanager
def serving(folder: KeyFolder, log: Log | None = None) -> Iterator[Hub]:
    bind = Bind("tcp://127.0.0.1:*", keys=read_keys(folder.path))
    config = HubConfig(bind=(bind,), heartbeat=0.05)
    with Hub(config, log or (lambda line: None)).in_background() as hub:
        yield hub


def secret(folder: KeyFolder, name: str) -> Path:
    return folder.path.parent / "entrants" / f"{name}.key_secret"


def join(hub: Hub, folder: KeyFolder, name: str, session: str = "a") -> RemoteExperiment:
    return connect(
        hub.endpoints[0], session, key=secret(folder, name), hub_key=folder.hub_key, wait=TIMEOUT, log=ignore
    )


@contextmanager
def players(hub: Hub, folder: KeyFolder) -> Iterator[None]:
    """An agent and an environment of session a, with the keys of their roles."""

    def serve_one(serve: object, player: object, name: str) -> None:
        with suppress(GlueError):
            serve(player, hub.endpoints[0], "a", key=secret(folder, name), hub_key=folder.hub_key, log=ignore)  # type: ignore[operator]

    threads = [
        threading.Thread(target=serve_one, args=(serve_agent, ScriptedAgent(), "agent"), daemon=True),
        threading.Thread(
            target=serve_one, args=(serve_environment, ScriptedEnvironment(), "environment"), daemon=True
        ),
    ]
    for thread in threads:
        thread.start()
    yield


def test_a_hub_with_keys_may_listen_where_others_reach_it(folder: KeyFolder) -> None:
    keys = read_keys(folder.path)
    HubConfig(bind=(Bind("tcp://0.0.0.0:4097", keys=keys),))
    with pytest.raises(ConfigError, match=r"peers are not authenticated: give --keys DIR .*--insecure"):
        HubConfig(bind=(Bind("tcp://0.0.0.0:4097"),))
    with pytest.raises(ConfigError, match=r"tcp://0\.0\.0\.0:4098 can be reached"):
        HubConfig(bind=(Bind("tcp://0.0.0.0:4097", keys=keys), "tcp://0.0.0.0:4098"))


def test_each_key_opens_its_role_of_its_session_and_nothing_else(folder: KeyFolder) -> None:
    with serving(folder) as hub:
        with players(hub, folder), join(hub, folder, "experiment") as glue:
            glue.rl_init()
            assert glue.rl_episode() is True
            assert glue.rl_return() != 0
        for name, session in (("agent", "a"), ("environment", "a"), ("experiment", "b")):
            with pytest.raises(Refused, match=f"no experiment of session '{session}' may .* with this key"):
                join(hub, folder, name, session)


def test_a_key_opens_no_more_than_its_address(folder: KeyFolder) -> None:
    bind = Bind("tcp://127.0.0.1:*", frozenset({Role.AGENT}), keys=read_keys(folder.path))
    with (
        Hub(HubConfig(bind=(bind,))).in_background() as hub,
        pytest.raises(Refused, match="no experiment of session 'a' may"),
    ):
        join(hub, folder, "experiment")


def test_an_unknown_key_is_an_error_at_once_that_names_it(folder: KeyFolder) -> None:
    with serving(folder) as hub, pytest.raises(Refused) as refused:
        connect(hub.endpoints[0], "a", key=secret(folder, "stranger"), hub_key=folder.hub_key)
    public = encode(read_public(secret(folder, "stranger")))
    assert f"does not know your key, {public} in {secret(folder, 'stranger')}: ask" in str(refused.value)


def test_another_hubs_key_is_an_error_soon(folder: KeyFolder) -> None:
    log = Log()
    other = folder.path / "agent.key"
    with serving(folder, log) as hub, pytest.raises(Refused, match="ask whoever runs it for the right --hub"):
        connect(hub.endpoints[0], "a", key=secret(folder, "experiment"), hub_key=other)
    log.wait_for("it takes another public key for the one of this hub")


@pytest.mark.parametrize("libzmq", [False, True])
def test_who_has_no_key_is_told_that_one_is_needed(folder: KeyFolder, libzmq: bool) -> None:
    with zmq.Context() as context, serving(folder) as hub:
        chosen = context if libzmq else None
        with pytest.raises(Refused, match=r"lets in only those whose key it knows.*glue-keys new"):
            connect(hub.endpoints[0], "a", context=chosen, wait=TIMEOUT)


def test_a_hub_without_keys_is_an_error_for_who_has_one(folder: KeyFolder) -> None:
    with (
        Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub,
        pytest.raises(Refused, match="does not encrypt and knows no keys: leave out --key"),
    ):
        join(hub, folder, "experiment")


def test_no_hub_is_waited_for_as_without_keys(folder: KeyFolder) -> None:
    with pytest.raises(HubUnreachable):
        connect(
            "tcp://127.0.0.1:1", key=secret(folder, "agent"), hub_key=folder.hub_key, wait=0.2, log=ignore
        )


def test_key_and_hub_key_go_together(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError, match="--key needs --hub-key KEY: ask"):
        connect(key=secret(folder, "agent"))
    with pytest.raises(ConfigError, match="--hub-key needs --key FILE"):
        connect(hub_key=folder.hub_key)


def test_a_program_finds_its_place_in_the_environment(
    folder: KeyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(folder) as hub:
        for name, value in (
            ("GLUE_HUB", hub.endpoints[0]),
            ("GLUE_SESSION", "a"),
            ("GLUE_KEY", secret(folder, "experiment")),
            ("GLUE_HUB_KEY", encode(read_public(folder.hub_key))),
        ):
            monkeypatch.setenv(name, str(value))
        with connect(wait=TIMEOUT) as glue:
            assert glue.rl_num_episodes() == 0
    with (
        Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as plain,
        connect(plain.endpoints[0], wait=TIMEOUT) as glue,
    ):
        assert glue.rl_num_episodes() == 0, "the keys of GLUE_HUB are not for another hub"


def test_heartbeats_of_libzmq_are_answered_and_large_bodies_pass(folder: KeyFolder) -> None:
    with serving(folder) as hub, players(hub, folder), zmq.Context() as context:
        made = context.socket

        def with_heartbeats(kind: int) -> zmq.Socket[bytes]:
            one = made(kind)
            one.setsockopt(zmq.HEARTBEAT_IVL, 20)
            one.setsockopt(zmq.HEARTBEAT_TIMEOUT, 5000)
            return one

        context.socket = with_heartbeats  # type: ignore[method-assign, assignment]
        with connect(
            hub.endpoints[0],
            "a",
            key=secret(folder, "experiment"),
            hub_key=folder.hub_key,
            context=context,
        ) as glue:
            glue.rl_init()
            large = "é" * 1_000_000
            assert glue.rl_agent_message(large) == ScriptedAgent().agent_message(large)
            threading.Event().wait(0.2)  # ten PINGs
            assert glue.rl_num_episodes() == 0
            with pytest.raises(LocalProtocolError, match="the hub takes"):
                glue.rl_agent_message("x" * (17 * 2**20))


def test_keys_are_read_again_and_who_lost_theirs_is_out(folder: KeyFolder) -> None:
    log = Log()
    with serving(folder, log) as hub, join(hub, folder, "experiment") as glue, players(hub, folder):
        glue.rl_init()
        folder.allow('[experiment]\nrole = "experiment"\nsession = "a"\n[agent\n')
        hub.renew_keys(lambda: read_keys(folder.path))
        assert "is not TOML" in log.wait_for("the keys stay as they were")
        assert glue.rl_num_episodes() == 0
        folder.allow(
            '[experiment]\nrole = "experiment"\nsession = "a"\n'
            '[environment]\nrole = "environment"\nsession = "b"\n'
            '[stranger]\nrole = "experiment"\nsession = "c"\n'
        )
        hub.renew_keys(lambda: read_keys(folder.path))
        log.wait_for("the keys were read again: 3 keys may join")
        lines = sorted(log.wait_for("was dropped: the key of") for _ in range(4))
        assert {line.partition("was dropped: ")[2] for line in lines} == {
            "the key of 'agent' was removed",
            "the key of 'environment' was changed",
        }
        assert glue.rl_num_episodes() == 0, "whose key is as it was notices nothing"
        with join(hub, folder, "stranger", "c") as other:
            assert other.rl_num_episodes() == 0
        with pytest.raises(Refused, match="does not know your key"):
            join(hub, folder, "agent")


def test_a_new_key_of_the_hub_ends_every_connection(folder: KeyFolder) -> None:
    log = Log()
    with serving(folder, log) as hub, join(hub, folder, "experiment"):
        keys = read_keys(folder.path)
        hub.renew_keys(lambda: Keys(Pair.new().secret, keys.permits))
        log.wait_for("was dropped: the hub has a new key")


class Raw:
    """A peer on a plain socket, whose handshake can be bent."""

    def __init__(self, hub: Hub, folder: KeyFolder, name: str = "experiment") -> None:
        pair = read_pair(secret(folder, name))
        self.client = CurveClient(Pair(pair.public, pair.secret), read_public(folder.hub_key))
        host, _, port = hub.endpoints[0].removeprefix("tcp://").rpartition(":")
        self.socket = socket.create_connection((host, int(port)), TIMEOUT)
        self.stream: BinaryIO = self.socket.makefile("rb")
        self.socket.sendall(GREETING)
        assert self.stream.read(64) == zmtp.CURVE_GREETING

    def __enter__(self) -> Raw:
        return self

    def __exit__(self, *_: object) -> None:
        self.stream.close()
        self.socket.close()

    def frame(self) -> bytes:
        head = self.stream.read(2)
        if head[0] & 2:
            head += self.stream.read(7)
            return head + self.stream.read(struct.unpack(">Q", head[1:])[0])
        return head + self.stream.read(head[1])

    def begin(self) -> Raw:
        """Complete the handshake."""
        self.socket.sendall(command(self.client.hello()))
        self.client.welcome(self.frame()[2:])
        self.socket.sendall(command(self.client.initiate()))
        self.client.ready(self.frame()[2:])
        return self

    def hello(self) -> bytes:
        """The frames of a HELLO of the experiment of session a."""
        scalars = ((1,), "experiment", bytes(16), "raw", "test", ())
        [header] = encode_message(Message(Kind.HELLO, "a", 1, scalars), TO_HUB)
        return header

    def ended(self) -> bool:
        """Whether the hub ends the connection without another word."""
        with suppress(ConnectionResetError):
            return self.stream.read() == b""
        return True


def test_nothing_can_be_slipped_in_between_encrypted_messages(folder: KeyFolder) -> None:
    log = Log()
    with serving(folder, log) as hub, Raw(hub, folder).begin() as raw:
        raw.socket.sendall(raw.client.message(raw.hello()))
        assert raw.client.read(raw.frame())[0] == 0
        log.wait_for("experiment raw (test) joined")
        raw.socket.sendall(zmtp.encode([raw.hello()]))  # in plain text
        log.wait_for("was dropped: it sent something that is not encrypted")


def test_a_handshake_that_was_recorded_opens_nothing(folder: KeyFolder) -> None:
    with (
        serving(folder) as hub,
        Raw(hub, folder) as first,
        Raw(hub, folder) as second,
        Raw(hub, folder) as third,
    ):
        hello = command(first.client.hello())
        first.socket.sendall(hello)
        first.client.welcome(first.frame()[2:])
        initiate = command(first.client.initiate())
        first.socket.sendall(initiate)
        first.client.ready(first.frame()[2:])
        message = first.client.message(first.hello())
        first.socket.sendall(message)
        second.socket.sendall(hello)
        assert second.frame()[2:10] == b"\x07WELCOME"
        second.socket.sendall(initiate + message)
        assert second.ended()
        third.socket.sendall(initiate + message)
        assert third.ended()
        assert hub.switchboard.num_steps("a") == 0, "the first is in its place"


def test_a_handshake_that_stops_half_way_keeps_no_place(folder: KeyFolder) -> None:
    with serving(folder) as hub, ExitStack() as stack:
        raws = [stack.enter_context(Raw(hub, folder)) for _ in range(5)]
        raws[1].socket.sendall(command(raws[1].client.hello())[:100])
        for raw, part in ((raws[2], 0.0), (raws[3], 0.5), (raws[4], 1.0)):
            raw.socket.sendall(command(raw.client.hello()))
            raw.client.welcome(raw.frame()[2:])
            initiate = command(raw.client.initiate())
            raw.socket.sendall(initiate[: int(len(initiate) * part)])
        raws[4].client.ready(raws[4].frame()[2:])
        assert all(raw.ended() for raw in raws), "without a seat they are dropped after a second"

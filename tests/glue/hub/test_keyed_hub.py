"""A hub with keys: whom it admits, in which roles and for how long; over plain sockets and libzmq."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.client.experiment import RemoteExperiment, connect
from glue.client.libzmq import Context
from glue.client.players import serve_agent, serve_environment
from glue.client.sockets import open_transport
from glue.client.target import find_target
from glue.errors import ConfigError, GlueError, HubUnreachable, Refused
from glue.hub.config import Bind, HubConfig, Keys, Permit
from glue.hub.io.server import Hub
from glue.keys.allowed import read_keys
from glue.keys.certificates import encode, read_pair, read_public
from glue.notebook.serving import Served
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, decode
from glue.wire.messages import ErrorCode, Kind, Message, Role
from tests.keyed import KeyFolder
from tests.players import ScriptedAgent, ScriptedEnvironment
from tests.scripted.curve import GREETING, CurveClient, Pair, command
from tests.scripted.peer import ScriptedPeer
from tests.system.proxy import Proxy

TIMEOUT = 20.0
"""Seconds until a test gives up waiting. Generous: machines are busy."""


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    made = KeyFolder(tmp_path)
    for name in ("agent", "environment", "experiment", "observer", "stranger"):
        made.entrant(name)
    made.allow("".join(f'[{role}]\nrole = "{role}"\nsession = "a"\n' for role in Role))
    return made


@pytest.fixture(params=[False, True], ids=["plain sockets", "libzmq"])
def context(request: pytest.FixtureRequest) -> Iterator[Context | None]:
    """What a client connects with."""
    with Context() as made:
        yield made if request.param else None


class Log:
    """A hub's log that can be waited on for a line."""

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
    config = HubConfig(bind=(bind,), heartbeat=0.05, greeting=TIMEOUT)
    with Hub(config, log or (lambda line: None)).in_background() as hub:
        yield hub


def secret(folder: KeyFolder, name: str) -> Path:
    return folder.path.parent / "entrants" / f"{name}.key_secret"


def keys_of(folder: KeyFolder, name: str) -> dict[str, Any]:
    return {"key": secret(folder, name), "hub_key": folder.hub_key}


def join(
    hub: Hub | Proxy, folder: KeyFolder, name: str, session: str = "a", context: Context | None = None
) -> RemoteExperiment:
    url = hub.url if isinstance(hub, Proxy) else hub.endpoints[0]
    return connect(url, session, **keys_of(folder, name), wait=TIMEOUT, context=context)


@contextmanager
def players(hub: Hub, folder: KeyFolder) -> Iterator[None]:
    """An agent and an environment of session a, with the keys of their roles."""
    url, agents, environments = hub.endpoints[0], keys_of(folder, "agent"), keys_of(folder, "environment")
    served = (
        Served(lambda stop: serve_agent(ScriptedAgent(), url, "a", **agents, stop=stop)),
        Served(lambda stop: serve_environment(ScriptedEnvironment(), url, "a", **environments, stop=stop)),
    )
    try:
        yield
    finally:
        for player in served:
            with suppress(GlueError):  # its key may have been taken away
                player.stop()


def test_a_hub_with_keys_may_listen_where_others_reach_it(folder: KeyFolder) -> None:
    keys = read_keys(folder.path)
    HubConfig(bind=(Bind("tcp://0.0.0.0:4097", keys=keys),))
    with pytest.raises(ConfigError) as caught:
        HubConfig(bind=(Bind("tcp://0.0.0.0:4097"),))
    assert caught.value.settings == ("keys", "bind", "insecure")
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


def test_an_unknown_key_is_an_error_at_once_that_names_it(folder: KeyFolder, context: Context | None) -> None:
    with serving(folder) as hub, pytest.raises(Refused) as refused:
        join(hub, folder, "stranger", context=context)
    public = encode(read_public(secret(folder, "stranger")))
    assert f"does not know your key, {public} in {secret(folder, 'stranger')}: ask" in str(refused.value)


def test_another_hubs_key_is_an_error_soon(folder: KeyFolder, context: Context | None) -> None:
    log = Log()
    other = folder.path / "agent.key"
    with serving(folder, log) as hub:
        with pytest.raises(Refused) as caught:
            connect(hub.endpoints[0], "a", key=secret(folder, "experiment"), hub_key=other, context=context)
        assert "hub_key" in caught.value.settings
    log.wait_for("it expects a different public key for this hub")


CUTS = (0, 64, 64 + 170, 0)
"""Bytes from the hub before a handshake is cut: none, its greeting, its greeting and WELCOME."""


def test_handshakes_that_are_cut_are_tried_again_however_often(
    folder: KeyFolder, context: Context | None
) -> None:
    with serving(folder) as hub, Proxy(hub.endpoints[0]).in_background() as proxy:
        proxy.cut(*CUTS)
        with join(proxy, folder, "experiment", context=context) as glue:
            assert proxy.accepted > len(CUTS)
            proxy.cut(*CUTS)
            while not proxy.accepted:
                assert glue.rl_num_episodes() == 0
            assert glue.rl_num_episodes() == 0
            assert proxy.accepted > len(CUTS)


def test_who_has_no_key_is_told_that_one_is_needed(folder: KeyFolder, context: Context | None) -> None:
    with serving(folder) as hub:
        with pytest.raises(Refused, match=r"glue-keys new") as caught:
            connect(hub.endpoints[0], "a", context=context, wait=TIMEOUT)
        assert caught.value.settings == ("key", "hub_key")


def test_a_hub_without_keys_is_an_error_for_who_has_one(folder: KeyFolder) -> None:
    with (
        Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub,
        pytest.raises(Refused, match="does not encrypt") as caught,
    ):
        join(hub, folder, "experiment")
    assert caught.value.settings == ("key", "hub_key")


def test_no_hub_is_waited_for_as_without_keys(folder: KeyFolder) -> None:
    with pytest.raises(HubUnreachable):
        connect("tcp://127.0.0.1:1", **keys_of(folder, "agent"), wait=0.2)


def test_key_and_hub_key_go_together(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError) as caught:
        connect(key=secret(folder, "agent"))
    assert caught.value.settings == ("hub_key",)
    with pytest.raises(ConfigError) as caught:
        connect(hub_key=folder.hub_key)
    assert caught.value.settings == ("key",)


def test_a_program_finds_its_place_in_variables(folder: KeyFolder, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_keys_are_read_again_and_who_lost_theirs_is_out(folder: KeyFolder) -> None:
    log = Log()
    with serving(folder, log) as hub, join(hub, folder, "experiment") as glue, players(hub, folder):
        glue.rl_init()
        folder.allow(
            '[experiment]\nrole = "experiment"\nsession = "a"\n'
            '[environment]\nrole = "environment"\nsession = "b"\n'
            '[stranger]\nrole = "experiment"\nsession = "c"\n'
        )
        hub.renew_keys(read_keys(folder.path))
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


def test_a_keyed_peer_learns_of_its_connection_before_the_hub_tires_of_it(folder: KeyFolder) -> None:
    # A peer that sleeps after the handshake greets late, or is dropped for not greeting.
    with serving(folder) as hub:
        place = find_target(hub.endpoints[0], "a", secret(folder, "experiment"), folder.hub_key)
        transport = open_transport(place.hub, key=place.key)
        with closing(transport):
            transport.wait_at_most(TIMEOUT)
            while not transport.connections:
                transport.receive_message(1024)
            assert transport.connected


def test_a_new_key_of_the_hub_ends_every_connection(folder: KeyFolder) -> None:
    log = Log()
    with serving(folder, log) as hub, join(hub, folder, "experiment"):
        keys = read_keys(folder.path)
        hub.renew_keys(Keys(Pair.new().secret, keys.permits))
        log.wait_for("was dropped: the hub has a new key")


def scripted(hub: Hub, folder: KeyFolder, stack: ExitStack) -> tuple[ScriptedPeer, CurveClient]:
    """Return a peer with the experiment's keys, greeted by the hub, and its half of CURVE."""
    pair = read_pair(secret(folder, "experiment"))
    keys = CurveClient(Pair(pair.public, pair.secret), read_public(folder.hub_key))
    peer = stack.enter_context(ScriptedPeer(hub.endpoints[0], keys, session="a").connect())
    peer.send_bytes(GREETING)
    assert peer.read(64) == zmtp.CURVE_GREETING
    return peer, keys


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_a_handshake_that_stops_half_way_is_dropped(folder: KeyFolder, stack: ExitStack) -> None:
    hub = stack.enter_context(serving(folder))
    (silent, _), (cut, cut_keys), *begun = [scripted(hub, folder, stack) for _ in range(5)]
    cut.send_bytes(command(cut_keys.hello())[:100])
    for (peer, keys), part in zip(begun, (0.0, 0.5, 1.0), strict=True):
        peer.send_bytes(command(keys.hello()))
        keys.welcome(peer.read_frame()[1])
        initiate = command(keys.initiate())
        peer.send_bytes(initiate[: int(len(initiate) * part)])
    peer, keys = begun[-1]
    keys.ready(peer.read_frame()[1])
    object.__setattr__(hub.config, "greeting", 0.0)  # from now on it waits for nobody
    assert [peer.read_to_end() for peer in (silent, cut, *(peer for peer, _ in begun))] == [b""] * 5


UNKNOWN = ((bytes((0x93, 99, 0xA1, 0x73, 5)),), (bytes((0x94, 72, 0xA1, 0x73, 6, 1)), b"a body"))
"""The frames of messages in session s: of a kind that nobody knows, and of one that only hubs send."""


@pytest.mark.parametrize("keyed", [False, True], ids=["plain", "keyed"])
@pytest.mark.parametrize("role", Role)
def test_a_hub_reads_what_lies_behind_unknown_kinds(role: Role, keyed: bool) -> None:
    hub_keys, own = Pair.new(), Pair.new()
    permits = {own.public: Permit("somebody", frozenset(Role))}
    bind = Bind("tcp://127.0.0.1:*", keys=Keys(hub_keys.secret, permits) if keyed else None)
    with (
        Hub(HubConfig(bind=(bind,), heartbeat=60.0, timeout=60.0)).in_background() as hub,
        ScriptedPeer(hub.endpoints[0], session="s") as founder,
        ScriptedPeer(hub.endpoints[0], session="s") as peer,
    ):
        if keyed:
            founder.keys, peer.keys = (CurveClient(own, hub_keys.public) for _ in range(2))
        founder.greet().join("agent" if role is not Role.AGENT else "environment")
        peer.greet().join(role)
        beat = peer.frames_of(Kind.HEARTBEAT, 7)
        peer.send_bytes(b"".join(peer.encoded(*frames) for frames in (*UNKNOWN * 2, beat)))
        heard: list[Message] = []
        while not heard or heard[-1].kind is not Kind.HEARTBEAT:
            heard.append(decode(peer.receive_frames(), FROM_HUB))
    errors = [(message.seq, message.scalars[0]) for message in heard if message.kind is Kind.ERROR]
    assert errors == [(5, ErrorCode.UNKNOWN_KIND), (6, ErrorCode.UNKNOWN_KIND)] * 2
    assert heard[-1].seq == 7

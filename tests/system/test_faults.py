"""Processes that die, stop and come back, and connections that break: with real processes and sockets."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest

from env_server.toys import SkeletonEnvironment
from glue import Action, Experiment, HubClosed, PeerLost, Step, connect, local
from glue.client.experiment import RemoteExperiment
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from tests.forked import Recorded
from tests.hubs import hub_with, serving
from tests.players import At, ChainAgent, ChainEnvironment, ScriptedAgent, ScriptedEnvironment
from tests.proof import size
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import address, main, running
from tests.system.proxy import Proxy

EPISODES = 4
HEARTBEAT = 0.1


class Processes:
    """Players in processes of their own, any number one after another."""

    def __init__(self, hub: str, role: str, player: str) -> None:
        self._arguments = (role, hub, f"tests.players:{player}")
        self._started: list[Recorded] = []

    def __enter__(self) -> Processes:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        for started in self._started:
            started.kill()

    def start(self) -> None:
        """Start another player."""
        self._started.append(Recorded(main, *self._arguments))

    @property
    def latest(self) -> Recorded:
        """The process started last."""
        return self._started[-1]


def play(glue: Experiment) -> list[str]:
    """Run exactly EPISODES episodes to their end; return the error of each that was void."""
    void = []
    while glue.rl_num_episodes() < EPISODES:
        try:
            assert glue.rl_episode()
        except PeerLost as error:
            void.append(str(error))
    return void


def play_on(glue: Experiment) -> NoReturn:
    """Run episodes until an error ends them."""
    while True:
        glue.rl_episode()


class Run:
    """A hub with an experiment, one player in a process and the other in a thread."""

    def __init__(self) -> None:
        self.hub = Hub(HubConfig(("tcp://127.0.0.1:*",), HEARTBEAT, timeout=1.0, greeting=TIMEOUT))
        self.notices: list[tuple[str, str]] = []
        self.on_notice: dict[str, Callable[[], None]] = {}

    @contextmanager
    def experiment(
        self, role: str, player: str, partner: Any, through: str | None = None
    ) -> Iterator[tuple[RemoteExperiment, Processes]]:
        """Connect all three; the player in a process may connect `through` another address."""
        with self.hub.in_background():
            (url,) = self.hub.endpoints
            with ExitStack() as ending:
                # The hub must say goodbye before the partner's thread can be joined.
                ending.enter_context(serving(url, partner))
                ending.callback(self.hub.stop, "over")
                processes = ending.enter_context(Processes(through or url, role, player))
                yield ending.enter_context(connect(url, on_notice=self._notice)), processes

    def _notice(self, event: str, role: str, name: str) -> None:
        self.notices.append((event, role))
        self.on_notice.get(event, lambda: None)()


CASES = {
    "agent": ("TellingAgent", ScriptedEnvironment, "env_step", "agent_seed agent_init agent_start"),
    "environment": ("TellingEnvironment", ScriptedAgent, "agent_step", "env_seed env_init env_start"),
}
"""For each role that a fault strikes: its player, the partner, the partner's call, and the first calls."""


def calls(glue: Experiment, role: str) -> list[str]:
    """Return the names of the calls that the player of `role` has had."""
    ask = glue.rl_agent_message if role == "agent" else glue.rl_env_message
    return [call.split()[0] for call in ask("calls").splitlines()]


@pytest.mark.parametrize("role", CASES)
def test_a_killed_player_is_noticed_replaced_and_the_episodes_are_completed(role: str) -> None:
    player, partner, moment, first_calls = CASES[role]
    run = Run()
    kill = At(moment, 5, lambda: os.kill(processes.latest.pid, signal.SIGKILL))
    with run.experiment(role, player, partner(before=kill)) as (glue, processes):
        run.on_notice["lost"] = processes.start
        glue.rl_init(seed=5)
        void = play(glue)
        assert len(void) == 1
        assert f"the {role} Telling" in void[0]
        assert run.notices[-2:] == [("lost", role), ("joined", role)]
        assert glue.rl_num_episodes() == EPISODES
        assert calls(glue, role)[:3] == first_calls.split()


@pytest.mark.parametrize("role", CASES)
def test_a_player_cut_off_for_longer_than_the_timeout_returns_as_it_was(role: str) -> None:
    player, partner, moment, first_calls = CASES[role]
    run = Run()
    proxy = Proxy(run.hub.endpoints[0])
    shut = At(moment, 5, proxy.shut)
    with proxy.in_background(), run.experiment(role, player, partner(before=shut), proxy.url) as (glue, _):
        run.on_notice["lost"] = proxy.open
        glue.rl_init(seed=5)
        assert len(play(glue)) == 1
        assert run.notices[-2:] == [("lost", role), ("returned", role)]
        assert glue.rl_num_episodes() == EPISODES
        had, first = calls(glue, role), first_calls.split()
        assert had[:3] == first
        assert had.count(first[1]) == 1, "it was not initialised again"


def chain(glue: Experiment, episodes: int) -> list[float]:
    """Return the returns of `episodes` episodes, then a digest of all earlier calls from each player."""
    glue.rl_init()
    returns = []
    for _ in range(episodes):
        assert glue.rl_episode()
        returns.append(glue.rl_return())
    return [*returns, float(glue.rl_agent_message("?")), float(glue.rl_env_message("?"))]


@pytest.mark.proof
@pytest.mark.stage("proof")
@pytest.mark.timeout(1200)
def test_runs_over_connections_that_break_again_and_again_have_the_same_returns() -> None:
    # Most of the time of a cut is a wait, so that several runs take no longer than one.
    runs, cuts = size((1, 100), (8, 10_000))
    with ThreadPoolExecutor(runs) as pool:
        list(pool.map(lambda seed: play_over_cuts(cuts // runs, seed), range(1, runs + 1)))


def play_over_cuts(cuts: int, seed: int) -> None:
    """Play over connections that break at random bytes; the returns are those of a run in one process."""
    episodes = cuts * 6 // 10
    expected = chain(local(ChainAgent(), ChainEnvironment()), episodes)
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, timeout=60.0, greeting=60.0))
    with hub.in_background():
        proxy = Proxy(hub.endpoints[0], cuts, seed)
        with (
            proxy.in_background(),
            Processes(proxy.url, "agent", "ChainAgent"),
            Processes(proxy.url, "environment", "ChainEnvironment"),
            connect(proxy.url) as glue,
        ):
            assert chain(glue, episodes) == expected
            assert proxy.finished.is_set(), "all cuts were made"


HUB = "from glue_rl.commands import hub; hub()"


@contextmanager
def hub_process(bind: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`glue-hub` in a process, and its address."""
    with running("-c", HUB, "--bind", bind, "--heartbeat", str(HEARTBEAT), "--timeout", "1") as hub:
        yield hub, address(hub)


def test_players_come_back_to_a_hub_that_was_killed_and_started_again() -> None:
    with ExitStack() as stack:
        with hub_process("tcp://127.0.0.1:*") as (hub, url):
            stack.enter_context(Processes(url, "agent", "TellingAgent"))
            stack.enter_context(Processes(url, "environment", "TellingEnvironment"))
            before = stack.enter_context(connect(url))
            before.rl_init()
            assert before.rl_episode()
            hub.kill()
            hub.wait(TIMEOUT)
        with hub_process(url):
            with pytest.raises(HubClosed, match="knows nothing of this experiment"):
                before.rl_episode()
            before.close()
            with connect(url) as after:
                after.rl_init()
                assert after.rl_episode()
                assert calls(after, "agent").count("agent_init") == 2, "the same process as before"
                assert calls(after, "environment").count("env_init") == 2


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_hub_that_is_told_to_stop_tells_every_peer(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    reason = f"the hub was stopped by {number.name}"
    with hub_process(f"ipc://{tmp_path}/hub") as (hub, url):
        with (
            Processes(url, "agent", "ScriptedAgent") as agent,
            Processes(url, "environment", "ScriptedEnvironment") as environment,
            connect(url) as glue,
        ):
            glue.rl_init()
            hub.send_signal(number)
            with pytest.raises(HubClosed, match=reason):
                play_on(glue)
            for player in (agent.latest, environment.latest):
                assert player.wait(TIMEOUT) == 0
                assert player.output().endswith(f"goodbye: {reason}\n")
        assert hub.wait(TIMEOUT) == code


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_player_that_is_told_to_stop_tells_the_hub(number: signal.Signals, code: int) -> None:
    class Walk(SkeletonEnvironment):
        def env_step(self, action: Action) -> Step:
            process.send_signal(number)
            return super().env_step(action)

    agent = "from glue_rl.commands import agent; agent()"
    with (
        hub_with(Walk(), heartbeat=HEARTBEAT, timeout=60.0) as url,
        running("-c", agent, "skeleton", "--hub", url) as process,
        connect(url) as glue,
    ):
        glue.rl_init()
        with pytest.raises(PeerLost, match=r"the agent skeleton left: interrupted"):
            play_on(glue)
        assert process.wait(TIMEOUT) == code

"""An experiment in the hub's own process: it runs the loop itself, with no visible difference."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from types import FrameType

import pytest

from glue.client.experiment import RemoteExperiment, connect_over
from glue.engine.local import local
from glue.errors import HubClosed
from glue.hub.config import HubConfig
from glue.hub.io import inside as inside_hub
from glue.hub.io import loop
from glue.hub.io.inside import InsideTransport
from glue.hub.io.loop import Loop
from glue.hub.io.server import Hub
from glue.system import network, threads
from glue.wire.messages import Kind, Message
from tests.glue.hub.test_inside_players import play
from tests.hubs import running
from tests.players import ChainAgent, ChainEnvironment
from tests.scripted.peer import TIMEOUT


@pytest.fixture
def hub() -> Iterator[Hub]:
    with running(heartbeat=0.05) as hub:
        yield hub


def inside(hub: Hub, session: str = "default") -> RemoteExperiment:
    return connect_over(InsideTransport(hub), session)


def test_it_plays_where_there_is_no_epoll(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "Poller", network.PortablePoller)  # as on macOS
    with (
        running(ChainAgent(), ChainEnvironment(), heartbeat=0.05) as hub,
        inside(hub) as glue,
        local(ChainAgent(), ChainEnvironment()) as expected,
    ):
        assert play(glue, 1, 7) == play(expected, 1, 7)


class LateLock:
    """A lock that delays the thread `late` until another has taken it, as if the machine had stopped it."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._asking = threading.Event()
        self._taken = threading.Event()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        late = threading.current_thread().name == "late"
        if late and not self._asking.is_set():
            self._asking.set()
            assert self._taken.wait(TIMEOUT)
        acquired = self._lock.acquire(blocking, timeout)
        if acquired and not late and self._asking.is_set():
            self._taken.set()
        return acquired

    def release(self) -> None:
        self._lock.release()


def test_a_thread_stopped_while_it_asks_for_the_loop_is_given_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "RLock", LateLock)
    taken = Loop(0.01, print)
    given: list[str] = []
    running = threading.Thread(target=taken.run)
    late = threading.Thread(target=lambda: taken.alone(lambda: given.append("the loop")), name="late")
    running.start()
    late.start()
    late.join(TIMEOUT)
    in_time = list(given)
    taken.stop("the test is over")
    for thread in (running, late):
        thread.join(TIMEOUT)
    taken.close()
    assert in_time == ["the loop"]


def test_a_hub_that_ends_ends_the_verb_that_waits(hub: Hub) -> None:
    with inside(hub) as glue:
        threading.Timer(0.2, hub.stop, ("it was time",)).start()
        with pytest.raises(HubClosed, match="it was time"):
            glue.rl_init()  # there is no environment to answer


def test_an_interrupted_verb_ends_the_hub(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    with inside(hub) as glue:

        def interrupted(seconds: float = 0) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(hub.loop, "turn", interrupted)
            with pytest.raises(KeyboardInterrupt):
                glue.rl_init()
        with pytest.raises(HubClosed, match="interrupted"):
            glue.rl_num_steps()


def test_messages_for_an_experiment_that_pauses_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inside_hub, "_MAX_WAITING", 3)
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",))) as hub:
        transport = InsideTransport(hub)
        beat, notice, goodbye = (Message(kind, "", 0) for kind in (Kind.HEARTBEAT, Kind.NOTICE, Kind.GOODBYE))
        assert all(transport.deliver(beat) for _ in range(100))
        assert [transport.deliver(notice) for _ in range(3)] == [True, True, False]
        assert [transport.deliver(beat), transport.deliver(goodbye)] == [False, True]
        transport.receive_message(0)  # the first returns nothing
        assert [transport.receive_message(0) for _ in range(4)] == [beat, notice, notice, goodbye]


class Interrupting:
    """Raises KeyboardInterrupt at one of the points of a hub's loop where Python may handle Ctrl-C.

    These are the beginning of a function and the return from a call.
    """

    def __init__(self, countdown: int) -> None:
        self.countdown = countdown

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        if event != "c_call" and frame.f_code.co_filename in (loop.__file__, inside_hub.__file__):
            self.countdown -= 1
            if self.countdown == 0:
                sys.setprofile(None)
                raise KeyboardInterrupt


def test_a_verb_that_is_interrupted_anywhere_leaves_the_loop_to_others() -> None:
    """Otherwise the hub could never close, and Ctrl-C would end nothing."""
    places = 0
    finished = False
    while not finished:
        places += 1
        hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",)))
        transport = InsideTransport(hub)
        transport.wait_at_most(0.001)
        sys.setprofile(Interrupting(places))
        try:
            transport.send_message(Message(Kind.HEARTBEAT, "default", 0))
            transport.receive_message(100)
            finished = True
        except KeyboardInterrupt:
            pass
        finally:
            sys.setprofile(None)
        closing = threading.Thread(target=hub.close, daemon=True)
        closing.start()
        closing.join(TIMEOUT)
        assert not closing.is_alive(), f"at place {places}"
    assert places > 10

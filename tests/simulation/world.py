"""A simulated world: processes on one thread, a virtual clock, and every choice from one generator.

A `World` replaces the functions of glue/system, and answers every request of its programs to the
system. A program runs until it waits; then the world chooses the next one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from heapq import heappop, heappush
from random import Random
from threading import get_ident
from typing import Any, Final

from greenlet import GreenletExit, getcurrent, greenlet

from glue.system import chance, clock, network, spinning, threads

READ_SECONDS: Final = 1e-6
"""Virtual time that passes when the clock is read; without it, a loop until some time would never end."""

YIELD_SECONDS: Final = 10e-6


class Stuck(Exception):
    """No program is ready and no event is due, or the run takes far too many turns."""


class Task(greenlet):
    """A thread of a process."""

    process: Process
    blocked = False
    wakes = 0


class Process:
    """A program that can be killed or stopped at any moment.

    Attributes:
        name: name for people.
        number: a number that no other process has.
        alive: whether it has not been killed.
        stopped_until: virtual time before which it gets no core.
        connections: open sockets of the process, in the order of their descriptors.
    """

    def __init__(self, world: World, name: str) -> None:
        world.processes.append(self)
        self.world = world
        self.name = name
        self.number = len(world.processes)
        self.alive = True
        self.stopped_until = 0.0
        self.connections: dict[int, Any] = {}
        self.tasks: list[Task] = []

    def spawn(self, run: Callable[[], object]) -> Task:
        """Start a thread of the process."""

        def guarded() -> None:
            try:
                run()
            except GreenletExit:
                pass
            except BaseException as error:
                self.world.failed(self, error)

        task = Task(guarded, self.world.scheduler)
        task.process = self
        self.tasks.append(task)
        self.world.ready.append(task)
        return task

    def kill(self) -> None:
        """End the process as SIGKILL does: it sends nothing more, and its connections are reset."""
        if not self.alive:
            return
        self.alive = False
        for connection in list(self.connections.values()):
            connection.close()
        self.connections.clear()
        for task in self.tasks:
            if not task.dead and task is not getcurrent():
                task.parent = getcurrent()
                task.throw(GreenletExit)
        self.tasks.clear()


class World:
    """Clock, scheduler and chance of one simulated run.

    Args:
        seed: decides everything that is not decided by the programs.

    Attributes:
        random: the generator of the schedule and of latencies.
        now: virtual time in seconds.
        failures: errors that no program may end with.
        turns: number of times that a program was given the core.
        processes: all processes ever started.
    """

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.bytes = Random(seed + 1)
        self.now = 1000.0
        self.scheduler = getcurrent()
        self.ready: list[Task] = []
        self.failures: list[str] = []
        self.turns = 0
        self.processes: list[Process] = []
        self._events: list[tuple[float, int, Callable[..., object], tuple[Any, ...]]] = []
        self._number = 0

    # The scheduler.

    def at(self, time: float, act: Callable[..., object], *args: Any) -> None:
        """Call `act` at a virtual time."""
        self._number += 1
        heappush(self._events, (time, self._number, act, args))

    def run(self, done: Callable[[], bool], max_turns: int) -> None:
        """Run until `done`.

        Raises:
            Stuck: nothing can happen any more, or it takes too many turns.
        """
        ready, events, choose = self.ready, self._events, self.random.random
        while True:
            if not self.turns % 16 and done():
                return
            while events and events[0][0] <= self.now:
                _, _, act, args = heappop(events)
                act(*args)
            if ready:
                chosen = int(choose() * len(ready))
                ready[chosen], ready[-1] = ready[-1], ready[chosen]
                task = ready.pop()
                if task.dead or not task.process.alive:
                    continue
                if task.process.stopped_until > self.now:
                    self.at(task.process.stopped_until, ready.append, task)
                    continue
                self.turns += 1
                if self.turns > max_turns:
                    raise Stuck(f"no end after {max_turns} turns")
                task.switch()
            elif events:
                self.now = max(self.now, events[0][0])
            else:
                raise Stuck("nothing will happen any more")

    def block(self, seconds: float | None = None) -> None:
        """Wait until `wake`, or for `seconds`."""
        task: Any = getcurrent()
        if not task.process.alive:
            raise GreenletExit
        task.blocked = True
        if seconds is not None:
            self.at(self.now + seconds, self._time_out, task, task.wakes)
        self.scheduler.switch()

    def _time_out(self, task: Task, wakes: int) -> None:
        if task.wakes == wakes:
            self.wake(task)

    def wake(self, task: Task) -> None:
        """Let a blocked task continue."""
        if task.blocked:
            task.blocked = False
            task.wakes += 1
            self.ready.append(task)

    def failed(self, process: Process, error: BaseException) -> None:
        """Note that a program has ended with an unexpected error."""
        import traceback

        if process.alive:
            text = "".join(traceback.format_exception(error))
            self.failures.append(f"{process.name} failed: {type(error).__name__}: {error}\n{text}")

    # The functions that replace those of glue/system.

    def monotonic(self) -> float:
        """Return the virtual time."""
        self.now += READ_SECONDS
        return self.now

    def sleep(self, seconds: float) -> None:
        """Wait."""
        self.block(max(seconds, 0.0))

    def give_way(self) -> None:
        """Let another program run."""
        task: Any = getcurrent()
        self.now += YIELD_SECONDS
        if not task.process.alive:
            raise GreenletExit
        self.ready.append(task)
        self.scheduler.switch()

    def random_bytes(self, size: int) -> bytes:
        """Return the next bytes of the seed."""
        return self.bytes.randbytes(size)

    @contextmanager
    def entered(self, net: Any) -> Iterator[None]:
        """Replace the functions of glue/system while the body of the `with` runs.

        Other threads, such as one that an earlier test has left, still get the real ones, or they would take
        time and random bytes from the run.
        """
        replaced: list[tuple[Any, str, Any]] = [
            (clock, "monotonic", self.monotonic),
            (clock, "sleep", self.sleep),
            (clock, "give_way", self.give_way),
            (chance, "random_bytes", self.random_bytes),
            (threads, "RLock", partial(_RLock, self)),
            (threads, "Event", partial(_Event, self)),
            (threads, "Thread", partial(_Thread, self)),
            *((network, name, value) for name, value in net.functions().items()),
        ]
        here = [(owner, name, _here(value, getattr(owner, name))) for owner, name, value in replaced]
        with replacing([*here, (spinning, "SEVERAL_CORES", False)]):
            yield


def _here(simulated: Callable[..., Any], real: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that is `simulated` in this thread, and `real` in others."""
    thread = get_ident()
    return lambda *given, **more: (simulated if get_ident() == thread else real)(*given, **more)


@contextmanager
def replacing(attributes: Sequence[tuple[Any, str, Any]]) -> Iterator[None]:
    """Give attributes, as (owner, name, value), other values while the body of the `with` runs."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in attributes]
    for owner, name, value in attributes:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


class _RLock:
    """A lock between the threads of simulated processes, which none acquires twice."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._owner: Any = None
        self._waiting: list[Any] = []

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Acquire it, if it is free now or within `timeout` seconds; -1 waits for ever."""
        until = self._world.now + timeout if timeout >= 0 else math.inf
        while self._owner is not None:
            left = until - self._world.now
            if not blocking or left <= 0:
                return False
            self._waiting.append(getcurrent())
            self._world.block(None if left == math.inf else left)
        self._owner = getcurrent()
        return True

    def release(self) -> None:
        if self._owner is not getcurrent():
            raise RuntimeError("cannot release un-acquired lock")
        self._owner = None
        waiting, self._waiting = self._waiting, []
        for task in waiting:
            self._world.wake(task)


class _Event:
    """An event between the threads of simulated processes."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._set = False
        self._waiting: list[Any] = []

    def set(self) -> None:
        self._set = True
        for task in self._waiting:
            self._world.wake(task)
        self._waiting.clear()

    def is_set(self) -> bool:
        return self._set

    def wait(self, timeout: float | None = None) -> bool:
        if not self._set:
            self._waiting.append(getcurrent())
            self._world.block(timeout)
        return self._set


class _Thread:
    """A thread of the process that starts it."""

    def __init__(self, world: World, *, target: Callable[[], object], name: str, daemon: bool) -> None:
        self._run = target
        self._ended = _Event(world)

    def start(self) -> None:
        current: Any = getcurrent()

        def run() -> None:
            try:
                self._run()
            finally:
                self._ended.set()

        current.process.spawn(run)

    def join(self, timeout: float | None = None) -> None:
        self._ended.wait(timeout)

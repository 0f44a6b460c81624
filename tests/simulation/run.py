"""One seed: a topology, its programs, its faults, and whether every promise was kept."""

from __future__ import annotations

import errno
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

from greenlet import getcurrent

from glue.client import link
from glue.client.experiment import connect
from glue.client.observer import observe
from glue.client.players import serve_agent, serve_environment
from glue.client.sockets import open_transport
from glue.errors import GlueError, HubClosed, HubUnreachable, PeerFailed, PeerLost, Refused
from glue.hub.config import Bind, HubConfig, Keys, Permit
from glue.hub.io import channels
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.keys.certificates import KeyPair, write_pair
from glue.pace import Pace
from glue.system import clock, network
from glue.wire import zmtp
from glue.wire.messages import PROTOCOL_VERSION, Kind, Message, Role
from glue.wire.stream import Stream
from tests.simulation.faults import Fault, drawn
from tests.simulation.lying import Lying
from tests.simulation.net import CAPACITY, Net, Socket
from tests.simulation.programs import Block, agent, environment, expected, play, play_timed
from tests.simulation.watching import Watch
from tests.simulation.world import Process, Stuck, World, replacing

PORT: Final = 4097
URL: Final = f"tcp://127.0.0.1:{PORT}"

BOUND: Final = 90.0
"""Virtual seconds within which every session finishes once faults have ended."""

MAX_TURNS: Final = 300_000


class Outcome(NamedTuple):
    """The result of a run.

    Attributes:
        problems: promises that were broken; empty if none was.
        faults: the faults that happened.
        reached: number of times that each situation occurred, by its name.
        blocks: number of blocks that were compared.
        voids: number of blocks that were void.
        trace: events, a line each; empty unless requested.
        seconds: virtual duration.
    """

    problems: list[str]
    faults: list[Fault]
    reached: Counter[str]
    blocks: int
    voids: int
    trace: list[Any]
    seconds: float


@cache
def key_files() -> tuple[tempfile.TemporaryDirectory[str], KeyPair, KeyPair, Path, Path]:
    """Return a folder with the keys of a hub and of its peers, and these keys."""
    from glue.wire.curve import public_key

    folder = tempfile.TemporaryDirectory()
    pairs = [KeyPair(public_key(secret), secret) for secret in (bytes(range(32)), bytes(range(1, 33)))]
    files = [
        write_pair(Path(folder.name), name, pair) for name, pair in zip(("hub", "peer"), pairs, strict=True)
    ]
    return folder, pairs[0], pairs[1], files[0][0], files[1][1]


class Session:
    """One session of the topology: its experiment and what it has seen.

    Attributes:
        blocks: number of blocks that the experiment has finished.
        experiments: number of experiments that have joined it.
        over: whether the experiment has left for good.
    """

    def __init__(self, name: str, random: Random, beside: bool) -> None:
        self.name = name
        self.bulk = random.choice((0, 0, 0, 40, 1500))
        self.many = random.random() < 0.15
        self.beside = beside and not self.many
        self.slow = random.choice((0.0, 0.0, 0.0, 0.0, 0.01, 1.3))
        self.late = random.choice((0.0, 0.0, 0.2, 3.0))
        self.random = Random(random.randrange(2**31))
        self.blocks = 0
        self.experiments = 0
        self.calls = 0
        self.thinking = random.choice((0.0, 0.0, 0.0, 0.4))
        self.voids = 0
        self.over = False

    def next_block(self) -> Block:
        """Return the block to play."""
        random = self.random
        styles = tuple(random.choice((0, 0, 1, 2, 3)) for _ in range(random.randint(1, 3)))
        return Block(random.randrange(40), styles, random.choice((1, 3, 8)))

    def think(self) -> None:
        """Let the experiment do something else, now and then."""
        if self.thinking and self.random.random() < 0.2:
            clock.sleep(self.thinking)

    def pause(self) -> None:
        """Think for a while, now and then."""
        self.calls += 1
        if self.slow and self.calls % 7 == 0:
            clock.sleep(self.slow)


def _is_whole(data: bytes) -> bool:
    """Return whether these bytes are whole messages: TCP never repeats a part of what was sent."""
    at, more = 0, 0
    while at + 2 <= len(data):
        flags = data[at]
        more = flags & 1
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "big") if flags & 2 else 2 + data[at + 1]
    return at == len(data) > 20 and data[0] in (1, 3) and not more


class Run:
    """A run of one seed."""

    def __init__(self, seed: int, faults: Sequence[Fault], trace: bool) -> None:
        random = Random(seed)
        self.seed = seed
        self.world = World(seed)
        self.net = Net(self.world)
        self.net.on_send = self._on_send
        self.plan = list(reversed(faults))
        self.happened: list[Fault] = []
        self.problems: list[str] = []
        self.calm_since = 0.0
        self.inside = random.random() < 0.15
        self.keyed = not self.inside and random.random() < 0.12
        number = 1 if self.inside else random.choice((1, 1, 1, 2, 3, 8))
        self.sessions = [Session(f"s{n}", random, seed % 5 == 1) for n in range(number)]
        self.several = number > 1 and random.random() < 0.4
        pieces = Random(f"pieces {seed}")
        self.joint = self.several and pieces.random() < 0.5
        self.copied = 300 if self.joint or pieces.random() < 0.3 else 65_536
        self.small = random.random() < 0.15 and not self.inside
        if self.small:
            for session in self.sessions:
                session.bulk = min(session.bulk, 40)
        elif pieces.random() < 0.2:
            pieces.choice(self.sessions).bulk = 60_000
        self.unsent = random.choice((64 * 2**20, 64 * 2**20, 400))
        self.pace = self._draw_pace()
        self.heartbeat = random.choice((1.0, 1.0, 0.2))
        self.timeout = random.choice((5.0, 5.0, 1.5))
        self.hub: Process
        self.hubs: list[Process] = []
        self.players: list[tuple[Process, Callable[[bool], Process]]] = []
        self.experiments: dict[str, Process] = {}
        self.liar = self._draw_liar()
        self.liars: dict[int, Callable[[Any], Any]] = {}
        self.watch = Watch(self, trace)
        self.random = Random(seed + 7)

    def _draw_pace(self) -> Pace:
        """Return the pace of the environments, which wait in most of the runs."""
        random = Random(f"clock {self.seed}")
        if random.random() >= 0.15:
            return Pace()
        for session in self.sessions:
            session.many = False  # many games at once have no pace
        if random.random() < 0.3 or (self.inside and self.seed % 4 == 2):
            return Pace(delay=random.randint(1, 3))
        return Pace(random.choice((2.0, 20.0, 200.0)), random.choice(("repeat", "7")))

    def _draw_liar(self) -> tuple[Role, Session] | None:
        """Return the player that lies, in some of the runs."""
        random = Random(f"lies {self.seed}")
        if random.random() >= 0.3:
            return None
        return random.choice((Role.AGENT, Role.ENVIRONMENT)), random.choice(self.sessions)

    # Programs.

    def _config(self) -> HubConfig:
        bind: str | Bind = URL
        if self.keyed:
            _, hub, peer, _, _ = key_files()
            bind = Bind(URL, keys=Keys(hub.secret, {peer.public: Permit("peer", frozenset(Role))}))
        limits: dict[str, Any] = {"max_memory": 2**30, "pace": self.pace}
        if self.small:
            number = len(self.sessions)
            limits |= {"max_body": 4096, "max_memory": 2**16 * number + 4 * 4096, "max_sessions": 4 * number}
        return HubConfig(bind=(bind,), heartbeat=self.heartbeat, timeout=self.timeout, **limits)

    def _key(self) -> dict[str, Any]:
        if not self.keyed:
            return {}
        _, _, _, hub, peer = key_files()
        return {"key": peer, "hub_key": hub}

    def start_hub(self) -> None:
        """Start a hub, with or without the experiment inside."""
        process = self.hub = Process(self.world, f"hub {len(self.hubs) + 1}")
        self.hubs.append(process)
        process.spawn(partial(self._run_hub, process))

    def _run_hub(self, process: Process) -> None:
        log = self.watch.log(process)
        while True:
            try:
                hub = Hub(self._config(), log)
                break
            except GlueError:
                clock.sleep(0.1)  # the port of the previous hub is not free yet
        self.watch.started(process, hub)
        if not self.inside:
            hub.run()
            return
        session = self.sessions[0]
        here: dict[Role, Any] = {}
        which = self.seed % 4
        if which == 1:
            here[Role.ENVIRONMENT] = environment(session.bulk, session.many, beside=session.beside)
        elif which == 2:
            here[Role.AGENT] = agent(session.bulk, session.many, beside=session.beside)
        with hub, hub.in_background():
            from glue.client.experiment import connect_over

            with connect_over(InsideTransport(hub, here, session.name), session.name) as glue:
                while not session.over:
                    self._play(glue, session)

    def _ends(self) -> bool:
        """Return whether an experiment may leave: no fault is left."""
        return not self.plan

    def _experiment(self, session: Session) -> None:
        while not session.over:
            try:
                with connect(URL, session.name, wait=None, **self._key()) as glue:
                    self._look_around(glue, session)
                    while not session.over:
                        self._play(glue, session)
            except Refused as error:
                self.watch.reached(f"experiment refused: {_code(error)}")
                clock.sleep(0.3)
            except HubClosed as error:
                self.watch.closed(session, error)
                clock.sleep(0.1)

    def _look_around(self, glue: Any, session: Session) -> None:
        """Judge (h): an experiment that joins finds nothing of one before it."""
        session.experiments += 1
        if session.experiments > 1:
            found = glue.rl_return(), glue.rl_num_steps(), glue.rl_num_episodes()
            if found != (0.0, 0, 0):
                self.problems.append(f"(h) a new experiment of {session.name} finds the counts {found}")

    def _play(self, glue: Any, session: Session) -> None:
        """Play one block, again and again until it is not void."""
        last = self._ends()
        block = session.next_block()
        began = self.world.now
        while True:
            try:
                if self.pace.rate:
                    wrong = play_timed(glue, block, session.bulk, session.beside, session.think)
                else:
                    seen = play(glue, block, session.think)
                break
            except (PeerLost, PeerFailed) as error:
                session.voids += 1
                self.watch.void(session, error, began)
                began = self.world.now
        session.blocks += 1
        if self.pace.rate:
            if wrong:
                self.problems.append(f"(b) session {session.name}: {block}: {wrong}")
        elif seen != (known := expected(block, session.bulk, session.many, session.beside, self.pace)):
            at = next((n for n, (a, b) in enumerate(zip(seen, known, strict=False)) if a != b), -1)
            self.problems.append(
                f"(b) session {session.name}: {block} differs from a run in one process at {at}: "
                f"{seen[at]!r:.80} instead of {known[at]!r:.80}"
            )
        if last:
            session.over = True

    def _player(self, role: Role, sessions: Sequence[Session], delay: float) -> None:
        def start(kept: bool, players: dict[str, Any] | None = None) -> Process:
            make: Any = agent if role is Role.AGENT else environment
            if players is None or not kept:
                players = {
                    each.name: make(each.bulk, each.many, each.pause, each.beside) for each in sessions
                }
            process = Process(self.world, f"{role} of {','.join(each.name for each in sessions)}")
            if self.liar is not None and self.liar[0] is role and self.liar[1] in sessions:
                self.liars[process.number] = partial(
                    Lying,
                    random=Random(f"lies {self.seed} {process.number}"),
                    others=[each.name for each in self.sessions if each not in sessions],
                    honest=self._ends,
                    harmed=self.watch.leaves,
                )
            process.spawn(partial(self._serve, role, players, delay))
            again = partial(start, players=players)
            self.players.append((process, again))
            self.watch.player(process, role, [each.name for each in sessions])
            return process

        start(False)

    def _serve(self, role: Role, players: dict[str, Any], delay: float) -> None:
        if delay:
            clock.sleep(delay)
        refused = 0.3
        while True:
            try:
                if role is Role.AGENT:
                    serve_agent(players, URL, wait=None, **self._key())
                else:
                    serve_environment(players, URL, wait=None, **self._key())
                self.watch.reached("player: the hub said goodbye")
            except Refused as error:
                self.watch.reached(f"player refused: {_code(error)}")
                refused = min(2 * refused, 5.0)
            clock.sleep(refused)

    def _open_transport(self, *how: Any) -> Any:
        """Return a connection of the running program, which may be a liar's."""
        current: Any = getcurrent()
        lying = self.liars.get(current.process.number, lambda transport: transport)
        return lying(open_transport(*how))

    def _observe(self, session: str) -> None:
        try:
            with observe(URL, session, wait=5.0, **self._key()) as observer:
                for _ in range(20):
                    observer.want(3)
                    if observer.receive() is not None:
                        self.watch.reached("observer: saw something")
        except (Refused, HubClosed, HubUnreachable) as error:
            self.watch.reached(f"observer: {type(error).__name__}")

    def _stranger(self, how: int) -> None:
        """Connect and misbehave."""
        random = Random(how)
        try:
            with network.socket() as raw:
                try:
                    raw.connect(("127.0.0.1", PORT))
                except BlockingIOError:
                    clock.sleep(0.01)
                raw.settimeout(0.5)
                kind = how % 6
                if kind == 0:
                    raw.send(random.randbytes(random.randrange(1, 300)))
                    raw.recv(1000)
                    return
                stream = Stream(zmtp.DEALER, 2**20)
                raw.send(zmtp.GREETING)
                while not stream.ready:
                    stream.receive_data(raw.recv(1000) or _raise())
                    while (event := stream.next_event()) is not None:
                        raw.send(bytes(event))  # type: ignore[arg-type]
                if kind == 1:
                    raw.send(random.randbytes(random.randrange(1, 300)))
                elif kind == 2:
                    # A frame that is announced but never complete: as much of it as the hub keeps.
                    for _ in range(20):
                        raw.send(
                            b"\x02" + (5000).to_bytes(8, "big") + random.randbytes(random.randrange(4900))
                        )
                        clock.sleep(0.05)
                else:
                    role = random.choice((*Role, "nobody"))
                    name = random.choice((f"stranger-{how}", f"stranger-{how}", "", "s0"))
                    session = name if role is Role.OBSERVER or name != "s0" else "stranger"
                    versions = (PROTOCOL_VERSION,) if random.random() < 0.8 else (99,)
                    size = 16 if random.random() < 0.8 else 3
                    scalars = (versions, str(role), random.randbytes(size), "stranger", "bytes", ())
                    messages = [Message(Kind.HELLO, session, 1, scalars)]
                    for _ in range(random.randrange(8)):
                        number = random.randrange(4)
                        messages.append(
                            random.choice(
                                (
                                    messages[0],
                                    Message(Kind.ENV_STEP, session, number, (1.0, False), bytes(12)),
                                    Message(Kind.AGENT_INIT, session, number),
                                    Message(Kind.RL_INIT, session, number),
                                    Message(Kind.RL_STEP, session, number),
                                    Message(Kind.HEARTBEAT, session, number),
                                    Message(Kind.ERROR, session, number, ("x", "y")),
                                )
                            )
                        )
                    for message in messages:
                        data = b"".join(stream.encode(message))
                        if kind == 5 and random.random() < 0.3:
                            data = data[:9] + random.randbytes(1) + data[10:]
                        raw.send(data)
                raw.recv(1000)
                clock.sleep(random.choice((0.0, 2.0)))
                raw.recv(1000)
        except (OSError, GlueError):
            self.watch.reached("stranger: turned away")

    # Faults.

    def _on_send(self, sender: Socket, data: bytes) -> float | None:
        late: float | None = 0.0
        while self.plan and self.plan[-1].at <= self.net.sends:
            fault = self.plan.pop()
            self.happened.append(fault)
            self.watch.fault(fault, sender, data)
            if late is not None:
                late = self._apply(fault, sender, data)
            else:
                self._apply_elsewhere(fault)
        return late

    def _lasts(self, seconds: float) -> None:
        """Note that the effects of a fault last for `seconds`."""
        self.calm_since = max(self.calm_since, self.world.now + seconds)

    def _apply(self, fault: Fault, sender: Socket, data: bytes) -> float | None:
        """Apply a fault to sent bytes; return their delay, or None if they are on their way or lost."""
        world, net, seconds = self.world, self.net, fault.seconds
        peer = sender.peer
        assert peer is not None
        self._lasts(seconds)
        if fault.kind in ("break", "close"):
            part = fault.which % (len(data) + 1)
            if part:
                net.transmit(sender, data[:part])
            self.watch.trouble(sender, 0.0)
            net.cut(sender, fault.kind == "close")
            return None
        if fault.kind == "late":
            self.watch.trouble(sender, seconds)
            return seconds
        if fault.kind == "dribble":
            sender.dribble = peer.dribble = 40 + fault.which % 200
        elif fault.kind == "clog":
            self._clog(sender, seconds)
            world.at(world.now + seconds, self._clog, peer, seconds)
            self._lasts(2 * seconds)
        elif fault.kind == "silence":
            self._clog(sender, seconds)
            self._clog(peer, seconds)
        elif fault.kind == "narrow":
            sender.capacity = peer.capacity = 50 + fault.which % 500
            world.at(world.now + seconds, self._widen, sender)
        elif fault.kind == "again":
            if not self.keyed and sender.sent > 200 + len(data) and _is_whole(data):
                net.transmit(sender, data)
                self.watch.order.repeated(sender)
        else:
            self._apply_elsewhere(fault)
        return 0.0

    def _widen(self, sender: Socket) -> None:
        for end in (sender, sender.peer):
            if end is not None:
                end.capacity = CAPACITY
                end.notify()

    def _clog(self, sender: Socket, seconds: float) -> None:
        """Let nothing arrive for a while; the system gives up a connection without acknowledgements."""
        world = self.world
        sender.clogged_until = max(sender.clogged_until, world.now + seconds)
        self.watch.trouble(sender, seconds)
        if seconds > 5.0:
            world.at(world.now + 5.0, self._give_up, sender)

    def _give_up(self, sender: Socket) -> None:
        if sender.clogged_until > self.world.now and not sender.closed and not sender.lost:
            self.net.reset(sender, errno.ETIMEDOUT)
            peer = sender.peer
            if peer is not None:
                # The peer notices when its next packet arrives.
                self.world.at(sender.clogged_until, self.net.reset, peer)

    def _apply_elsewhere(self, fault: Fault) -> None:
        """Apply a fault that concerns a program."""
        world, seconds, kind = self.world, fault.seconds, fault.kind
        self._lasts(seconds)
        if kind in ("kill", "stop", "twin"):
            alive = [entry for entry in self.players if entry[0].alive]
            if not alive:
                return
            process, again = alive[fault.which % len(alive)]
            kept = fault.which % 7 > 2
            if kind == "stop":
                if fault.which % 5 == 0:
                    process = self.hub
                process.stopped_until = world.now + seconds
                self.watch.stopped(process, seconds)
            elif kind == "twin":
                if sum(entry[0].alive for entry in self.players) < 30:
                    again(False)
            else:
                self.watch.killed(process)
                process.kill()
                world.at(world.now + seconds, again, kept)
        elif kind == "hub":
            if not self.inside and self.hub.alive:
                self.watch.killed(self.hub)
                self.hub.kill()
                world.at(world.now + seconds, self.start_hub)
        elif kind == "experiment":
            if self.inside:
                return
            session = self.sessions[fault.which % len(self.sessions)]
            running = self.experiments[session.name]
            if running.alive and not session.over:
                self.watch.killed(running)
                running.kill()
                world.at(world.now + seconds, self._start_experiment, session)
        elif kind == "jump":
            world.now += seconds
            self.watch.stopped(None, seconds)
        elif kind == "stranger":
            Process(world, "stranger").spawn(partial(self._stranger, fault.which))
        elif kind == "observer":
            name = self.sessions[fault.which % len(self.sessions)].name
            Process(world, "observer").spawn(partial(self._observe, name))

    def _start_experiment(self, session: Session) -> None:
        process = self.experiments[session.name] = Process(self.world, f"experiment of {session.name}")
        process.spawn(partial(self._experiment, session))

    # The run.

    def go(self) -> None:
        """Run until every session has finished."""
        world = self.world
        here = self.seed % 4 if self.inside else 0
        changed: list[tuple[Any, str, Any]] = [
            (channels, "MAX_UNSENT", self.unsent),
            (channels, "_MAX_COPIED", self.copied),
            (link, "open_transport", self._open_transport),
        ]
        with self.watch.entered(), world.entered(self.net), replacing(changed):
            self.start_hub()
            environments = [] if here == 1 else self.sessions
            agents = [] if here == 2 else self.sessions
            if self.joint:
                self._player(Role.ENVIRONMENT, environments, 0.0)
            else:
                for session in environments:
                    self._player(Role.ENVIRONMENT, [session], session.late)
            if self.several:
                self._player(Role.AGENT, agents, 0.0)
            else:
                for session in agents:
                    self._player(Role.AGENT, [session], session.late / 2)
            if not self.inside:
                for session in self.sessions:
                    self._start_experiment(session)
            try:
                world.run(self._done, MAX_TURNS)
            except Stuck as stuck:
                self.problems.append(f"(e) {stuck}; unfinished: {self._unfinished()}")
            finally:
                self.problems += world.failures
                for process in world.processes:
                    process.kill()

    def _unfinished(self) -> str:
        return ", ".join(session.name for session in self.sessions if not session.over)

    def _done(self) -> bool:
        if all(session.over for session in self.sessions):
            return True
        if self.problems or self.world.failures:
            return True
        if not self.plan and self.world.now > max(self.calm_since, self.watch.last) + BOUND:
            self.problems.append(
                f"(e) {self.world.now - self.calm_since:.0f} s after the last fault, "
                f"unfinished: {self._unfinished()}"
            )
            return True
        return False


def _code(error: Exception) -> str:
    return " ".join(str(error).split(": ")[-1].split()[:3])


def _raise() -> bytes:
    raise ConnectionResetError


def simulate(seed: int, faults: Sequence[Fault] | None = None, trace: bool = False) -> Outcome:
    """Run one seed, with its own faults or with some of them."""
    run = Run(seed, drawn(seed) if faults is None else faults, trace)
    began = run.world.now
    run.go()
    return Outcome(
        run.problems,
        run.happened,
        run.watch.seen,
        sum(session.blocks for session in run.sessions),
        sum(session.voids for session in run.sessions),
        run.watch.lines,
        run.world.now - began,
    )

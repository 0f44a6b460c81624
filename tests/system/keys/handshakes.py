"""Mutated CURVE handshakes against a running hub:

    python -m tests.system.keys.handshakes 100000

A hub with keys serves an honest session, while a peer that holds a valid key connects again and again and
mutates its own messages: bits, bytes, lengths, order, the end. Or it replays the messages of another
connection. The hub must admit none of these messages and keep nothing of them, and the honest session must
continue as if it were alone.
"""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from glue import make, make_agent
from glue.client.experiment import RemoteExperiment, connect
from glue.client.players import serve_agent, serve_environment
from glue.engine.local import local
from glue.errors import GlueError
from glue.keys.certificates import read_pair, read_public
from glue.wire.messages import Kind
from tests.keyed import KeyFolder
from tests.scripted.curve import GREETING, CurveClient, Pair, command
from tests.scripted.peer import ScriptedPeer, hello_scalars

STAGES = ("greeting", "hello", "initiate", "message", "replay")
SESSION = "attacked"
SEED = 20260731
REFUSAL = b"\x04\x0a\x05ERROR\x03400"
_TIMEOUT = 60.0
_MAX_STEPS = 200
_GROWTH = 4 * 2**20
"""Bytes by which the hub may have grown in the end, for its allocator and its log's queue."""


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Return a mutation of `data` that does not begin with `data`."""
    mutations: list[Callable[[int, int], bytes]] = [
        lambda at, size: data[:at] + bytes((data[at] ^ 1 << chance.randrange(8),)) + data[at + 1 :],
        lambda at, size: data[:at] + chance.randbytes(size) + data[at + size :],
        lambda at, size: data[:at] + data[at + size :],
        lambda at, size: data[:at] + chance.randbytes(size) + data[at:],
        lambda at, size: data[:at] + data[at : at + size] + data[at:],
        lambda at, size: data[:at],
        lambda at, size: data[:at] + bytes(len(data) - at),
        lambda at, size: data[:at] + data[at:][::-1],
    ]
    while True:
        at = chance.randrange(len(data)) if chance.random() < 0.8 else chance.randrange(min(12, len(data)))
        made = chance.choice(mutations)(at, chance.randint(1, 40))
        if not made.startswith(data):
            return made


def _may_greet(greeting: bytes) -> bool:
    """Return whether a mutated greeting is as legal as ours: most of its plain text means nothing."""
    return (
        len(greeting) >= 64
        and greeting[0] == 0xFF
        and greeting[9] & 1 == 1
        and greeting[10] >= 3
        and greeting[12:33].rstrip(b"\0") == b"CURVE"
    )


class Mutant:
    """A peer that connects to a hub again and again, with a valid key and one mutation.

    Attributes:
        tried: number of handshakes of each stage.
        late: number of handshakes that the hub ended before the mutation, since they had taken too long.
    """

    def __init__(self, url: str, own: Pair, server: bytes, seed: int) -> None:
        self._url = url
        self._own, self._server = own, server
        self._short = Pair.new()
        self._chance = random.Random(seed)
        self._recorded: list[tuple[bytes, bytes, bytes]] = []
        self.tried: Counter[str] = Counter()
        self.late = 0

    def attack(self) -> None:
        """Try one handshake; fail if the hub admits any of it."""
        stage = self._chance.choice(STAGES)
        self.tried[stage] += 1
        keys = CurveClient(self._own, self._server, self._short)
        with ScriptedPeer(self._url, keys, session=SESSION) as peer, suppress(ConnectionError):
            answer = self._go_through(peer.connect(), keys, stage)
            if stage == "hello":
                answer = answer.removeprefix(REFUSAL)  # the box of the mutated HELLO cannot be opened
            assert answer == b"", f"a mutated {stage} was answered with {answer[:20]!r}"

    def _go_through(self, peer: ScriptedPeer, keys: CurveClient, stage: str) -> bytes:
        """Complete the handshake up to a stage, and mutate that; return the hub's answer to the mutation."""
        hello = command(keys.hello())
        if stage == "greeting":
            greeting = mutated(GREETING, self._chance)
            answer = self._end(peer, greeting + hello)
            return b"" if _may_greet(greeting) else answer[64:]
        peer.send_bytes(GREETING)
        peer.read(64)
        if stage == "hello":
            return self._end(peer, mutated(hello, self._chance))
        if stage == "replay" and self._recorded:
            recorded = self._chance.choice(self._recorded)
            if self._chance.random() < 0.5:
                return self._end(peer, b"".join(recorded[1:]))
            peer.send_bytes(recorded[0])
            peer.read_frame()  # WELCOME: a HELLO proves nothing
            return self._end(peer, b"".join(recorded[1:]))
        peer.send_bytes(hello)
        keys.welcome(self._answer(peer))
        initiate = command(keys.initiate())
        if stage == "initiate":
            return self._end(peer, mutated(initiate, self._chance))
        peer.send_bytes(initiate)
        keys.ready(self._answer(peer))
        message = peer.encoded(*peer.frames_of(Kind.HELLO, 1, *hello_scalars("experiment", "mutant")))
        if len(self._recorded) < 100:
            self._recorded.append((hello, initiate, message))
        return self._end(peer, mutated(message, self._chance))

    def _answer(self, peer: ScriptedPeer) -> bytes:
        """Return the hub's command, unless a busy hub has dropped the peer after a second."""
        try:
            return peer.read_frame()[1]
        except ConnectionError:
            self.late += 1
            raise

    def _end(self, peer: ScriptedPeer, data: bytes) -> bytes:
        peer.send_bytes(data)
        peer.socket.shutdown(socket.SHUT_WR)
        return peer.read_to_end()


@dataclass
class Honest:
    """A session that plays the same episodes as alone, over and over.

    Attributes:
        episodes: number of episodes played.
        wrong: the first result that differs; empty if none does.
    """

    glue: RemoteExperiment
    episodes: int = 0
    wrong: str = ""

    def play(self, ended: threading.Event) -> None:
        """Play until `ended` is set."""
        with local(make_agent("random"), make("mines")) as alone:
            while not ended.is_set() and not self.wrong:
                for glue in (self.glue, alone):
                    glue.rl_init(seed=self.episodes)
                    glue.rl_episode(_MAX_STEPS)
                    glue.rl_cleanup()
                expected = alone.rl_return(), alone.rl_num_steps()
                result = self.glue.rl_return(), self.glue.rl_num_steps()
                if result != expected:
                    self.wrong = f"episode {self.episodes}: {result}, alone {expected}"
                self.episodes += 1


@contextmanager
def keyed_hub(folder: KeyFolder, log: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A hub with these keys in a process of its own, and its URL."""
    program = "from glue.cli.hub import main; main()"
    options = ["--bind", "tcp://127.0.0.1:*", "--keys", str(folder.path), "--heartbeat", "0.2"]
    with log.open("wb") as output:
        hub = subprocess.Popen([sys.executable, "-c", program, *options], stderr=output)
    try:
        deadline = time.monotonic() + _TIMEOUT
        while "listening on " not in (said := log.read_text()) or not said.endswith("\n"):
            assert time.monotonic() < deadline, said
            assert hub.poll() is None, said
            time.sleep(0.01)
        yield hub, said.partition("listening on ")[2].split()[0]
    finally:
        hub.terminate()
        hub.wait(_TIMEOUT)


@contextmanager
def honest_session(url: str, folder: KeyFolder, key: Path) -> Iterator[Honest]:
    """A session of three peers with keys that plays while the body runs."""
    place = {"key": key, "hub_key": folder.hub_key}
    ended = threading.Event()

    def serve(serve_one: Callable[..., str], player: object) -> None:
        with suppress(GlueError):
            serve_one(player, url, "honest", **place)

    players = [(serve_agent, make_agent("random")), (serve_environment, make("mines"))]
    for pair in players:
        threading.Thread(target=serve, args=pair, daemon=True).start()
    with connect(url, "honest", **place) as glue:  # type: ignore[arg-type]
        honest = Honest(glue)
        playing = threading.Thread(target=honest.play, args=(ended,), daemon=True)
        playing.start()
        try:
            yield honest
        finally:
            ended.set()
            playing.join(_TIMEOUT)


def resident(pid: int) -> int:
    """Return the resident memory of a process, in bytes."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def open_files(pid: int) -> int:
    """Return the number of descriptors that a process has open."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def run(number: int, folder: Path, seed: int = SEED) -> str:
    """Try a number of handshakes; return a line about the outcome."""
    keys = KeyFolder(folder)
    key = keys.entrant("carol")
    roles = '["agent", "environment", "experiment"]'
    keys.allow(f'[carol]\nrole = {roles}\nsession = ["honest", "{SESSION}"]')
    pair, log = read_pair(key), folder / "log"
    with ExitStack() as stack:
        hub, url = stack.enter_context(keyed_hub(keys, log))
        honest = stack.enter_context(honest_session(url, keys, key))
        mutant = Mutant(url, Pair(pair.public, pair.secret), read_public(keys.hub_key), seed)
        for _ in range(max(50, number // 10)):
            mutant.attack()
        memory, files = resident(hub.pid), open_files(hub.pid)
        played, began = honest.episodes, time.monotonic()
        for _ in range(number - max(50, number // 10)):
            mutant.attack()
        seconds = time.monotonic() - began
        deadline = time.monotonic() + _TIMEOUT
        while open_files(hub.pid) > files and time.monotonic() < deadline:
            time.sleep(0.05)
        assert open_files(hub.pid) <= files, "the hub has kept connections"
        growth = resident(hub.pid) - memory
        assert growth < _GROWTH, f"the hub has grown by {growth} bytes"
        assert hub.poll() is None
        assert not honest.wrong, honest.wrong
        assert honest.episodes > played, "the honest session stood still"
        assert mutant.late <= number // 20, f"{mutant.late} of {number} were ended before anything was wrong"
        said = log.read_text()
        assert SESSION not in said, "somebody has joined"
        assert "please report" not in said
        tried = ", ".join(f"{count} {stage}" for stage, count in sorted(mutant.tried.items()))
        return (
            f"{number} handshakes ({tried}): nothing in, {growth / 1024:.0f} KiB more, "
            f"{honest.episodes - played} episodes of the honest session as alone, {seconds:.0f} s"
        )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        print(run(int(sys.argv[1]), Path(made)))

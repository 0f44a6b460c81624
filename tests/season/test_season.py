"""A season on a fast calendar: 20 entrants in three languages come and go, the organiser acts, and the server
is killed again and again.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, Final

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
pytest.importorskip("uvicorn", reason="needs uvicorn: pip install 'glue-rl[web]'")

from msgspec.structs import replace

from experiment_runner.competition.course import course_of
from experiment_runner.competition.season.board import ORGANISER, SeasonBoard, season_board
from experiment_runner.competition.season.control import NoServer, ask
from experiment_runner.competition.state import State
from experiment_runner.store.results import Results
from glue.client.libzmq import new_pair
from glue.client.players import serve_agent
from glue.client.season import Membership, Page, Season, SeasonBusy, SeasonRefused, join
from glue.client.target import Target
from glue.errors import GlueError, HubUnreachable
from glue.keys.certificates import encode, write_pair
from tests import forked
from tests.experiment_runner.competition.players import Walker
from tests.ports import ports
from tests.system.runs import wait_until

__all__ = ["ports"]

ROOT: Final = Path(__file__).parents[2]
KILLS: Final = 10
LONGEST_LIFE: Final = 5.0
"""Seconds until a kill, at most."""

HONEST: Final = tuple(f"honest{number}" for number in range(8))
FOREIGN: Final = tuple(f"{language}{number}" for language in ("js", "cpp") for number in range(2))
BAD: Final = ("crash0", "crash1", "hang0", "hang1", "flood", "pose")

FILE: Final = """\
name = "spring"
trials = 1
seed_file = "secret.txt"
limits = { start_seconds = 20, step_seconds = 0.5, bank_seconds = 10 }
[season]
opens = 2020-01-01T00:00:00
closes = 2100-01-01T00:00:00
enrol = "code"
code_file = "code.txt"
attempts_per_day = 2
parallel = 6
failures = 2
[tasks]
mines = { env = "mines", options.random_start = true, steps = 200, phase = "proving" }
short = { env = "mines", options.random_start = true, episodes = 2, max_steps = 50, phase = "proving" }
"""
WALK, LATE = (
    f'[entrants.{name}]\ncommand = ["{sys.executable}", "-m", "tests.season.walk"]\n'
    for name in ("walk", "late")
)


ADDED: Final = 4
ACTS: Final[dict[int, tuple[str, int, list[str]]]] = {
    2: (HONEST[0], 0, ["grant", HONEST[0], "1"]),
    3: ("crash1", 0, ["exclude", "crash1"]),
    ADDED: ("walk", 0, ["add", "late.toml"]),
    5: ("walk", 0, ["freeze"]),
    6: ("walk", 1, ["rerun", "walk"]),
    7: ("walk", 1, ["announce", "Lunch is at noon"]),
    8: (HONEST[1], 1, ["rerun", HONEST[1]]),
}
"""What the organiser does after a kill, once an entrant has so many attempts that are over."""


class Crashing(Walker):
    def agent_step(self, reward: float, observation: Any) -> Any:
        raise ValueError("no idea")


class Hanging(Walker):
    def agent_start(self, observation: Any) -> Any:
        time.sleep(15)
        return super().agent_start(observation)


class Held:
    """A season, its server's process, and what its organiser types."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder = folder
        self.directory = folder / "run"
        self.began = time.time()
        self.over = Event()
        self.log = folder / "server.log"
        self.page, self.hub = port, port + 1
        self.url = f"http://127.0.0.1:{self.page}"
        write_pair(folder / "keys", "hub", new_pair())
        for name, text in (("secret.txt", "xyzzy"), ("code.txt", "lemonade")):
            (folder / name).write_text(text)
            (folder / name).chmod(0o600)
        (folder / "spring.toml").write_text(FILE + WALK)
        (folder / "late.toml").write_text(FILE + WALK + LATE)
        self.server = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        arguments = [
            *("serve", "spring.toml", "--out", "run", "--keys", "keys", "--log-format", "json"),
            *("--bind", f"tcp://127.0.0.1:{self.hub}", "--page", f"127.0.0.1:{self.page}"),
        ]
        with self.log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "tests.season.serve", str(self.began), *arguments],
                cwd=self.folder,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stderr=log,
            )

    def kill(self) -> None:
        self.server.kill()
        self.server.wait()
        self.server = self.start()

    def type(self, *arguments: str) -> str:
        """Run a command of the organiser; return its output."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = forked.run("glue-compete", *arguments, cwd=self.folder, env=environment, timeout=300, status=0)
        return done.stdout + done.stderr

    def act(self, command: str, *arguments: str) -> None:
        why = () if command == "announce" else ("--why", "a mail of May")
        self.wait_for_server()
        self.type(command, "run", *arguments, *why)

    def wait_for_server(self) -> None:
        def there() -> bool:
            with suppress(NoServer, OSError):
                return bool(ask(self.directory, {"do": "status"}, 5)["ok"])
            return False

        wait_until(there, "the server")

    def member(self, name: str) -> Membership:
        """Enrol an entrant."""
        _, secret = write_pair(self.folder / name, name, new_pair())
        while True:
            try:
                return join(Page(self.url), name, secret, "lemonade")[0]
            except SeasonBusy:  # the server was killed
                time.sleep(1)

    def state(self) -> State:
        return course_of(self.directory).state

    def board(self) -> SeasonBoard:
        now = datetime.fromtimestamp(self.began, UTC)
        with Results.open(self.directory) as results:
            return season_board(results, course_of(self.directory), now, ORGANISER)


def play(held: Held, name: str, make: Callable[[], Walker], attempts: int) -> int:
    """Be an entrant in Python, who plays some attempts; return how many were verified."""
    season, verified = Season(held.member(name)), 0

    def serve(target: Target, on: Callable[[], bool]) -> None:
        key = target.key
        assert key is not None
        with suppress(GlueError, HubUnreachable):
            serve_agent({target.session: make()}, target.hub, key=key.file, hub_key=encode(key.hub), wait=10)

    for _ in range(3 * attempts):
        try:
            verified += season.play(serve, lambda line: None).outcome == "verified"
        except SeasonBusy as busy:  # its attempts of the day are used up, or the server was killed
            time.sleep(min(busy.seconds, 5))
        except SeasonRefused:  # it was excluded or paused
            break
        if verified == attempts or held.over.is_set():
            break
    return verified


def play_program(held: Held, name: str, command: list[str]) -> int:
    """Be an entrant with a program in another language, who plays one attempt."""
    file = held.folder / name / "season.toml"
    held.member(name).write(file)
    for _ in range(5):
        done = forked.run("glue-agent", "--season", str(file), *command, cwd=held.folder, timeout=300)
        if "is over" in done.stdout and "forfeited" not in done.stdout:
            return 1
    return 0


def flood(held: Held) -> int:
    """Send garbage to every port that there is."""
    chance = random.Random(3)
    while not held.over.is_set():
        for port in (held.page, *range(held.hub, held.hub + 6)):
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1) as one:
                one.sendall(chance.randbytes(2000))
        time.sleep(0.2)
    return 0


def pose(held: Held) -> int:
    """Be an entrant who asks for attempts, and plays, as another."""
    own, refused = held.member("pose"), 0
    other = Season(replace(own, name=HONEST[0]))
    while not held.over.is_set():
        with suppress(SeasonBusy):
            try:
                other.ask("attempt", {"attempt": 0})
            except SeasonRefused:
                refused += 1
        with suppress(GlueError):
            hub = f"tcp://127.0.0.1:{held.hub}"
            serve_agent({HONEST[0]: Walker()}, hub, key=own.key, hub_key=own.hub_key, wait=1)
        time.sleep(0.5)
    return refused


def programs(folder: Path) -> dict[str, list[str]]:
    """Return a command in each of two other languages, if they are there."""
    found = {}
    if shutil.which("node"):
        found["js"] = ["node", str(ROOT / "clients/javascript/examples/random.js")]
    if shutil.which("g++"):
        source, agent = ROOT / "clients/cpp/examples/random.cpp", folder / "agent"
        include = f"-I{ROOT / 'clients/cpp/include'}"
        subprocess.run(["g++", "-std=c++17", include, "-o", agent, source], check=True, timeout=300)
        found["cpp"] = [str(agent)]
    return found


@pytest.mark.timeout(1200)
def test_a_season_of_some_days(tmp_path: Path, ports: int) -> None:
    commands = programs(tmp_path)
    held = Held(tmp_path, ports)
    held.wait_for_server()
    players: dict[str, Callable[[], int]] = {
        **{name: partial(play, held, name, Walker, 3) for name in HONEST},
        **{name: partial(play, held, name, Crashing, 2) for name in BAD[:2]},
        **{name: partial(play, held, name, Hanging, 1) for name in BAD[2:4]},
        **{
            name: partial(play_program, held, name, commands[name[:-1]])
            for name in FOREIGN
            if name[:-1] in commands
        },
        "flood": partial(flood, held),
        "pose": partial(pose, held),
    }
    chance = random.Random(5)
    with ThreadPoolExecutor(len(players)) as threads:
        playing = {name: threads.submit(one) for name, one in players.items()}
        try:
            for kill in range(KILLS):
                time.sleep(chance.uniform(0, LONGEST_LIFE))
                held.kill()
                if kill in ACTS:
                    name, count, act = ACTS[kill]
                    wait_until(partial(done_by, held, name, count), "what the act is about")
                    held.act(*act)
                if kill == ADDED:
                    (tmp_path / "spring.toml").write_text(FILE + WALK + LATE)
            ends = [name for name in players if name not in ("flood", "pose")]
            verified = {name: playing[name].result(600) for name in ends}
        finally:
            held.over.set()
        assert playing["pose"].result(60) > 0
    assert {name: verified[name] for name in HONEST} == dict.fromkeys(HONEST, 3)
    assert not any(verified[name] for name in ends if name.startswith(("crash", "hang")))
    assert all(verified[name] == 1 for name in ends if name in FOREIGN)
    wait_until(lambda: done_by(held, "late", 1) and done_by(held, "walk", 2), "the commands")
    held.act("close")
    assert held.server.wait(120) == 0
    check_log(held)
    check_board(held)
    check_scores(held, tmp_path)


def done_by(held: Held, name: str, count: int) -> bool:
    entrant = held.state().entrants.get(name)
    return entrant is not None and sum(one.state == "over" for one in entrant.attempts.values()) >= count


def check_log(held: Held) -> None:
    """Every line of the server's is a JSON object, and none is a traceback."""
    lines = [json.loads(line) for line in held.log.read_text().splitlines()]
    assert all(line.keys() == {"time", "message"} for line in lines)
    assert "Traceback" not in held.log.read_text()


def check_board(held: Held) -> None:
    """The board is what the journal and the records make it, and every act is in the journal."""
    before = held.board()
    verified = held.type("verify", "run")
    assert "does not match" not in verified
    assert held.board() == before
    state = held.state()
    assert state.frozen is not None
    assert state.entrants["crash1"].excluded
    assert not state.attempts("playing", "waiting")
    assert [one.reason for one in state.announcements] == ["Lunch is at noon"]
    rows = {row.name: row for row in before.entrants}
    assert rows["walk"].place == rows["late"].place == rows[HONEST[0]].place == 1
    assert rows["hang0"].place is None or rows["hang0"].place > 1
    assert rows["walk"].attempts[1].instead == 1


def check_scores(held: Held, folder: Path) -> None:
    """An honest entrant has, to the last bit, the scores of a competition held at once."""
    lines = FILE.partition("[season]")[0] + "[tasks]" + FILE.partition("[tasks]")[2] + WALK
    (folder / "once.toml").write_text(lines.replace(', phase = "proving"', ""))
    held.type("run", "once.toml", "--out", "once")
    held.type("verify", "once")
    with Results.open(folder / "once") as once, Results.open(held.directory) as results:
        expected, found = once.verdicts(), results.verdicts()
        for name in ("walk", "late", *HONEST):
            for task in ("mines", "short"):
                trial = f"{name}/{task}/0"
                if trial in found and results.outcomes()[trial].reason is None:
                    assert found[trial].score == expected[f"walk/{task}/0"].score
        assert found["walk/mines/0"].digest == expected["walk/mines/0"].digest

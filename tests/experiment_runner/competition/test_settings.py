"""Competitions are read from TOML, and a mistake is reported with its line and a suggestion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiment_runner.competition.settings import Entrant, Task, load_competition, parse_competition
from experiment_runner.competition.trials import read_secret
from glue.errors import ConfigError
from tests.experiment_runner.competition.players import competition

_FILE = """\
name = "spring"
trials = 2
seed_file = "secret.txt"

[limits]
step_seconds = 0.5
memory = "512m"
cpus = 2

[tasks.easy]
env = "mario"
options = { level_difficulty = 0 }
episodes = 20
[tasks.long]
env = "mines"
steps = 100_000
max_steps = 500

[entrants.alice]
image = "alice/agent:1"
[entrants.bob]
command = ["glue-agent", "sample"]
[entrants.carol]
key = "carol.pub"
"""


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "spring.toml"
    path.write_text(_FILE)
    found = load_competition(path)
    assert (found.name, found.trials) == ("spring", 2)
    assert found.seed_file == tmp_path / "secret.txt"
    assert found.tasks == (
        Task("easy", "mario", {"level_difficulty": 0}, episodes=20),
        Task("long", "mines", steps=100_000, max_steps=500),
    )
    assert found.entrants == (
        Entrant("alice", image="alice/agent:1"),
        Entrant("bob", command=("glue-agent", "sample")),
        Entrant("carol", key=tmp_path / "carol.pub"),
    )
    limits = found.limits
    assert (limits.step_seconds, limits.bank_seconds, limits.start_seconds) == (0.5, 60, 30)
    assert (limits.memory, limits.cpus) == (512 * 2**20, 2.0)


@pytest.mark.parametrize(
    ("old", "new", "line", "why"),
    [
        ("step_seconds", "step_second", 6, "did you mean step_seconds"),
        ("512m", "lots", 7, "512m"),
        ("cpus = 2", "cpus = 0", 8, "cpus must be a number >= 0.01, not 0"),
        ("0.5", "-1", 6, "step_seconds must be from 0"),
        ("level_difficulty = 0", "level_difficulty = []", 12, "level_difficulty"),
        ("episodes = 20", "episodes = 20\nsteps = 5", 10, "its length"),
        ("[entrants.bob]", '[entrants."../bob"]', 21, "cannot be a name"),
        ('image = "alice/agent:1"', 'image = "a"\nkey = "b"', 19, "needs one of"),
        ('"spring"', '""', 1, "name must be a printable string"),
        ("trials = 2", "trials = -1", 2, "trials must be a whole number >= 1, not -1"),
        ('seed_file = "secret.txt"', 'seed_file = "s"\nseed_env = "S"', 4, "once"),
        ("step_seconds = 0.5", "bank_seconds = 0x" + 400 * "f", 6, "bank_seconds must be a number"),
        ('memory = "512m"', 'memory = "1m"', 7, 'memory is a number of bytes of at least "6m"'),
        ("max_steps = 500", "rate = 2000", 17, "task long: a rate is from 0.001 to 1000"),
        ("max_steps = 500", 'late = "0"', 14, "task long: an agent is never late where"),
        ("max_steps = 500", 'rate = 9\nlate = "x"', 18, "task long: late is `repeat`"),
        ("max_steps = 500", "max_steps = 1", 17, "max_steps must be a whole number >= 2, not 1"),
        ("step_seconds = 0.5", "pids = 1", 6, "pids must be a whole number"),
        ("step_seconds = 0.5", "shm = 0x" + 5000 * "f", 6, "shm is a number of bytes"),
        ("[limits]", "[[limits]]", 5, "limits must be a table"),
        ("max_steps = 500", 'phase = "proving"', 17, "there is no table [season]"),
        ('command = ["glue-agent", "sample"]', "command = []", 21, "entrant bob needs one of"),
        ('command = ["glue-agent", "sample"]', "command = [1]", 22, "command[0] must be a string, not 1"),
    ],
)
def test_a_mistake_names_its_line(old: str, new: str, line: int, why: str) -> None:
    """Types, choices and near misses of keys are those of any table: `tests/experiment_runner/plan`."""
    with pytest.raises(ConfigError) as failure:
        parse_competition(_FILE.replace(old, new, 1), Path("spring.toml"))
    message = str(failure.value)
    assert "spring.toml" in message
    assert f"line {line}" in message
    assert why in message
    assert "\n" not in message


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: No such file"):
        load_competition(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('seed_env = "S"\n[tasks.a]\nenv = "mines"\nsteps = 3\n', r"\[entrants.NAME\]"),
        ('seed_env = "S"\n[entrants.a]\nimage = "x"\n', r"\[tasks.NAME\]"),
        (_FILE.replace('seed_file = "secret.txt"', ""), "seed_file"),
    ],
)
def test_what_is_missing_is_named(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        parse_competition(text, Path("spring.toml"))


@pytest.mark.parametrize(("mode", "warned"), [(0o600, False), (0o640, True), (0o604, True)])
def test_a_secret_that_other_users_can_read_is_warned_of(tmp_path: Path, mode: int, warned: bool) -> None:
    file = tmp_path / "secret.txt"
    file.write_text("hush\n")
    file.chmod(mode)
    warnings: list[str] = []
    assert read_secret(replace(competition("alice"), seed_file=file), {}, warnings.append) == b"hush"
    assert [f"chmod 600 {file}" in line for line in warnings] == [True] * warned

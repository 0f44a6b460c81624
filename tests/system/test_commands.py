"""The commands, as people use them: three terminals, scripts, mistakes."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest

from glue import __version__
from tests.forked import BIN, run
from tests.terminal import Terminal, run_anew

ROOT = Path(__file__).parents[2]
COMMANDS = sorted(
    point.name
    for point in importlib.metadata.entry_points(group="console_scripts")
    if point.name.startswith("glue-")
)


ENDLESS_COMMANDS = {
    "glue-hub": ["--bind", "tcp://127.0.0.1:*"],
    "glue-compete": ["board", "runs"],
    "glue-compile": ["mario"],
    "glue-conform": ["agent", "--", "sleep", "100"],
    "glue-generalise": ["--agent", "random"],
    "glue-keys": ["show", "carol.key"],
    "glue-env": ["mario", "--hub", "ipc:///nowhere/hub"],
    "glue-agent": ["hierarchical", "--hub", "ipc:///nowhere/hub"],
    "glue-experiment": ["--env", "mario", "--agent", "hierarchical", "--episodes", "100000", "--in-process"],
    "glue-paper": ["7", "--workers", "1"],
    "glue-plot": ["runs", "--out", "curves.png"],
    "glue-replay": ["recording.traj"],
    "glue-results": ["show", "runs"],
    "glue-view": ["runs"],
    "glue-watch": ["--agent", "hierarchical", "--after", "100000"],
}
"""Arguments with which a command imports everything that it needs."""

IMPORTS = [
    *((command, "click") for command in ENDLESS_COMMANDS),
    ("glue-agent", "msgpack"),
    ("glue-agent", "numba.core"),
    ("glue-experiment", "numpy.linalg"),
    ("glue-experiment", "sqlite3"),
]


def run_cold(program: str, cases: Iterable[object], folder: Path) -> list[Any]:
    """Run each case in a process of its own, forked from one that has imported nothing; return its findings.

    `program` defines `run`, which gets a case and a dictionary for its findings; status and output follow.
    """
    text = _EACH.replace("PROGRAM", program)
    shown = subprocess.run(
        [sys.executable, "-c", text, json.dumps(list(cases))], cwd=folder, capture_output=True, timeout=120
    )
    assert shown.returncode == 0, shown.stderr
    return [json.loads(line) for line in shown.stdout.splitlines()]


_EACH = """
import json, os, runpy, signal, sys

PROGRAM

for number, case in enumerate(json.loads(sys.argv[1])):
    names = [f"{number}.{kind}" for kind in ("out", "err", "found")]
    with open(names[2], "w") as file:
        file.write("{}")  # a process that is interrupted may end at once
    pid = os.fork()
    if not pid:
        out, err = (os.open(name, os.O_CREAT | os.O_WRONLY) for name in names[:2])
        os.dup2(out, 1), os.dup2(err, 2)
        found = {}
        try:
            run(case, found)
        finally:
            with open(names[2], "w") as file:
                json.dump(found, file)
        sys.exit()
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    out, err, found = (open(name).read() for name in names)
    print(json.dumps(json.loads(found) | {"status": status, "out": out, "err": err}), flush=True)
"""


def test_interrupt_during_an_import_ends_a_command_with_one_word(tmp_path: Path) -> None:
    assert set(ENDLESS_COMMANDS) == set(COMMANDS)
    cases = [[module, str(BIN / command), *ENDLESS_COMMANDS[command]] for command, module in IMPORTS]
    for case, found in zip(cases, run_cold(_INTERRUPTED_IMPORT, cases, tmp_path), strict=True):
        assert (found["status"], found["err"]) == (130, "interrupted\n"), case


_INTERRUPTED_IMPORT = """
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)

def run(case, found):
    global module
    module, *sys.argv = case
    sys.meta_path.insert(0, Interrupting())
    runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_interrupts_are_handled_before_more_is_imported_than_python_needs() -> None:
    scripts = importlib.metadata.entry_points(group="console_scripts")
    modules = {point.module for point in scripts if point.name in COMMANDS}
    program = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
before = set(sys.modules)
for module in {sorted(modules)!r}:
    __import__(module)
print(*sorted(set(sys.modules) - before))
"""
    # Without `site`, which imports modules that the installed packages name.
    shown = subprocess.run([sys.executable, "-SEc", program], capture_output=True, text=True, check=True)
    imported = shown.stdout.split()
    assert "glue.cli.entry" in imported
    assert not {"typing", "re", "contextlib", "click"} & set(imported)


@pytest.mark.parametrize("command", ["glue-agent", "glue-env"])
def test_interrupt_of_a_player_that_waits_is_one_word(command: str, tmp_path: Path) -> None:
    with closing(Terminal(command, *ENDLESS_COMMANDS[command], cwd=tmp_path)) as terminal:
        terminal.wait_for("no hub answers at ipc:///nowhere/hub")
        terminal.send_signal(signal.SIGINT)
        assert terminal.end() == 130
        assert [line for line in terminal.lines if line][1:] == ["interrupted"]


def test_each_command_has_help_with_examples_at_once_a_version_and_a_place_in_the_readme(
    tmp_path: Path,
) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    cases = [str(BIN / command) for command in COMMANDS]
    for command, found in zip(cases, run_cold(_TOLD, cases, tmp_path), strict=True):
        assert (found["status"], found["codes"]) == (0, [0, 0]), found["err"]
        assert "Example" in found["out"], command
        assert found["out"].splitlines()[-1].endswith(__version__)
        slow = {"numpy", "zmq", "numba", "msgpack", "matplotlib", "sqlite3"}
        assert not slow & set(found["modules"]), command
        assert f"`{Path(command).name}`" in readme


_TOLD = """
import click  # every command does

def run(command, found):
    found["codes"] = []
    for option in ("--help", "--version"):
        sys.argv = [command, option]
        try:
            runpy.run_path(command, run_name="__main__")
        except SystemExit as end:
            found["codes"].append(end.code)
    found["modules"] = list(sys.modules)
"""


def test_commands_import_nothing_slow_that_they_do_not_need(tmp_path: Path) -> None:
    cases = [
        "glue-experiment --help",
        "glue-experiment --env mines --agent sarsa --episodes 1 --trials 2 --in-process --out run",
        "glue-results show run",
    ]
    found = run_cold(_IMPORTING, [f"{BIN}/{case}" for case in cases], tmp_path)
    assert [one["status"] for one in found] == [0, 0, 0], found
    told, played, shown = (set(one["modules"]) for one in found)
    assert not {"numpy", "msgspec", "importlib.metadata", "subprocess"} & told
    slow = {"scipy", "numba", "matplotlib", "experiment_runner.executors.search"}
    hub = {"zmq", "glue.hub.sessions", "glue.hub.io.server", "glue.client.players", "glue.legacy.gateway"}
    assert "numpy" in played & shown
    assert found[1]["spin"] == "16"  # NumPy's threads sleep at once
    assert not (slow | hub) & (played | shown)


_IMPORTING = """
def run(case, found):
    sys.argv = case.split()
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        found["modules"] = list(sys.modules)
        found["spin"] = os.environ.get("OPENBLAS_THREAD_TIMEOUT")
"""


@pytest.mark.parametrize("player", ["glue-env mines", "glue-agent sarsa"])
def test_help_of_a_player_has_an_example_for_the_experiment_too(player: str, tmp_path: Path) -> None:
    command, name = player.split()
    flag = command.removeprefix("glue-")
    shown = run(command, name, "--help", cwd=tmp_path).stdout
    example = re.search(rf"^ +glue-experiment (--{flag} {name} --{flag}-option .*)$", shown, re.MULTILINE)
    assert example is not None, shown
    other = ("--agent", "random") if flag == "env" else ("--env", "mines")
    assert run("glue-experiment", *example[1].split(), *other, "--dry-run", cwd=tmp_path).returncode == 0


def test_help_of_a_player_has_the_parameters_as_options_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(_DOCUMENTED, encoding="utf-8")
    shown = run("glue-agent", "mine.py:Documented", "--help", cwd=tmp_path).stdout
    assert "Walks about." in shown
    assert "\n      documented = Documented(speed=2)\n      documented.walk()\n" in shown
    assert "--speed" in shown
    assert "Args:" not in shown
    assert "Raises:" not in shown


_DOCUMENTED = """
class Documented:
    '''Walks about.

        documented = Documented(speed=2)
        documented.walk()

    Args:
        speed: in steps.

    Raises:
        ValueError: it stumbles.
    '''

    def __init__(self, *, speed: int = 1):
        pass

    def agent_init(self, task_spec):
        pass
"""


_ENDLESS = """
from agents.baselines import SkeletonAgent as Patient
from env_server.toys import SkeletonEnvironment
from glue import Observation


class Endless(SkeletonEnvironment):
    def env_step(self, action):
        return 1.0, Observation(ints=[1]), False


class Broken(Patient):
    def agent_step(self, reward, observation):
        raise ArithmeticError("cannot add up")
"""


@pytest.mark.parametrize("topology", [[], ["--in-process"]], ids=["processes", "in-process"])
def test_agent_that_raises_shows_its_traceback_and_one_error(tmp_path: Path, topology: list[str]) -> None:
    (tmp_path / "mine.py").write_text(_ENDLESS, encoding="utf-8")
    shown = run(
        *("glue-experiment", "--env", "mine.py:Endless", "--agent", "mine.py:Broken"),
        *("--episodes", "2", "--out", "run", *topology),
        cwd=tmp_path,
    )
    assert shown.returncode == 1
    assert shown.stderr.count('raise ArithmeticError("cannot add up")') == 1
    error = "Error: agent Broken raised in agent_step: ArithmeticError: cannot add up"
    assert shown.stderr.splitlines().count(error) == 1
    assert (shown.stdout + shown.stderr).count("agent Broken raised") == 1
    first = shown.stderr.partition("Traceback (most recent call last):\n")[2].splitlines()[0]
    assert 'mine.py", line' in first  # the traceback begins in the user's code


@pytest.mark.parametrize("command", ["glue-experiment --env mines --episodes 2 --agent", "glue-agent"])
def test_constructor_that_raises_shows_its_traceback_and_one_error(tmp_path: Path, command: str) -> None:
    (tmp_path / "mine.py").write_text(_UNMADE, encoding="utf-8")
    shown = run(*command.split(), "mine.py:Unmade", cwd=tmp_path)
    assert shown.returncode == 1
    assert shown.stderr.count("Traceback") == 1
    first = shown.stderr.partition("Traceback (most recent call last):\n")[2].splitlines()[0]
    assert 'mine.py", line' in first
    assert "Error: Unmade raised in its constructor: ArithmeticError: cannot add up\n" in shown.stderr


_UNMADE = """
class Unmade:
    def __init__(self):
        raise ArithmeticError("cannot add up")

    def agent_init(self, task_spec):
        pass
"""


@pytest.mark.parametrize("topology", [["--in-process"], ["--workers", "1"]], ids=" ".join)
def test_json_whose_reader_has_seen_enough_ends_without_complaint(
    tmp_path: Path, topology: list[str]
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    players = ("--env", "mines", "--agent", "random", "--episodes", "500")
    command = [str(BIN / "glue-experiment"), *players, "--json"]
    shown = subprocess.run(
        [*command, *topology], cwd=tmp_path, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120
    )
    os.close(writer)
    assert shown.returncode == 1
    assert "Traceback" not in shown.stderr
    assert "Error" not in shown.stderr


def test_file_in_the_working_directory_takes_no_modules_place(tmp_path: Path) -> None:
    for module in ("agents", "env_server", "glue", "random", "numpy", "zmq", "click", "numba", "typing"):
        (tmp_path / f"{module}.py").write_text("raise AssertionError(__file__)", encoding="utf-8")
    (tmp_path / "beside.py").write_text("ACTION = 0", encoding="utf-8")
    (tmp_path / "mine.py").write_text(f"import beside\n{_ENDLESS}", encoding="utf-8")
    # In three processes: the command, and two modules of ours.
    players = ("--env", "mine.py:Endless", "--agent", "mine:Patient")
    ended = run_anew("glue-experiment", *players, "--episodes", "2", "--max-steps", "20", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr


def test_environment_variables_set_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hub = f"ipc://{tmp_path}/hub"
    monkeypatch.setenv("GLUE_HUB", hub)
    monkeypatch.setenv("GLUE_SESSION", "a")
    monkeypatch.setenv("GLUE_EXPERIMENT_EPISODES", "3")
    commands = ("glue-hub", "--bind", hub), ("glue-env", "mines"), ("glue-agent", "random")
    with ExitStack() as stack:
        _, *players = (stack.enter_context(closing(Terminal(*one, cwd=tmp_path))) for one in commands)
        shown = run("glue-experiment", "--json", cwd=tmp_path)
        assert shown.returncode == 0, shown.stderr
        assert len(shown.stdout.splitlines()) == 4
        for player in players:
            player.wait_for(f"session 'a' at {hub}")
    # Players that an experiment starts join it and nothing else; an option on the command line comes first.
    monkeypatch.setenv("GLUE_HUB", "ipc:///nowhere/hub")
    monkeypatch.setenv("GLUE_AGENT_SARSA_EPSILON", "nonsense")
    for topology in (["--in-process"], ["--bind", "tcp://127.0.0.1:*"], ["--workers", "1"]):
        shown = run("glue-experiment", "--env", "mines", "--agent", "sarsa", *topology, cwd=tmp_path)
        assert shown.returncode == 0, shown.stderr


@pytest.mark.parametrize(
    ("words", "incomplete", "completions"),
    [
        ("glue-agent", "hi", {"hierarchical", "hierarchical-facts"}),
        ("glue-env", "m", {"mario", "mines"}),
        ("glue-experiment --env", "m", {"mario", "mines"}),
        ("glue-watch --agent", "sa", {"sample", "sarsa"}),
        ("glue-replay --env", "sk", {"skeleton"}),
    ],
)
def test_shell_completes_names(
    words: str, incomplete: str, completions: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = words.split()[0]
    monkeypatch.setenv(f"_{command.upper().replace('-', '_')}_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"{words} {incomplete}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    shown = run(command, cwd=tmp_path)
    assert completions <= {line.rpartition(",")[2] for line in shown.stdout.splitlines()}
    assert all(line.rpartition(",")[2].startswith(incomplete) for line in shown.stdout.splitlines())


NOWHERE = "--hub ipc:///nowhere/hub --wait 0.2"
WATCH_MINES = "glue-watch --env mines --agent sarsa"

MISTAKES = {
    "an option before the name": (
        "glue-agent --hub ipc:///nowhere random",
        "glue-agent random --hub ipc:///nowhere",
    ),
    "an option of the agent": (
        "glue-experiment --env mines --agent sarsa --step-size 0.2 --episodes 1",
        "--agent-option step_size=0.2",
    ),
    "an option of the environment": (
        "glue-watch --agent random --env mines --random-start",
        "--env-option random_start=on",
    ),
    "an address open to others": ("glue-hub --bind tcp://0.0.0.0:4999", "--insecure"),
    "a key without that of the hub": ("glue-agent random --key own", "(--hub-key)"),
    "no key, of a subcommand": ("glue-compete board . --signed-by nowhere", "(--signed-by)"),
    "no hub for a player": (
        f"glue-agent random {NOWHERE}",
        "no hub has answered at ipc:///nowhere/hub for 0.2 s",
    ),
    "no hub for an experiment": (f"glue-experiment --episodes 1 {NOWHERE}", "check the address (--wait)"),
    "two levels of the log": ("glue-hub --quiet --verbose", "--quiet and --verbose"),
    "two options at once": ("glue-hub --legacy-port 0.0.0.0:4096", "(--legacy-port, --insecure)"),
    "no file to load": (f"{WATCH_MINES} --load nothing.agent", "cannot read nothing.agent"),
    "a file that is no save": (f"{WATCH_MINES} --load /etc/passwd", "are not a save of agent sarsa"),
    "no speed": (f"{WATCH_MINES} --speed 0", "0.1<=x<=1000"),
    "marks that nobody draws": (f"{WATCH_MINES} --plan", "leave --plan out"),
    "no films of this": (f"{WATCH_MINES} --gif a.gif", "there are no films of MinesEnvironment"),
    "no plan": ("glue-watch --env mario --agent random --plan", "no plan to draw"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_answered_in_a_line_that_says_what_to_do(mistake: str, tmp_path: Path) -> None:
    command, advice = MISTAKES[mistake]
    shown = run(*command.split(), cwd=tmp_path)
    assert shown.returncode in (1, 2)
    assert advice in shown.stderr
    assert "Traceback" not in shown.stderr
    assert sum(line.startswith("Error:") for line in shown.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir()), "nothing has begun"

"""Other distributions whose packages have our names: glue-core, openai-agents, experiment-runner."""

from __future__ import annotations

from importlib.metadata import distributions
from pathlib import Path
from typing import Final

import pytest

from tests.package.environments import COMMANDS, DIST, Installed

THEIRS: Final = ["glue-core", "openai-agents", "experiment-runner"]


@pytest.fixture(scope="module", params=["first", "last"])
def mixed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """An environment with all of these distributions, ours installed first or last."""
    installed = Installed.make(tmp_path_factory.mktemp("mixed"))
    (wheel,) = Path(DIST).resolve().glob("*.whl")
    for requirements in ([str(wheel)], THEIRS)[:: 1 if request.param == "first" else -1]:
        installed.install(*requirements)
    return installed


def test_no_file_belongs_to_two_distributions(mixed: Installed) -> None:
    owners: dict[str, str] = {}
    for distribution in distributions(path=[str(mixed.packages)]):
        for file in distribution.files or ():
            if file.parts[0] in {"glue_rl", "glue_rl.pth", "glue", "agents", "experiment_runner"}:
                assert owners.setdefault(str(file), distribution.name) == distribution.name
    assert {"glue-rl", *THEIRS} <= set(owners.values())


@pytest.mark.parametrize("command", COMMANDS)
def test_command_says_so_in_one_line_and_works(command: str, mixed: Installed) -> None:
    shown = mixed.run(command, "--help")
    assert shown.stdout.startswith(f"Usage: {command} ")
    (line,) = shown.stderr.splitlines()
    assert str(mixed.packages / "glue/__init__.py") in line
    assert "import glue_rl" in line


def test_experiment_in_three_processes_and_workers(mixed: Installed) -> None:
    experiment = ["glue-experiment", "--env", "mines", "--agent", "sarsa", "--episodes", "5"]
    mixed.run(*experiment, "--out", "three")
    mixed.run(*experiment, "--trials", "2", "--workers", "2", "--out", "workers")
    mixed.run("glue-results", "show", "three")


def test_each_package_is_whole(mixed: Installed) -> None:
    theirs = "import glue.core, agents, experiment_runner; from agents import Runner; print(glue.__file__)"
    assert mixed.python(theirs).stdout.strip() == str(mixed.packages / "glue/__init__.py")
    mixed.python("import glue_rl; from glue import Agent; import agents.tabular, experiment_runner.store")
    local = "from glue_rl import local, make, make_agent; local(make_agent('sarsa'), make('mines'))"
    mixed.python(f"{local}.rl_init(seed=1)")


def test_an_agent_may_use_the_other_agents(mixed: Installed) -> None:
    mixed.python(
        "import agents\nfrom agents import Runner\nimport glue_rl\n"
        "from glue_rl import Agent, serve_agent\nimport glue\n"
        "assert Agent is glue.Agent and 'glue_rl' in glue.__file__ and 'glue_rl' not in agents.__file__"
    )


def test_importing_ours_after_the_other_glue_is_refused(mixed: Installed) -> None:
    shown = mixed.python("import glue, glue_rl", status=1)
    assert shown.stderr.splitlines()[-1].startswith("ImportError: ")


def test_taking_the_others_away_leaves_ours_whole(mixed: Installed) -> None:
    """The last test of an environment: `import glue` is ours again, and names the file hiding `agents`."""
    mixed.pip("uninstall", "--yes", "glue-core")
    shown = mixed.python("import glue; glue.Agent")
    (line,) = [line for line in shown.stderr.splitlines() if "Warning" in line]
    assert str(mixed.packages / "agents/__init__.py") in line
    assert "import glue_rl" in line
    mixed.pip("uninstall", "--yes", *THEIRS[1:])
    assert not mixed.python("import glue; glue.Agent").stderr

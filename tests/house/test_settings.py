"""Libraries name settings by their Python names and do not read the process's environment; cli/ does both."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping

from tests.house.imports import PACKAGES, ROOT

PROGRAM = "is a program with a command line of its own"
ANOTHER = "runs another program, whose options these are"
INHERITED = "passes the environment on to a process that it starts"

FLAGS: Mapping[str, str] = {
    "agents/ppo.py": PROGRAM,
    "agents/soar/agents.py": "speaks to the Soar kernel in commands",
    "agents/soar/kernel.py": "speaks to the Soar kernel in commands",
    "agents/soar/player.py": "speaks to the Soar kernel in commands",
    "experiment_runner/competition/containers.py": "advises a command of the operating system",
    "experiment_runner/meeting/children.py": "a breakpoint is refused in a process that has no command line",
    "experiment_runner/meeting/hints.py": "shows the command with which a player joins from another terminal",
    "experiment_runner/plan/provenance.py": ANOTHER,
    "experiment_runner/view/starting.py": ANOTHER,
    "experiment_runner/slurm/batch.py": "calls SLURM's commands",
    "experiment_runner/study/generalisation/imitation.py": PROGRAM,
    "glue/conform/hub/mirror.py": PROGRAM,
    "glue/plugins/naming.py": "is a part of the command line that several packages share",
}
"""Library modules with an option of a command line in a string, and the reason."""

ENVIRONMENT: Mapping[str, str] = {
    "env_server/gym/rendering.py": "DISPLAY tells whether there is a screen",
    "experiment_runner/competition/containers.py": "DOCKER_HOST is where Docker clients find their engine",
    "experiment_runner/competition/programs.py": INHERITED,
    "experiment_runner/meeting/children.py": "PYTHONBREAKPOINT is Python's own setting",
    "glue/client/target.py": "connect() and serve_agent() are documented to take GLUE_HUB and so on",
    "glue/conform/hub/clients.py": INHERITED,
}
"""Library modules that use the process's environment, and the reason."""

_FLAG = re.compile(r"(?<![\w-])--[a-z]")


def _trees() -> Iterator[tuple[str, ast.Module]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if "cli" not in path.parts:
                yield str(path.relative_to(ROOT)), ast.parse(path.read_text("utf-8"))


def _has_flag(tree: ast.Module) -> bool:
    statements = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return any(
        isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in statements  # a docstring
        and _FLAG.search(node.value)
        for node in ast.walk(tree)
    )


def _uses_environment(tree: ast.Module) -> bool:
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names |= {alias.name for node in imports for alias in node.names}
    return not names.isdisjoint(("environ", "environb", "getenv"))


def test_no_library_names_an_option_of_a_command() -> None:
    assert {name for name, tree in _trees() if _has_flag(tree)} == set(FLAGS)


def test_no_library_reads_the_environment() -> None:
    assert {name for name, tree in _trees() if _uses_environment(tree)} == set(ENVIRONMENT)

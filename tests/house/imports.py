"""Which folder of the program may import which, and which does.

A unit is a folder that holds modules. Two kinds of modules stand above all folders of their package, and are
units of their own: its `__init__.py`, which re-exports what users write against, and its command lines.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]

PACKAGES: Final = ("glue", "env_server", "agents", "experiment_runner")

_GLUE: Final = ("glue/commands", "glue/gym", "glue/testing")
"""All of glue."""

MAY_IMPORT: Final[dict[str, tuple[str, ...]]] = {
    # errors, types, roles, options: what users write against
    "glue": (),
    "glue/compiled": ("glue",),
    "glue/protocol": ("glue",),
    "glue/taskspec": ("glue",),
    "glue/trajectory": ("glue",),
    "glue/core": ("glue/protocol", "glue/taskspec"),
    "glue/sockets": (),
    "glue/players": ("glue/core",),
    "glue/keys": ("glue/core",),
    "glue/client": ("glue/keys", "glue/players", "glue/sockets"),
    "glue/hub": ("glue/keys", "glue/sockets"),
    "glue/legacy": ("glue/hub",),
    "glue/testing": ("glue/client", "glue/legacy"),
    "glue/gym": ("glue/client",),
    "glue/testing/conform/hub": ("glue/testing",),
    "glue/testing/conform/scenes": ("glue/testing/conform/hub",),
    "glue/testing/conform": ("glue/testing/conform/scenes",),
    "glue/__init__": ("glue/client", "glue/compiled", "glue/trajectory"),
    "glue/commands": ("glue/__init__", "glue/legacy", "glue/testing/conform"),
    # Environments and agents run on different machines, and share what crosses the wire.
    "env_server": _GLUE,
    "env_server/mario/sim": ("env_server",),
    "env_server/mario": ("env_server/mario/sim",),
    "env_server/render": ("env_server",),
    "env_server/gym": ("env_server/mario", "env_server/render"),
    "env_server/replay": ("env_server/mario", "env_server/render"),
    "env_server/commands": ("env_server/replay",),
    "agents": _GLUE,
    "agents/mario": ("agents",),
    "agents/mohan2010": ("agents/mario",),
    "agents/soar": ("agents/mario",),
    "agents/commands": ("agents",),
    # Players are found by their entry points: the framework knows no environment and no agent.
    "experiment_runner": _GLUE,
    "experiment_runner/store": ("experiment_runner",),
    "experiment_runner/analysis": ("experiment_runner/store",),
    "experiment_runner/report": ("experiment_runner/analysis",),
    "experiment_runner/executors": ("experiment_runner/report",),
    "experiment_runner/competition/records": ("experiment_runner/store",),
    "experiment_runner/competition": ("experiment_runner/executors", "experiment_runner/competition/records"),
    "experiment_runner/competition/board": ("experiment_runner/competition",),
    # The page draws what the games that are installed with it look like.
    "experiment_runner/view": ("experiment_runner/competition/board", "env_server/render"),
    "experiment_runner/commands": ("experiment_runner/view",),
    "experiment_runner/generalisation": ("experiment_runner/analysis", "env_server/mario"),
    "experiment_runner/paper": (
        "experiment_runner/commands",
        "env_server/replay",
        "agents/mohan2010",
        "agents/soar",
    ),
}
"""From the bottom up: a folder may import itself, the folders named here, and all that those may import."""


def files() -> list[Path]:
    """Return every module of the program, relative to the repository."""
    return sorted(path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def unit(file: Path) -> str:
    """Return the unit that a module belongs to."""
    package = file.parts[0]
    if file == Path("glue/__init__.py"):
        return "glue/__init__"
    if file.parts[1] in ("paper", "generalisation"):
        return str(file.parent)
    if file.parent.name == "commands" or file.stem in ("command", "commands", "entry"):
        return f"{package}/commands"
    return str(file.parent)


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse((ROOT / file).read_text(encoding="utf-8"), str(file))


def imported(file: Path, at_import: bool = False) -> Iterator[str]:
    """Yield the dotted names of all modules that `file` imports, anywhere in it or at its own import."""
    for node in tree(file).body if at_import else ast.walk(tree(file)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            assert node.module is not None
            yield from (_module(node.module, alias.name) for alias in node.names)


def _module(name: str, member: str) -> str:
    path = ROOT / name.replace(".", "/") / member
    return f"{name}.{member}" if path.is_dir() or path.with_suffix(".py").exists() else name


def imported_files(file: Path, at_import: bool = False) -> Iterator[Path]:
    """Yield the modules of this program that `file` imports, anywhere in it or at its own import."""
    for name in imported(file, at_import):
        path = Path(name.replace(".", "/"))
        if path.parts[0] in PACKAGES:
            yield path / "__init__.py" if (ROOT / path).is_dir() else path.with_suffix(".py")


def arrows() -> dict[str, set[str]]:
    """Return for each unit the others that its modules import."""
    found: dict[str, set[str]] = {name: set() for name in MAY_IMPORT}
    for file in files():
        found.setdefault(unit(file), set()).update(map(unit, imported_files(file)))
    return {name: imports - {name} for name, imports in found.items()}


def below(name: str) -> set[str]:
    """Return every unit that the modules of a unit may import."""
    return {name}.union(*(below(other) for other in MAY_IMPORT[name]))

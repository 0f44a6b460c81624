"""The allowed and the actual imports between the folders of the program.

A unit is a folder that holds modules. `glue/__init__.py`, which re-exports the public names, is a unit of its
own above the folders of its package, with `glue/api.py`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]

PACKAGES: Final = ("glue", "env_server", "agents", "experiment_runner")

MAY_IMPORT: Final[dict[str, tuple[str, ...]]] = {
    # errors, types, roles, options: the names that users write against
    "glue": (),
    # time, network, chance and threads
    "glue/doors": (),
    "glue/compiled": ("glue", "glue/doors"),
    "glue/taskspec": ("glue",),
    "glue/trajectory": ("glue",),
    "glue/wire": ("glue", "glue/doors"),
    "glue/engine": ("glue/taskspec", "glue/wire"),
    "glue/plugins": ("glue/engine",),
    "glue/rlglue": ("glue/plugins",),
    "glue/sockets": ("glue/doors",),
    "glue/hub": ("glue/engine",),
    "glue/keys": ("glue/hub",),
    "glue/client": ("glue/keys", "glue/sockets"),
    "glue/hub/io": ("glue/client",),
    "glue/notebook": ("glue/client",),
    "glue/legacy": ("glue/hub/io",),
    "glue/gym": ("glue/client", "glue/plugins"),
    "glue/conform/hub": ("glue/client",),
    "glue/conform/scenes": ("glue/conform/hub",),
    "glue/conform/peers": ("glue/conform/scenes",),
    "glue/conform": ("glue/conform/peers",),
    "glue/testing": ("glue/conform/peers",),
    "glue/__init__": ("glue/hub/io", "glue/plugins", "glue/testing"),
    "glue/cli": ("glue/__init__", "glue/conform", "glue/legacy"),
    # Environments and agents run on different machines, and share what crosses the wire.
    "env_server": ("glue/taskspec",),
    "env_server/mario/sim": ("glue/compiled",),
    "env_server/mario": ("env_server/mario/sim",),
    "env_server/render": ("env_server", "glue/cli"),
    "env_server/render/page": ("env_server/render",),
    "env_server/mario/many": ("env_server/mario", "env_server/render", "glue/wire"),
    "env_server/gym": ("env_server/mario/many", "glue/gym"),
    "env_server/replay": ("env_server/mario", "env_server/render", "glue/trajectory"),
    "env_server/datasets": ("glue/gym", "glue/trajectory"),
    "env_server/cli": ("env_server/datasets", "env_server/replay"),
    "agents/mario": ("glue/compiled", "glue/taskspec"),
    "agents/network": ("agents/mario",),
    "agents": ("agents/network", "glue/compiled"),
    "agents/mohan2010": ("agents", "agents/mario"),
    "agents/soar": ("agents/mario",),
    "agents/planner": ("agents/mario", "glue/compiled", "glue/plugins"),
    "agents/cli": ("glue/cli",),
    # Players are found by their entry points: the framework knows no environment and no agent.
    "experiment_runner": (),
    "experiment_runner/plan": ("glue/__init__",),
    "experiment_runner/store": ("experiment_runner/plan",),
    "experiment_runner/analysis": ("experiment_runner/store",),
    "experiment_runner/report": ("experiment_runner/analysis",),
    "experiment_runner/meeting": ("experiment_runner/store", "glue/legacy"),
    "experiment_runner/executors": (
        "experiment_runner/meeting",
        "experiment_runner/report",
        "glue/trajectory",
    ),
    "experiment_runner/slurm": ("experiment_runner/store",),
    "experiment_runner/loggers": ("experiment_runner/store",),
    "experiment_runner/competition/records": ("experiment_runner/executors",),
    "experiment_runner/competition": ("experiment_runner/competition/records",),
    "experiment_runner/competition/board": ("experiment_runner/competition",),
    "experiment_runner/view": ("experiment_runner/competition/board",),
    # Only the studies know Mario and the agents of the paper.
    "experiment_runner/study": (),
    "experiment_runner/study/generalisation": (
        "agents/network",
        "agents/planner",
        "env_server/mario/many",
        "experiment_runner/executors",
    ),
    "experiment_runner/study/paper": ("agents/mohan2010", "agents/soar", "experiment_runner/report"),
    "experiment_runner/cli": (
        "experiment_runner/loggers",
        "experiment_runner/slurm",
        "experiment_runner/study/generalisation",
        "experiment_runner/study/paper",
        "experiment_runner/view",
        "glue/cli",
    ),
}
"""From the bottom up: a folder may import itself, the folders named here, and all that those may import."""


def files() -> list[Path]:
    """Return every module of the program, relative to the repository."""
    return sorted(path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


_PUBLIC: Final = (Path("glue/__init__.py"), Path("glue/api.py"))


def unit(file: Path) -> str:
    """Return the unit that a module belongs to."""
    return "glue/__init__" if file in _PUBLIC else str(file.parent)


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse((ROOT / file).read_text(encoding="utf-8"), str(file))


def imported(file: Path, at_import: bool = False) -> Iterator[str]:
    """Yield the dotted names of all modules that `file` imports, anywhere or only at its own import."""
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
    """Yield the modules of this program that `file` imports, anywhere or only at its own import."""
    for name in imported(file, at_import):
        path = Path(name.replace(".", "/"))
        if path.parts[0] in PACKAGES:
            yield path / "__init__.py" if (ROOT / path).is_dir() else path.with_suffix(".py")


def arrows() -> dict[str, set[str]]:
    """Return, for each unit, the other units that its modules import."""
    found: dict[str, set[str]] = {name: set() for name in MAY_IMPORT}
    for file in files():
        found.setdefault(unit(file), set()).update(map(unit, imported_files(file)))
    return {name: imports - {name} for name, imports in found.items()}


def below(name: str) -> set[str]:
    """Return every unit that the modules of a unit may import."""
    return {name}.union(*(below(other) for other in MAY_IMPORT[name]))

"""The allowed and the actual imports between the folders of the program, whose modules are parsed once.

A unit is a folder that holds modules. `glue/__init__.py`, which re-exports the public names, is a unit of its
own above the folders of its package, with `glue/api.py`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[2]

PACKAGES: Final = ("glue", "env_server", "agents", "experiment_runner")

MAY_IMPORT: Final[dict[str, tuple[str, ...]]] = {
    # errors, types, roles, options: the names that users write against
    "glue": (),
    # time, network, chance, threads and forks
    "glue/system": ("glue",),
    "glue/compiled": ("glue", "glue/system"),
    "glue/taskspec": ("glue",),
    "glue/trajectory": ("glue",),
    "glue/wire": ("glue", "glue/system"),
    "glue/engine": ("glue/taskspec", "glue/wire"),
    "glue/plugins": ("glue/engine",),
    "glue/rlglue": ("glue/plugins",),
    "glue/hub": ("glue/engine",),
    "glue/keys": ("glue/hub",),
    "glue/client": ("glue/keys",),
    "glue/hub/io": ("glue/client",),
    "glue/notebook": ("glue/client",),
    "glue/legacy": ("glue/hub/io",),
    "glue/gym": ("glue/client", "glue/plugins"),
    "glue/openenv": ("glue/gym",),
    "glue/conform": ("glue/wire",),
    "glue/conform/clients": ("glue/client", "glue/conform"),
    "glue/conform/hubs": ("glue/client", "glue/conform"),
    "glue/testing": ("glue/conform/clients", "glue/conform/hubs"),
    "glue/__init__": ("glue/hub/io", "glue/plugins", "glue/testing"),
    "glue/cli": ("glue/__init__", "glue/legacy", "glue/openenv"),
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
    "agents/language": ("glue/__init__",),
    "agents/cli": ("glue/cli",),
    # Players are found by their entry points: the framework knows no environment and no agent.
    "experiment_runner": (),
    "experiment_runner/plan": ("glue/__init__",),
    "experiment_runner/store": ("experiment_runner/plan",),
    "experiment_runner/analysis": ("experiment_runner/store",),
    "experiment_runner/report": ("experiment_runner/analysis",),
    "experiment_runner/processes": ("experiment_runner/store",),
    "experiment_runner/executors": (
        "experiment_runner/processes",
        "experiment_runner/report",
        "glue/legacy",
        "glue/trajectory",
    ),
    "experiment_runner/slurm": ("experiment_runner/store",),
    "experiment_runner/loggers": ("experiment_runner/store",),
    "experiment_runner/competition/records": ("experiment_runner/executors",),
    "experiment_runner/competition": ("experiment_runner/competition/records",),
    "experiment_runner/competition/board": ("experiment_runner/competition",),
    "experiment_runner/competition/season": ("experiment_runner/competition/board",),
    "experiment_runner/view": ("experiment_runner/competition/season",),
    "experiment_runner/view/season": ("experiment_runner/view",),
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
        "experiment_runner/view/season",
        "glue/cli",
    ),
}
"""From the bottom up: a folder may import itself, the folders named here, and all that those may import."""


_PUBLIC: Final = (Path("glue/__init__.py"), Path("glue/api.py"))

_HANDED_OVER: Final = {"BitGenerator", "Generator", "PCG64", "SeedSequence", "default_rng"}
"""Names of `np.random` that draw from no global generator."""

_FLAG: Final = re.compile(r"(?<![\w-])--[a-z]")


class Module(NamedTuple):
    """What a module of the program imports and uses.

    imported    dotted names of modules, imported anywhere in it
    at_import   those of them that are imported when it is
    used        dotted names such as `os.environ`; calls such as `eval()`; `np.random.*` for a function that
                draws from NumPy's global generator; `--option` for a string, no docstring, with an option
    """

    file: Path
    imported: frozenset[str]
    at_import: frozenset[str]
    used: frozenset[str]

    @property
    def unit(self) -> str:
        """The unit that the module belongs to."""
        return unit(self.file)

    @property
    def names(self) -> frozenset[str]:
        """All names of `imported`, those of their packages, and all of `used`."""
        return self.imported | {name.partition(".")[0] for name in self.imported} | self.used


@cache
def modules() -> list[Module]:
    """Return every module of the program; their paths are relative to the repository."""
    return [_read(path) for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def unit(file: Path) -> str:
    """Return the unit that a module belongs to."""
    return "glue/__init__" if file in _PUBLIC else str(file.parent)


def files_of(names: Iterable[str]) -> Iterator[Path]:
    """Yield the modules of this program among modules with these dotted names."""
    for name in names:
        path = Path(name.replace(".", "/"))
        if path.parts[0] in PACKAGES:
            yield path / "__init__.py" if (ROOT / path).is_dir() else path.with_suffix(".py")


def below(name: str) -> set[str]:
    """Return every unit that the modules of a unit may import."""
    return {name}.union(*(below(other) for other in MAY_IMPORT[name]))


def _read(path: Path) -> Module:
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    imported: set[str] = set()
    used: set[str] = set()
    docstrings = set()
    for node in ast.walk(tree):
        match node:
            case ast.Import() | ast.ImportFrom():
                imported.update(_imported(node))
                used.update(f"{getattr(node, 'module', None)}.{alias.name}" for alias in node.names)
            case ast.Attribute(value=ast.Name(id=owner), attr=name):
                used.add(f"{owner}.{name}")
            case ast.Attribute(value=ast.Attribute(value=ast.Name(id="np"), attr="random"), attr=name):
                used.update({"np.random.*"} if name not in _HANDED_OVER else ())
            case ast.Call(func=ast.Name(id=name)):
                used.add(f"{name}()")
            case ast.Expr(value=ast.Constant()):
                docstrings.add(node.value)
            case ast.Constant(value=str(text)) if node not in docstrings and _FLAG.search(text):
                used.add("--option")
    at_import = (name for node in tree.body for name in _imported(node))
    return Module(path.relative_to(ROOT), frozenset(imported), frozenset(at_import), frozenset(used))


def _imported(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Import():
            yield from (alias.name for alias in node.names)
        case ast.ImportFrom(module=str(name), level=0):
            yield from (_module(name, alias.name) for alias in node.names)
        case ast.ImportFrom():
            raise AssertionError(f"line {node.lineno}: imports are absolute")


def _module(name: str, member: str) -> str:
    path = ROOT / name.replace(".", "/") / member
    return f"{name}.{member}" if path.is_dir() or path.with_suffix(".py").exists() else name

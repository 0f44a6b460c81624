"""Who may import whom, and where each dependency lives."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

MAY_IMPORT: dict[str, set[str]] = {
    "glue": set(),
    "env_server": {"glue"},
    "agents": {"glue"},
    "experiment_runner": {"glue", "env_server", "agents"},
}
"""Agents and environments run on different machines: what they share is what crosses the wire."""

LAYERS = [
    "errors",
    "types",
    "roles",
    "messages",
    "wire",
    "config",
    "engine",
    "calls",
    "experiment",
    "local",
    "sessions",
    "zmq_transport",
    "hub",
    "client",
]
"""The modules of a session, from the bottom up: each imports, of these, only those before it."""

PURE = {"errors", "types", "roles", "messages", "wire", "engine", "calls", "experiment", "local", "sessions"}
"""These see no sockets, clocks or threads."""

IMPURE = {"asyncio", "os", "select", "signal", "socket", "subprocess", "threading", "time", "zmq"}

HOMES = {
    "zmq": ["glue/client/transport.py", "glue/client/__init__.py", "experiment_runner/players.py"],
    "msgpack": ["glue/protocol/wire.py"],
    "numba": ["*/_jit.py"],
    "click": ["*cli.py", "glue/commands.py"],
    "matplotlib": ["experiment_runner/report/plots.py", "experiment_runner/paper/figures.py"],
    "PIL": ["env_server/render/drawing.py"],
    "sqlite3": ["experiment_runner/*"],
}
"""Where a dependency may be imported. Everything else goes through these."""

FORBIDDEN = {
    "pickle": "peers and files are not trusted",
    "marshal": "peers and files are not trusted",
    "shelve": "peers and files are not trusted",
    "random": "every random choice comes from a generator that was handed over",
}

FILES = sorted(
    str(path.relative_to(ROOT)) for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py")
)


def tree(file: str) -> ast.Module:
    return ast.parse((ROOT / file).read_text(), file)


def imported(file: str) -> Iterator[str]:
    """The dotted names of all modules that `file` imports, anywhere in it."""
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            assert node.module is not None
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def top(name: str) -> str:
    return name.partition(".")[0]


def test_there_are_files_to_look_at() -> None:
    assert {"glue/core/engine.py", "glue/hub/server.py", "agents/__init__.py"} <= set(FILES)


@pytest.mark.parametrize("file", FILES)
def test_packages_import_only_whom_they_may(file: str) -> None:
    package = top(file.replace("/", "."))
    ours = {top(name) for name in imported(file)} & MAY_IMPORT.keys()
    assert ours <= {package} | MAY_IMPORT[package]


@pytest.mark.parametrize("file", FILES)
def test_dependencies_stay_at_home(file: str) -> None:
    for name in {top(name) for name in imported(file)} & HOMES.keys():
        assert any(fnmatch(file, home) for home in HOMES[name]), f"{name} is for {', '.join(HOMES[name])}"


@pytest.mark.parametrize("file", FILES)
def test_forbidden_modules_are_not_imported(file: str) -> None:
    for name in {top(name) for name in imported(file)} & FORBIDDEN.keys():
        pytest.fail(f"{name}: {FORBIDDEN[name]}")


@pytest.mark.parametrize("file", FILES)
def test_nothing_is_evaluated_and_no_global_generator_used(file: str) -> None:
    allowed = {"BitGenerator", "Generator", "PCG64", "SeedSequence", "default_rng"}
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("eval", "exec", "compile"), f"line {node.lineno}"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
            owner = node.value
            if isinstance(owner.value, ast.Name) and (owner.value.id, owner.attr) == ("np", "random"):
                assert node.attr in allowed, f"line {node.lineno}: np.random.{node.attr}"


@pytest.mark.parametrize("module", LAYERS)
def test_a_layer_imports_only_those_below(module: str) -> None:
    below = set(LAYERS[: LAYERS.index(module)])
    names = {name.split(".")[1] for name in imported(f"glue/{module}.py") if name.startswith("glue.")}
    assert names & set(LAYERS) <= below


@pytest.mark.parametrize("module", sorted(PURE))
def test_pure_modules_see_no_sockets_clocks_or_threads(module: str) -> None:
    assert not {top(name) for name in imported(f"glue/{module}.py")} & IMPURE


def test_every_command_starts_with_the_core_dependencies_alone() -> None:
    program = """
import importlib, importlib.metadata, sys

class Missing:
    "Hides what a plain install does not bring along."
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {'matplotlib', 'PIL', 'scipy', 'pyarrow', 'gymnasium', 'ray', 'pandas'}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing())
commands = importlib.metadata.entry_points(group='console_scripts')
modules = {point.module for point in commands if point.name.startswith('glue-')}
assert len(modules) >= 9, modules
for module in modules:
    importlib.import_module(module)
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, timeout=120)

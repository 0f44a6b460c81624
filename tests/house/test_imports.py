"""The rules for imports and dependencies: one test per rule, over all modules."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.house.imports import (
    MAY_IMPORT,
    PACKAGES,
    ROOT,
    arrows,
    below,
    files,
    imported,
    imported_files,
    tree,
    unit,
)

PURE = ("glue", "glue/engine", "glue/hub", "glue/wire", "glue/taskspec", "glue/trajectory")
"""Folders that use no sockets, clocks or threads."""

IMPURE = ("asyncio", "select", "signal", "socket", "subprocess", "threading", "time", "zmq")

DOORS = {
    "time": "glue/doors/clock.py",
    "socket": "glue/doors/network.py",
    "select": "glue/doors/network.py",
    "selectors": "glue/doors/network.py",
    "secrets": "glue/doors/chance.py",
    "threading": "glue/doors/threads.py",
}
"""For each of these modules, the one file of `glue` that may import it: tests/simulation replaces it."""

OUTSIDE_THE_DOORS = {"glue/compiled/jit.py"}
"""Exceptions: a thread that watches for signals during compilation, which a simulation does not do."""

MODULES_IN_A_FOLDER = 15

HOMES: Mapping[str, Sequence[str]] = {
    "zmq": ["glue/client/libzmq.py"],
    "nacl": ["glue/wire/curve.py", "glue/keys/signing.py"],
    "msgpack": ["glue/wire/*", "experiment_runner/executors/job.py"],
    "msgspec": ["experiment_runner/executors/job.py", "experiment_runner/store/readings.py"],
    "numba": ["glue/compiled/jit.py", "glue/compiled/threads.py"],
    "docker": ["experiment_runner/competition/containers.py"],
    "requests": ["experiment_runner/competition/containers.py"],
    "click": ["*/cli/*", "glue/plugins/naming.py"],
    "matplotlib": ["experiment_runner/report/*", "experiment_runner/study/paper/figures.py"],
    "PIL": ["env_server/render/*"],
    "imageio_ffmpeg": ["env_server/render/*"],
    "sqlite3": ["experiment_runner/store/*"],
    "pyarrow": ["experiment_runner/store/*", "env_server/datasets/*"],
    "minari": ["env_server/datasets/*"],
    **{key: ["experiment_runner/loggers/*"] for key in ("mlflow", "tensorboard", "trackio", "wandb")},
    "optuna": ["experiment_runner/executors/samplers.py"],
    "scipy": ["experiment_runner/analysis/*"],
    "soar_sml": ["agents/soar/kernel.py"],
    "ray": ["experiment_runner/executors/*"],
    "gymnasium": ["glue/gym/*", "env_server/gym/*", "env_server/datasets/*", "agents/ppo.py"],
    "stable_baselines3": ["glue/gym/sb3.py"],
    "torch": ["agents/ppo.py", "experiment_runner/study/generalisation/imitation.py"],
    "starlette": ["experiment_runner/view/*"],
    "uvicorn": ["experiment_runner/view/server.py", "experiment_runner/view/connections.py"],
}
"""Files that may import a dependency. All other code uses it through these files."""

FORBIDDEN = {
    "pickle": "peers and files are not trusted",
    "marshal": "peers and files are not trusted",
    "shelve": "peers and files are not trusted",
    "random": "every random choice comes from a generator that was handed over",
}

GLOBAL_SEEDS = "glue/global_seeds.py"
"""The module that seeds the global generators, for users' players that draw from them."""


def top(name: str) -> str:
    return name.partition(".")[0]


def test_every_folder_has_a_line_and_every_line_a_folder() -> None:
    assert {unit(file) for file in files()} == MAY_IMPORT.keys()


def test_each_line_names_only_lines_above_it() -> None:
    seen: set[str] = set()
    for name, others in MAY_IMPORT.items():
        assert seen.issuperset(others), f"{name} names a line below its own: there could be a circle"
        seen.add(name)


def test_folders_import_only_whom_they_may() -> None:
    wrong = {
        f"{file} imports {other}"
        for file in files()
        for other in imported_files(file)
        if unit(other) not in below(unit(file))
    }
    assert not wrong


def test_every_permission_is_used() -> None:
    unused = {f"{name} may import {other}" for name, others in MAY_IMPORT.items() for other in others} - {
        f"{name} may import {other}" for name, others in arrows().items() for other in others
    }
    assert not unused


def test_environments_and_agents_never_meet_and_need_glue_alone() -> None:
    for package, stranger in (("env_server", "agents"), ("agents", "env_server")):
        reached = {other.split("/")[0] for other in below(f"{package}/cli")}
        assert reached == {"glue", package}
        assert stranger not in reached


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    """Only imports at import time count, not those under `if TYPE_CHECKING` or within a function."""
    edges = {file: set(imported_files(file, at_import=True)) for file in files()}
    done: set[Path] = set()

    def visit(file: Path, path: tuple[Path, ...]) -> None:
        assert file not in path, f"a circle: {' -> '.join(map(str, (*path, file)))}"
        if file not in done:
            for other in edges[file]:
                visit(other, (*path, file))
            done.add(file)

    for file in files():
        visit(file, ())


def test_dependencies_stay_at_home() -> None:
    wrong = {
        f"{file} imports {name}, which is for {', '.join(HOMES[name])}"
        for file in files()
        for name in {top(name) for name in imported(file)} & HOMES.keys()
        if not any(fnmatch(str(file), home) for home in HOMES[name])
    }
    assert not wrong


def test_forbidden_modules_are_not_imported() -> None:
    wrong = {
        f"{file} imports {name}: {FORBIDDEN[name]}"
        for file in files()
        for name in {top(name) for name in imported(file)} & FORBIDDEN.keys()
        if (name, str(file)) != ("random", GLOBAL_SEEDS)
    }
    assert not wrong


def test_glue_asks_the_system_for_time_network_and_chance_at_one_door_each() -> None:
    wrong = {
        f"{file} imports {name}, which is for {DOORS[name]}"
        for file in files()
        if file.parts[0] == "glue" and str(file) not in OUTSIDE_THE_DOORS
        for name in {top(name) for name in imported(file)} & DOORS.keys()
        if DOORS[name] != str(file)
    }
    assert not wrong


@pytest.mark.parametrize(
    ("owner", "member", "door"),
    [("os", "urandom", "glue/doors/chance.py"), ("os", "sched_yield", "glue/doors/clock.py")],
)
def test_what_os_offers_is_asked_for_at_the_door_as_well(owner: str, member: str, door: str) -> None:
    wrong = {
        str(file)
        for file in files()
        if file.parts[0] == "glue"
        for node in ast.walk(tree(file))
        if isinstance(node, ast.Attribute) and node.attr == member
        if isinstance(node.value, ast.Name) and node.value.id == owner
    }
    assert wrong <= {door}


def test_rules_without_io_see_no_sockets_clocks_or_threads() -> None:
    wrong = {
        f"{file} imports {name}"
        for file in files()
        if unit(file) in PURE
        for name in {top(name) for name in imported(file)} & set(IMPURE)
        | ({"glue.doors.clock", "glue.doors.network", "glue.doors.threads"} & set(imported(file)))
    }
    assert not wrong


def test_nothing_is_evaluated_and_no_global_generator_used() -> None:
    allowed = {"BitGenerator", "Generator", "PCG64", "SeedSequence", "default_rng"}
    for file in files():
        for node in ast.walk(tree(file)):
            if str(file) == GLOBAL_SEEDS:
                continue
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "compile"), f"{file}, line {node.lineno}"
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
                owner = node.value
                if isinstance(owner.value, ast.Name) and (owner.value.id, owner.attr) == ("np", "random"):
                    assert node.attr in allowed, f"{file}, line {node.lineno}: np.random.{node.attr}"


def test_no_folder_holds_more_modules_than_a_reader_can_survey() -> None:
    held = Counter(file.parent for file in files() if file.name != "__init__.py")
    held.update(file.parent for file in (ROOT / "tests").rglob("*.py"))
    assert {str(folder): count for folder, count in held.items() if count > MODULES_IN_A_FOLDER} == {}


@pytest.mark.parametrize("example", ["glue/engine/engine.py", "glue/hub/io/server.py", "agents/cli/agent.py"])
def test_the_rules_look_at_the_modules_of_every_package(example: str) -> None:
    assert Path(example) in files()
    assert {file.parts[0] for file in files()} == set(PACKAGES)


def test_every_command_starts_with_the_core_dependencies_alone() -> None:
    program = """
import importlib, importlib.metadata, sys

class Missing:
    "Hides what a plain install does not bring along."
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {
            'matplotlib', 'PIL', 'scipy', 'optuna', 'pyarrow', 'gymnasium', 'nacl', 'ray', 'pandas', 'docker',
            'polars', 'minari', 'rlglue',
            'requests', 'starlette', 'uvicorn',
        }:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing())
commands = importlib.metadata.entry_points(group='console_scripts')
ours = [point for point in commands if point.name.startswith('glue-')]
assert len(ours) >= 9, ours
for point in ours:
    entry = importlib.import_module(point.module)
    entry.start = importlib.import_module
    getattr(entry, point.attr)()
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, timeout=120)

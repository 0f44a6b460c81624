"""The rules for imports and dependencies: one test per rule, over all modules."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

from tests.house.imports import MAY_IMPORT, PACKAGES, ROOT, below, files_of, modules, unit

NOWHERE: Final = ()

GLOBAL_SEEDS: Final = "glue/global_seeds.py"
"""The module that seeds the global generators, for users' players that draw from them."""

HOMES: Final[Mapping[str, Sequence[str]]] = {
    "zmq": ["glue/client/libzmq.py"],
    "nacl": ["glue/wire/curve.py", "glue/keys/signing.py"],
    "msgpack": ["glue/extras.py", "glue/wire/*", "experiment_runner/executors/job.py"],
    "msgspec": [
        "experiment_runner/competition/board/forms.py",
        "experiment_runner/competition/records/*",
        "experiment_runner/competition/season/*",
        "experiment_runner/competition/settings.py",
        "experiment_runner/executors/job.py",
        "experiment_runner/loggers/stream.py",
        "experiment_runner/plan/*",
        "experiment_runner/store/*",
        "glue/client/season.py",
    ],
    "numba": ["glue/compiled/jit.py", "glue/compiled/memory.py", "glue/compiled/threads.py"],
    "docker": ["experiment_runner/competition/containers.py"],
    "requests": ["experiment_runner/competition/containers.py"],
    "click": ["*/cli/*", "glue/plugins/naming.py"],
    "matplotlib": ["experiment_runner/report/*", "experiment_runner/study/paper/report.py"],
    "PIL": ["env_server/render/*"],
    "imageio_ffmpeg": ["env_server/render/*"],
    "sqlite3": ["experiment_runner/store/*"],
    "pyarrow": ["experiment_runner/store/*", "env_server/datasets/*"],
    "minari": ["env_server/datasets/*"],
    **{key: ["experiment_runner/loggers/*"] for key in ("mlflow", "tensorboard", "trackio", "wandb")},
    "optuna": ["experiment_runner/executors/search.py"],
    "scipy": ["experiment_runner/analysis/stats.py"],
    "soar_sml": ["agents/soar/kernel.py"],
    "ray": ["experiment_runner/executors/*"],
    "gymnasium": ["glue/gym/*", "glue/openenv/*", "env_server/gym/*", "env_server/datasets/*"],
    **{key: ["glue/gym/sb3.py"] for key in ("sb3_contrib", "stable_baselines3")},
    "pettingzoo": ["glue/gym/served.py"],
    "torch": NOWHERE,
    "starlette": ["experiment_runner/view/*", "experiment_runner/competition/season/entrance.py"],
    "prometheus_client": ["experiment_runner/view/season/metrics.py"],
    **dict.fromkeys(("anyio", "mcp", "mcp_types"), ("agents/language/server.py",)),
    "http.client": ["glue/system/web.py"],
    "openenv": ["glue/openenv/*"],
    "pydantic": ["glue/openenv/serving.py"],
    "uvicorn": ["agents/language/server.py", "glue/openenv/serving.py", "experiment_runner/view/server.py"],
    # Peers and files are not trusted.
    **dict.fromkeys(("pickle", "marshal", "shelve", "eval()", "exec()", "compile()"), NOWHERE),
    # Every random choice comes from a generator that was handed over.
    **dict.fromkeys(("random", "np.random.*"), (GLOBAL_SEEDS,)),
    # Libraries name settings by their Python names; these show or start commands, or are programs themselves.
    "--option": [
        "*/cli/*",
        "agents/soar/*",
        "experiment_runner/competition/containers.py",
        "experiment_runner/processes/children.py",
        "experiment_runner/executors/over_hub.py",
        "experiment_runner/plan/provenance.py",
        "experiment_runner/report/progress.py",
        "experiment_runner/slurm/array.py",
        "experiment_runner/view/launch.py",
        "glue/conform/clients/mirror.py",
        "glue/plugins/naming.py",
        "glue/rlglue/package.py",
    ],
    # Only a command line reads its settings from the environment.
    **dict.fromkeys(
        ("os.environ", "os.environb", "os.getenv"),
        (
            "*/cli/*",
            "agents/language/chat.py",  # the key of an endpoint, which no record may hold
            "env_server/gym/rendering.py",  # is there a screen?
            "experiment_runner/competition/containers.py",  # DOCKER_HOST
            "experiment_runner/competition/launching.py",  # passes it on
            "experiment_runner/processes/children.py",  # PYTHONBREAKPOINT
            "glue/client/target.py",  # documented to read GLUE_HUB and others
            "glue/conform/clients/process.py",  # passes it on
        ),
    ),
}
"""Files that may import a module, or use a name. All other code uses it through these files."""

SYSTEM: Final[Mapping[str, Sequence[str]]] = {
    "time": ["glue/system/clock.py"],
    "os.sched_yield": ["glue/system/clock.py"],
    "socket": ["glue/system/network.py"],
    "select": ["glue/system/network.py"],
    "selectors": ["glue/system/network.py"],
    "secrets": ["glue/system/chance.py"],
    "os.urandom": ["glue/system/chance.py"],
    # The other is a thread that watches for signals during compilation, which a simulation does not do.
    "threading": ["glue/system/threads.py", "glue/compiled/jit.py"],
}
"""The files of `glue` that may use these: tests/simulation replaces those of glue/system."""

PURE: Final = ("glue", "glue/engine", "glue/hub", "glue/wire", "glue/taskspec", "glue/trajectory")
"""Folders that use no sockets, clocks or threads."""

IMPURE: Final[Mapping[str, Sequence[str]]] = dict.fromkeys(
    (
        *("asyncio", "select", "signal", "socket", "subprocess", "threading", "time", "zmq"),
        *("glue.system.clock", "glue.system.network", "glue.system.threads"),
    ),
    NOWHERE,
)


def strays(homes: Mapping[str, Sequence[str]], *units: str) -> list[str]:
    """Return a line for each module of these units, or of all, that uses something outside its homes."""
    return [
        f"{module.file} uses {name}, which is for {', '.join(homes[name]) or 'nobody'}"
        for module in modules()
        if not units or module.unit in units
        for name in module.names & homes.keys()
        if not any(fnmatch(str(module.file), home) for home in homes[name])
    ]


def test_what_has_a_home_is_used_there_alone() -> None:
    assert strays(HOMES) == []


def test_glue_asks_the_system_for_time_network_and_chance_at_one_door_each() -> None:
    assert strays(SYSTEM, *(name for name in MAY_IMPORT if name.split("/")[0] == "glue")) == []


def test_rules_without_io_see_no_sockets_clocks_or_threads() -> None:
    assert strays(IMPURE, *PURE) == []


def test_every_folder_has_a_line_and_every_line_a_folder() -> None:
    assert {module.unit for module in modules()} == MAY_IMPORT.keys()
    assert {name.split("/")[0] for name in MAY_IMPORT} == set(PACKAGES)


def test_each_line_names_only_lines_above_it() -> None:
    seen: set[str] = set()
    for name, others in MAY_IMPORT.items():
        assert seen.issuperset(others), f"{name} names a line below its own: there could be a circle"
        seen.add(name)


def test_folders_import_only_whom_they_may() -> None:
    wrong = {
        f"{module.file} imports {other}"
        for module in modules()
        for other in files_of(module.imported)
        if unit(other) not in below(module.unit)
    }
    assert not wrong


def test_environments_and_agents_never_meet_and_need_glue_alone() -> None:
    for package in ("env_server", "agents"):
        assert {other.split("/")[0] for other in below(f"{package}/cli")} == {"glue", package}


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    """Only imports at import time count, not those under `if TYPE_CHECKING` or within a function."""
    edges = {module.file: set(files_of(module.at_import)) for module in modules()}
    done: set[Path] = set()

    def visit(file: Path, path: tuple[Path, ...]) -> None:
        assert file not in path, f"a circle: {' -> '.join(map(str, (*path, file)))}"
        if file not in done:
            for other in edges[file]:
                visit(other, (*path, file))
            done.add(file)

    for file in edges:
        visit(file, ())


def test_every_command_starts_with_the_core_dependencies_alone() -> None:
    program = """
import importlib, importlib.metadata, sys

class Missing:
    "Hides what a plain install does not bring along."
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {
            'matplotlib', 'PIL', 'scipy', 'optuna', 'pyarrow', 'gymnasium', 'nacl', 'ray', 'pandas', 'docker',
            'polars', 'minari', 'rlglue', 'mcp',
            'requests', 'starlette', 'uvicorn', 'prometheus_client',
        }:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing())
commands = importlib.metadata.entry_points(group='console_scripts')
ours = [point for point in commands if point.name.startswith('glue-')]
assert len(ours) >= 9, ours
for point in ours:
    entry = importlib.import_module(point.module)
    entry.start = lambda module, name: getattr(importlib.import_module(module), name)
    getattr(entry, point.attr)()
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, timeout=120)

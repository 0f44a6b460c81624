"""Configuration of all tests: stages, modules such as `tests.players` made importable, and Ctrl-C.

`make test` runs the tests that have no stage, and `pytest --stage=NAME` those of one stage of `.ci/run`. A
test has a stage because its folder or module is in `FOLDERS`, or by the marker `stage`.

Modules with slow tests run first, so that the other processes do not wait for one of them at the end. All
tests of a module run in one process (`--dist=loadfile` in the Makefile), which creates shared objects once.
"""

from __future__ import annotations

import os
import signal
import sys
from functools import cache
from pathlib import Path
from typing import Final

import pytest
from hypothesis import settings

FOLDERS: Final = {
    "agents/language/test_mcp.py": "language",
    "agents/soar": "soar",
    "clients": "clients",
    "experiment_runner/loggers": "loggers",
    "experiment_runner/study": "studies",
    "experiment_runner/view/browser": "page",
    "env_server/gym/test_libraries.py": "gymnasium",
    **{f"glue/gym/test_{name}.py": "gymnasium" for name in ("games", "maskable", "sb3")},
    "glue/openenv/test_openenv.py": "openenv",
    "jails": "containers",
    "model": "model",
    "package/test_coming_from.py": "coming_from",
    "package/test_distributions.py": "package",
    "package/test_names.py": "package",
    "package/test_notebooks.py": "notebooks",
    "package/test_site.py": "site",
    "season": "season",
    "studies": "studies",
    "system/slurm": "slurm",
    "system/test_ray.py": "ray",
}
"""The stage of all tests of a folder or module of `tests/`; other stages do not even import it."""

STAGES: Final = sorted(
    {*FOLDERS.values(), "attacks", "conformance", "docs", "gymnasium", "keys", "kills", "proof"}
)

_HERE: Final = Path(__file__).parent

sys.path.insert(0, str(_HERE.parent))

# A shell may start background jobs with interrupts ignored, and every process that we start inherits that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# NumPy's linear algebra starts a thread for each core: a tenth of a second in every process of a test.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# No test asserts timing: the first example of a property may have to compile or import.
settings.register_profile("glue", deadline=None)
settings.load_profile("glue")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--stage",
        choices=["test", *STAGES, "all"],
        default="test",
        help="run the tests of this stage of `.ci/run` instead of those of `make test`",
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    wanted = config.getoption("--stage")
    stage = FOLDERS.get(_name(collection_path))
    if wanted == "all" or stage == wanted:
        return None
    if stage is not None:
        return True
    # To import all tests would take most of the time of a small stage.
    ours = wanted == "test" or collection_path.suffix != ".py" or _stage_of(collection_path) == wanted
    return None if ours or f'stage("{wanted}")' in collection_path.read_text("utf-8") else True


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    stage = config.getoption("--stage")
    others = {item for item in items if stage not in (_stage(item), "all")}
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item not in others]
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in slow)


def pytest_report_header(config: pytest.Config) -> str:
    return f"stage: {config.getoption('--stage')}, of {', '.join(('test', *STAGES, 'all'))} (--stage)"


def _stage(item: pytest.Item) -> str:
    marker = item.get_closest_marker("stage")
    if marker is None:
        return _stage_of(item.path)
    (stage,) = marker.args
    assert stage in STAGES, f"{item.nodeid} has the unknown stage {stage!r}"
    return str(stage)


@cache
def _stage_of(path: Path) -> str:
    return next((FOLDERS[name] for name in map(_name, (path, *path.parents)) if name in FOLDERS), "test")


def _name(path: Path) -> str:
    """Return the path below the folder of the tests."""
    return path.relative_to(_HERE).as_posix() if path.is_relative_to(_HERE) else ""

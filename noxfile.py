#!/usr/bin/env -S python3
# /// script
# requires-python = ">=3.11"
# dependencies = ["nox>=2025.2.9", "uv>=0.5"]
# ///
"""Checks that need environments of their own; `.ci/run STAGE` runs the session of that name."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "virtualenv"
nox.options.reuse_existing_virtualenvs = True

DIST = Path("build/dist")
SITE = "build/site"
TESTING = ["hypothesis", "pytest", "pytest-timeout"]

UV = [sys.executable, "-m", "uv", "--quiet"]

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]

ROOMS = ["contract", "fuzzing", "glue/engine", "glue/plugins", "glue/test_types.py", "glue/wire", "house"]
COMPILED = ["mario", "soar", "planner", "best", "hierarchical", "tiles", "objects"]
MATRIX = [
    *(f"tests/{room}" for room in ROOMS),
    "tests/system/test_older_run.py",
    *("-k", " and ".join(f"not {name}" for name in COMPILED)),
]
"""Tests for each Python: the whole protocol, old files, and the players that compile nothing."""

LOWEST_TESTING = ["hypothesis>=6.100", "pytest>=8.2", "pytest-timeout>=2.3"]

LIBRARIES = {
    "coming_from": "tests/package/test_coming_from.py",
    "language": "tests/agents/language/test_mcp.py",
    "loggers": "tests/experiment_runner/loggers",
    "notebooks": "tests/package/test_notebooks.py",
}
"""Stages that need optional libraries, all in one environment, and their tests."""


@nox.session
def package(session: nox.Session) -> None:
    """Build wheel and sdist; check their contents, and try them alone and beside others of the same names."""
    shutil.rmtree(DIST, ignore_errors=True)
    session.install("build", *TESTING, "--editable", ".")
    session.run("pyproject-build", "--outdir", str(DIST))
    tests = ["tests/package/test_distributions.py", "tests/package/test_names.py"]
    session.run("pytest", "--stage=package", *tests, *session.posargs, env={"GLUE_DIST": str(DIST)})


@nox.session(default=False)
def mutation(session: nox.Session) -> None:
    """Mutate engine and codec, and list the mutants that no test notices: an hour or less."""
    session.install("mutmut==3.8.1", "--editable", ".[dev]")
    session.run("mutmut", "run", *session.posargs)
    session.run("mutmut", "results")


@nox.session(default=False)
def site(session: nox.Session) -> None:
    """Build the site without warnings, and check it in Chromium, with axe-core if AXE_CORE names it."""
    session.install("--editable", ".[docs]", *TESTING, "selenium>=4.20")
    session.run("sphinx-build", "--fail-on-warning", "--keep-going", "--quiet", "docs", SITE)
    tests = ["--stage=site", "tests/package/test_site.py"]
    session.run("pytest", *tests, *session.posargs, env={"GLUE_SITE": SITE})


@nox.session(default=False)
def libraries(session: nox.Session) -> None:
    """Run the named stages that need optional libraries, or all: see `LIBRARIES`."""
    extras = "gym,mcp,notebooks,pandas,polars,render,tensorboard,trackio,wandb"
    others = ["dm-env", "mlflow", "PyExpUtils-andnp", "rlglue-andnp"]
    session.install("--editable", f".[{extras}]", *others, *TESTING)
    for stage in session.posargs or LIBRARIES:
        session.run("pytest", f"--stage={stage}", LIBRARIES[stage])


@nox.session(default=False)
def openenv(session: nox.Session) -> None:
    """Play with OpenEnv's own server and client, whose packages exclude those of other stages."""
    session.install("--editable", ".[openenv]", *TESTING)
    session.run("pytest", "--stage=openenv", "tests/glue/openenv", *session.posargs)


@nox.session(default=False)
def repository(session: nox.Session) -> None:
    """Review the repository's metadata, workflows and citation."""
    session.install("cffconvert", "sp-repo-review[cli]", "zizmor")
    session.run("cffconvert", "--validate")
    session.run("repo-review", ".")
    session.run("zizmor", "--offline", "--quiet", ".github")


@nox.session(default=False, venv_backend="none")
def pythons(session: nox.Session) -> None:
    """Run tests on the system's Python, the oldest with the lowest versions, the newest with the highest."""
    oldest, *_, newest = interpreters()
    environments = {
        "system": ("/usr/bin/python3", "highest"),
        "oldest": (oldest, "lowest-direct"),
        "newest": (newest, "highest"),
    }
    session.log(f"found {environments}")
    extras = [f"--extra={name}" for name in ("gym", "keys", "web")]
    for name, (python, resolution) in environments.items():
        folder = f"{session.create_tmp()}/{name}"
        session.run(*UV, "venv", "--clear", "--python", python, folder)
        install = [*UV, "pip", "install", "--python", folder]
        wanted = ["-r", "pyproject.toml", *extras, *LOWEST_TESTING]
        session.run(*install, "--resolution", resolution, "--only-binary", ":all:", *wanted)
        session.run(*install, "--no-deps", "--editable", ".")
        pytest = [f"{folder}/bin/python", "-m", "pytest", "-p", "no:cacheprovider"]
        session.run(*pytest, *MATRIX, *session.posargs)


def interpreters() -> list[str]:
    """Return a Python of each version that is installed, from pyenv or from the path, the oldest first."""
    found = []
    for version in PYTHONS:
        pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
        for candidate in filter(None, (*map(str, pyenv), shutil.which(f"python{version}"))):
            asked = [candidate, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]
            if subprocess.run(asked, capture_output=True, text=True).stdout.strip() == version:
                found.append(candidate)
                break
    return found


if __name__ == "__main__":
    nox.main()

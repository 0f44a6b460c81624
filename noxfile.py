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

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
LOWEST_TESTING = ["hypothesis>=6.100", "pytest>=8.2", "pytest-timeout>=2.3"]
MATRIX = [
    *(
        f"tests/{room}"
        for room in ("glue/wire", "glue/engine", "glue/plugins", "glue/test_types.py", "contract")
    ),
    *(
        "-k",
        " and ".join(
            f"not {name}" for name in ["mario", "soar", "planner", "best", "hierarchical", "tiles", "objects"]
        ),
    ),
]
"""Tests for each Python: the whole protocol, and the players that compile nothing."""


def build(session: nox.Session) -> dict[str, str]:
    """Rebuild wheel and sdist; return the environment variable that names their folder to the tests."""
    shutil.rmtree(DIST, ignore_errors=True)
    session.install("build", *TESTING, "--editable", ".")
    session.run("pyproject-build", "--outdir", str(DIST))
    return {"GLUE_DIST": str(DIST)}


@nox.session
def package(session: nox.Session) -> None:
    """Build wheel and sdist, check their contents, and try everything with only the wheel installed."""
    session.run("pytest", "tests/package/test_distributions.py", *session.posargs, env=build(session))


@nox.session(default=False)
def mutation(session: nox.Session) -> None:
    """Mutate engine and codec, and list the mutants that no test notices: an hour or less."""
    session.install("mutmut==3.8.1", "--editable", ".[dev]")
    session.run("mutmut", "run", *session.posargs)
    session.run("mutmut", "results")


@nox.session(default=False)
def names(session: nox.Session) -> None:
    """Test next to distributions with packages of the same names, in both orders of installation."""
    session.run("pytest", "tests/package/test_names.py", *session.posargs, env=build(session))


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """Build the site without warnings, and check it in Chromium, with axe-core if AXE_CORE names it."""
    session.install("--editable", ".[docs]", *TESTING, "selenium>=4.20")
    session.run("sphinx-build", "--fail-on-warning", "--keep-going", "--quiet", "docs", SITE)
    session.run("pytest", "tests/package/test_site.py", *session.posargs, env={"GLUE_SITE": SITE})


@nox.session(default=False)
def notebooks(session: nox.Session) -> None:
    """Execute the notebooks of docs/notebooks."""
    session.install("--editable", ".[notebooks]", *TESTING)
    session.run("pytest", "tests/package/test_notebooks.py", *session.posargs, env={"GLUE_NOTEBOOKS": "1"})


@nox.session(default=False)
def coming_from(session: nox.Session) -> None:
    """Play the experiments of docs/coming-from.md with the other libraries, and with ours."""
    libraries = ["dm-env", "PyExpUtils-andnp", "rlglue-andnp"]
    session.install("--editable", ".[gym,pandas,polars]", *libraries, *TESTING)
    session.run("pytest", "tests/package/test_coming_from.py", *session.posargs, env={"GLUE_COMING": "1"})


@nox.session(default=False)
def loggers(session: nox.Session) -> None:
    """Send runs to TensorBoard, W&B, MLflow and Trackio, and compare them with their servers' data."""
    session.install("--editable", ".[tensorboard,trackio,wandb]", "mlflow", *TESTING)
    session.run("pytest", "tests/experiment_runner/loggers", *session.posargs)


@nox.session(default=False)
def repository(session: nox.Session) -> None:
    """Review the repository's metadata, workflows and citation."""
    session.install("cffconvert", "sp-repo-review[cli]", "zizmor")
    session.run("cffconvert", "--validate")
    session.run("repo-review", ".")
    session.run("zizmor", "--offline", "--quiet", ".github")


@nox.session(default=False, venv_backend="none")
def pythons(session: nox.Session) -> None:
    """Run tests on every installed Python, with the lowest and the newest dependencies."""
    found = {version: path for version in PYTHONS if (path := interpreter(version))}
    session.log(f"found {found}")
    for version, path in found.items():
        for resolution in ("lowest-direct", "highest"):
            folder = f"{session.create_tmp()}/{version}-{resolution}"
            uv = [sys.executable, "-m", "uv", "--quiet"]
            session.run(*uv, "venv", "--clear", "--python", path, folder)
            install = [*uv, "pip", "install", "--python", folder]
            extras = [f"--extra={name}" for name in ("gym", "keys", "web")]
            wanted = ["-r", "pyproject.toml", *extras, *LOWEST_TESTING]
            session.run(*install, "--resolution", resolution, "--only-binary", ":all:", *wanted)
            session.run(*install, "--no-deps", "--editable", ".")
            pytest = [f"{folder}/bin/python", "-m", "pytest", "-p", "no:cacheprovider"]
            session.run(*pytest, *MATRIX, *session.posargs)


def interpreter(version: str) -> str | None:
    """Return a Python of this version, from the path or from pyenv."""
    pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for candidate in filter(None, [shutil.which(f"python{version}"), *pyenv]):
        asked = [candidate, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]
        if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() == version:
            return str(candidate)
    return None


if __name__ == "__main__":
    nox.main()

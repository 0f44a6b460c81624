"""The small repositories with which entrants begin: each builds, and its agent plays."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from experiment_runner.competition.season.starter import LANGUAGES, write_starter
from glue.errors import ConfigError
from tests.house.imports import ROOT

_TOOLS = {"java": "javac", "cpp": "g++", "js": "npm", "rust": "cargo", "python": "make"}
_SECONDS = 300


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_starter_has_what_its_readme_speaks_of(language: str, tmp_path: Path) -> None:
    write_starter(language, tmp_path / "new")
    files = {str(path.relative_to(tmp_path / "new")) for path in (tmp_path / "new").rglob("*")}
    assert {"README.md", "Makefile", "Dockerfile", ".gitignore", ".github/workflows/season.yml"} <= files
    for path in files:
        if (tmp_path / "new" / path).is_file():
            assert "@" + "VERSION" not in (tmp_path / "new" / path).read_text()
    assert "*.key_secret" in (tmp_path / "new/.gitignore").read_text().splitlines()
    assert "*.key_secret" in (tmp_path / "new/.dockerignore").read_text().splitlines()


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("work of months")
    with pytest.raises(ConfigError, match="not empty"):
        write_starter("python", tmp_path)


@pytest.mark.stage("clients")
@pytest.mark.parametrize("language", LANGUAGES)
def test_a_starter_builds(language: str, tmp_path: Path) -> None:
    if shutil.which(_TOOLS[language]) is None:
        pytest.skip(f"needs {_TOOLS[language]}")
    write_starter(language, tmp_path)
    (tmp_path / "glue-rl").symlink_to(ROOT)
    done = subprocess.run(
        ["make", "build"], cwd=tmp_path, capture_output=True, text=True, timeout=_SECONDS, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_agent_in_python_plays(tmp_path: Path) -> None:
    from tests import forked

    write_starter("python", tmp_path / "new")
    arguments = ("--env", "mines", "--agent", "agent.py:MyAgent", "--episodes", "2", "--out", "run")
    forked.run("glue-experiment", *arguments, "--in-process", cwd=tmp_path / "new", status=0)

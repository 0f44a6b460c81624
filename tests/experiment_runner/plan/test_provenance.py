from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path

import pytest

from experiment_runner.plan import provenance
from glue import __version__

VERSION = f"glue-rl {__version__}"


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=Somebody", "-c", "user.email=somebody@example.org"]
    subprocess.run(["git", "-C", str(folder), *identity, *arguments], check=True, capture_output=True)


def program_of(path: Path) -> str:
    """Return the program to which a copy of the module claims to belong."""
    spec = importlib.util.spec_from_file_location("copy", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return str(module.program())


@pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")
def test_commit_is_named_only_where_the_program_is_in_the_repository(tmp_path: Path) -> None:
    path = tmp_path / "provenance.py"
    shutil.copy(provenance.__file__, path)
    assert program_of(path) == VERSION
    git(tmp_path, "init")
    (tmp_path / "thesis.tex").write_text("mine")
    git(tmp_path, "add", "thesis.tex")
    git(tmp_path, "commit", "-m", "somebody else's repository, with the program installed in it")
    assert program_of(path) == VERSION
    git(tmp_path, "add", "provenance.py")
    git(tmp_path, "commit", "-m", "the program's own")
    version, commit = program_of(path).split(", ")
    assert version == VERSION
    assert len(commit.removeprefix("commit ")) == 12
    path.write_text(path.read_text() + "\n")
    assert program_of(path) == f"{version}, {commit}, modified"

"""The script that provides a container engine, with short scripts in place of the programs it calls."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.house.imports import ROOT

_UNAVAILABLE = 69
_LOCKED = "echo 'E: Could not get lock /var/lib/dpkg/lock-frontend. It is held by process 1' >&2; exit 100"


def engine(folder: Path, *command: str, **programs: str) -> subprocess.CompletedProcess[str]:
    """Run `docker/engine COMMAND...`, with these lines of shell as `docker`, `apt-get` and others."""
    for name, lines in {"sleep": "", **programs}.items():
        program = folder / name.replace("_", "-")
        program.write_text(f"#!/bin/sh\n{lines}\n")
        program.chmod(0o755)
    settings = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "XDG_CACHE_HOME": str(folder)}
    return subprocess.run(
        ["docker/engine", *command],
        cwd=ROOT,
        env=settings,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("status", [0, 3])
def test_it_exits_as_the_command_did(tmp_path: Path, status: int) -> None:
    assert engine(tmp_path, "sh", "-c", f"exit {status}", docker="exit 0").returncode == status


def test_a_success_means_that_the_command_was_run(tmp_path: Path) -> None:
    """Without an engine, and while apt fails for a reason other than a lock."""
    failed = engine(
        tmp_path, "true", docker="exit 1", dpkg="exit 1", apt_get="echo 'E: no network' >&2; exit 100"
    )
    assert failed.returncode == _UNAVAILABLE
    assert "no containers here" in failed.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root starts an engine")
def test_it_waits_for_another_apt(tmp_path: Path) -> None:
    """Two calls meet a lock; then the packages are installed, but no engine starts."""
    calls = tmp_path / "calls"
    apt = f"echo $1 >> {calls}; [ $(wc -l < {calls}) -gt 2 ] || {{ {_LOCKED}; }}"
    failed = engine(tmp_path, "true", docker="exit 1", dpkg="exit 1", apt_get=apt, unshare="exit 1")
    assert calls.read_text().split() == ["update", "update", "update", "install"]
    assert failed.returncode == _UNAVAILABLE
    assert "waiting for another apt" in failed.stdout
    assert "no Docker engine starts" in failed.stderr

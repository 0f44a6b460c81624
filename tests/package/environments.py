"""Virtual environments into which distributions are installed, and programs in them, outside the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.pages import ROOT

DIST: Final = os.environ.get("GLUE_DIST", "")
"""A folder with the wheel and the sdist, which `nox -s package` builds."""

COMMANDS: Final = list(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["scripts"])


@dataclass(frozen=True)
class Installed:
    """A virtual environment, and a working directory for the programs in it."""

    folder: Path
    cwd: Path

    @classmethod
    def make(cls, folder: Path) -> Installed:
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
        (folder / "cwd").mkdir()
        return cls(folder / "venv", folder / "cwd")

    @property
    def packages(self) -> Path:
        (found,) = self.folder.glob("lib/python3*/site-packages")
        return found

    def pip(self, *arguments: str) -> None:
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "--python"]
        subprocess.run([*pip, self.folder / "bin/python", *arguments], check=True)

    def install(self, *requirements: str) -> None:
        self.pip("install", "--only-binary=:all:", *requirements)

    def environ(self) -> Mapping[str, str]:
        """Return the variables of programs there: neither a compiler nor the checkout is on any path."""
        return {
            "PATH": str(self.folder / "bin"),
            "HOME": str(self.cwd),
            "LANG": "C.UTF-8",
            "NUMBA_CACHE_DIR": str(self.folder / "numba"),
        }

    def run(self, *command: str, status: int = 0) -> subprocess.CompletedProcess[str]:
        ended = subprocess.run(
            [self.folder / "bin" / command[0], *command[1:]],
            cwd=self.cwd,
            env=self.environ(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=280,
        )
        assert ended.returncode == status, (command, ended.stdout, ended.stderr)
        return ended

    def python(self, program: str, status: int = 0) -> subprocess.CompletedProcess[str]:
        return self.run("python", "-c", program, status=status)

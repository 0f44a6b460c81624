"""C programs linked with libzmq."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def compiled(source: Path, folder: Path) -> Path:
    """Compile a source file and return the program; skip the test if the compiler or zmq.h is missing."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip(f"there is no C compiler here to build {source.name}")
    includes = subprocess.run([compiler, "-E", "-"], input=b"#include <zmq.h>\n", capture_output=True)
    if includes.returncode != 0:
        pytest.skip(f"there is no zmq.h here to build {source.name} (Debian: libzmq3-dev)")
    program = folder / source.stem
    strict = ["-std=c11", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *strict, "-o", str(program), str(source), "-lzmq"], check=True)
    return program

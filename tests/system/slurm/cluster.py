"""A SLURM cluster of this machine only: munged, slurmctld and slurmd, started by hand."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import pytest

from tests.system.runs import wait_until

_PROGRAMS: Final = ("munged", "slurmctld", "slurmd", "sbatch")

_CONFIG: Final = Path(__file__).with_name("slurm.conf").read_text("utf-8")
"""The configuration, without the folder and the ports."""


@contextmanager
def slurm_cluster() -> Iterator[Path]:
    """Run a cluster with two processors, and let SLURM_CONF name it.

    Yields:
        The folder of its logs.
    """
    missing = [name for name in _PROGRAMS if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        pytest.skip(f"SLURM cannot be started here: {', '.join(missing) or 'only root starts its daemons'}")
    with ExitStack() as stack:
        # Sockets need a shorter path than pytest's folders have.
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="slurm-", ignore_cleanup_errors=True)))
        folder.chmod(0o755)
        for name in ("state", "spool"):
            (folder / name).mkdir()
        key = folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        (folder / "slurm.conf").write_text(_CONFIG.format(folder=folder, ports=_free_ports(2)))
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
        munge = ["munged", "--foreground", "--force", f"--key-file={key}", f"--socket={folder}/munge"]
        munge += [f"--{name}-file={folder}/munge.{name}" for name in ("pid", "log", "seed")]
        _start(stack, munge)
        wait_until((folder / "munge").exists, "munged")
        _start(stack, ["slurmctld", "-D"])
        _start(stack, ["slurmd", "-D", "-N", "localhost"])
        wait_until(lambda: "idle" in _output("sinfo", "--noheader"), "a node")
        yield folder


def _start(stack: ExitStack, command: list[str]) -> None:
    program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stack.callback(program.wait)
    stack.callback(program.terminate)


def _output(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]

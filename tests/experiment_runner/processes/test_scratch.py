from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from experiment_runner.processes.scratch import scratch_folder

HOLD = """
import sys
from experiment_runner.processes.scratch import scratch_folder
with scratch_folder() as folder:
    (folder / "hub").touch()
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def _temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def test_folder_of_a_killed_run_is_removed_and_that_of_a_living_one_stays(tmp_path: Path) -> None:
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    killed, living = processes
    folders = []
    for process in processes:
        assert process.stdout is not None
        folders.append(Path(process.stdout.readline().strip()))
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    others = tmp_path / "glue-of-somebody-else"
    others.mkdir()
    (others / "thesis.tex").touch()
    with scratch_folder() as folder:
        assert os.stat(folder).st_mode & 0o077 == 0
        assert [path.exists() for path in folders] == [False, True]
    assert not folder.exists()
    assert (others / "thesis.tex").exists()
    living.communicate()
    assert sorted(tmp_path.iterdir()) == [others]


def test_folder_of_version_0_1_0_is_removed_when_nobody_listens_in_it(tmp_path: Path) -> None:
    """That version took no lock."""
    dead, living, empty = (tmp_path / f"glue-{name:_<8}" for name in ("dead", "living", "empty"))
    for folder in (dead, living, empty):
        folder.mkdir()
    with socket.socket(socket.AF_UNIX) as once, socket.socket(socket.AF_UNIX) as listening:
        once.bind(str(dead / "hub"))
        once.listen()
        once.close()
        listening.bind(str(living / "hub"))
        listening.listen()
        with scratch_folder():
            assert [folder.exists() for folder in (dead, living, empty)] == [False, True, True]


def test_socket_in_a_folder_of_another_program_is_not_knocked_at(tmp_path: Path) -> None:
    """A hub under test would see a client that connects and leaves."""
    folder = tmp_path / "glue-conform-0e836mdz"
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(folder / "hub"))
        listening.listen()
        listening.setblocking(False)
        with scratch_folder(), pytest.raises(BlockingIOError):
            listening.accept()

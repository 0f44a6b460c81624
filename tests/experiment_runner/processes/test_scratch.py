from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from experiment_runner.processes.scratch import SOCKET, scratch_folder
from experiment_runner.store.layout import LOCK_FILE, RunLock


def test_folder_of_a_killed_run_is_removed_and_that_of_a_living_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    killed, thesis, unlocked = (tmp_path / f"glue-{name:_<8}" for name in ("killed", "thesis", "unlocked"))
    for folder, file in ((killed, SOCKET), (thesis, "thesis.tex"), (unlocked, SOCKET)):
        folder.mkdir()
        (folder / file).touch()
    for folder in (killed, thesis):  # their locks are files, which no process holds
        RunLock(folder).release()
    with scratch_folder() as living:
        (living / SOCKET).touch()
        with scratch_folder() as folder:
            assert os.stat(folder).st_mode & 0o077 == 0
            assert [path.exists() for path in (killed, thesis, unlocked, living)] == [False, True, True, True]
        assert not folder.exists()
    assert not living.exists()
    assert {path.name for path in thesis.iterdir()} == {LOCK_FILE, "thesis.tex"}

"""What a container uses, in the files of both versions of control groups."""

from __future__ import annotations

import shutil
from pathlib import Path

from experiment_runner.competition.usage import ControlGroup

ID = "0123456789abcdef"


def second(root: Path) -> Path:
    """Make the files of version 2; return the container's folder."""
    (root / "cgroup.controllers").write_text("cpu memory\n")
    folder = root / "system.slice" / f"docker-{ID}.scope"
    folder.mkdir(parents=True)
    (root / "system.slice/docker-other.scope").mkdir()
    (folder / "cpu.stat").write_text("usage_usec 2500000\nuser_usec 1\nsystem_usec 2\n")
    (folder / "memory.peak").write_text("1048576\n")
    return folder


def test_the_group_of_podmans_monitor_is_not_the_containers(tmp_path: Path) -> None:
    folder = second(tmp_path)
    folder.rename(tmp_path / f"system.slice/libpod-conmon-{ID}.scope")
    assert ControlGroup(ID, tmp_path).processor is None
    (tmp_path / f"system.slice/libpod-conmon-{ID}.scope").rename(tmp_path / f"libpod-{ID}.scope")
    assert ControlGroup(ID, tmp_path).processor == 2.5


def test_version_1_has_a_tree_for_each_resource(tmp_path: Path) -> None:
    for tree, file, text in (
        ("cpuacct", "cpuacct.usage", "1500000000\n"),
        ("memory", "memory.max_usage_in_bytes", "4096\n"),
    ):
        folder = tmp_path / tree / "docker" / ID
        folder.mkdir(parents=True)
        (folder / file).write_text(text)
    group = ControlGroup(ID, tmp_path)
    assert (group.processor, group.peak) == (1.5, 4096)


def test_version_2_has_one_tree_and_the_last_that_was_known_outlives_the_container(tmp_path: Path) -> None:
    folder = second(tmp_path)
    group = ControlGroup(ID, tmp_path)
    assert (group.processor, group.peak) == (2.5, 1048576)
    (folder / "cpu.stat").write_text("usage_usec 3500000\n")
    group.read()
    shutil.rmtree(folder)
    group.read()
    assert (group.processor, group.peak) == (3.5, 1048576)


def test_where_there_are_none_nothing_is_known(tmp_path: Path) -> None:
    for root in (tmp_path, tmp_path / "missing"):
        group = ControlGroup(ID, root)
        assert (group.processor, group.peak) == (None, None)

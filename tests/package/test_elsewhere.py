"""Agents elsewhere: without what only Linux has, and beside packages of our names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from glue.names import hidden_names, others

WITHOUT = """
import select, socket, sys
sys.modules["fcntl"] = sys.modules["resource"] = None
for module, names in ((select, ("epoll",)), (socket, ("AF_UNIX", "TCP_USER_TIMEOUT", "SO_PEERCRED"))):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
"""


@pytest.mark.parametrize(
    "program",
    [
        "import glue; [getattr(glue, name) for name in glue.__all__]",
        "from glue import local, make, make_agent\n"
        "with local(make_agent('sarsa'), make('mines')) as glue:\n"
        "    glue.rl_init(seed=1); glue.rl_episode(20)",
    ],
    ids=["names", "local"],
)
def test_works_without_what_only_linux_has(program: str) -> None:
    subprocess.run([sys.executable, "-c", WITHOUT + program], check=True, timeout=120)


def test_a_package_of_our_name_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a/agents").mkdir(parents=True)
    (tmp_path / "a/agents/__init__.py").touch()
    (tmp_path / "a/env_server").mkdir()  # without __init__.py it hides nothing
    (tmp_path / "glue.py").touch()
    assert others([str(tmp_path / "a")]) == {"agents": str(tmp_path / "a/agents/__init__.py")}
    assert others([str(tmp_path)]) == {"glue": str(tmp_path / "glue.py")}
    assert hidden_names() == ""
    monkeypatch.syspath_prepend(tmp_path / "a")
    assert str(tmp_path / "a/agents/__init__.py") in hidden_names()

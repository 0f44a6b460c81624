"""An agent needs nothing that only Linux has."""

from __future__ import annotations

import subprocess
import sys

import pytest

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

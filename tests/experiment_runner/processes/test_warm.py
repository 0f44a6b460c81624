from __future__ import annotations

import fcntl
import os
import resource
import struct
import subprocess

import pytest

from experiment_runner.processes.warm import Fork

HIGH = 1500
NOBODY = 2**30
"""No process has such an ID."""


@pytest.mark.skipif(
    resource.getrlimit(resource.RLIMIT_NOFILE)[0] <= HIGH, reason="a process may not open so many files here"
)
def test_fork_is_waited_for_in_a_process_with_many_open_files() -> None:
    status, theirs = os.pipe()
    high = fcntl.fcntl(status, fcntl.F_DUPFD_CLOEXEC, HIGH)
    os.close(status)
    stdin, ours = os.pipe()
    os.close(stdin)
    with os.fdopen(ours, "wb", 0) as pipe:
        fork = Fork(NOBODY, pipe, high)
        with pytest.raises(subprocess.TimeoutExpired):
            fork.wait(0.01)
        assert fork.poll() is None
        os.write(theirs, struct.pack("<i", 3))
        os.close(theirs)
        assert fork.wait() == 3

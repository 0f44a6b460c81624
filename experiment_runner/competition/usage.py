"""The processor time and memory that the programs of a container use, as the kernel counts them."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Final

_ROOT: Final = Path("/sys/fs/cgroup")
_USEC: Final = re.compile(r"usage_usec (\d+)")


class ControlGroup:
    """The control group of a container, of either version.

    It is looked for by the container's id, since the engine may count processes differently, and may place
    its groups anywhere. If this process cannot see it, nothing is known.

    Args:
        container: id of the container, which runs.
        root: where control groups are mounted.

    Attributes:
        processor: seconds used of all processors; the last known if the container is gone; None if unknown.
        peak: most bytes of memory used at once, likewise.
    """

    def __init__(self, container: str, root: Path = _ROOT) -> None:
        second = (root / "cgroup.controllers").is_file()
        processor, memory = (root, root) if second else (root / "cpuacct", root / "memory")
        self._processor = _file(processor, container, "cpu.stat" if second else "cpuacct.usage")
        self._memory = _file(memory, container, "memory.peak" if second else "memory.max_usage_in_bytes")
        self._second = second
        self.processor: float | None = None
        self.peak: int | None = None
        self.read()

    def read(self) -> None:
        """Bring the attributes up to date."""
        with suppress(OSError, ValueError):
            if self._processor is not None:
                text = self._processor.read_text()
                found = _USEC.search(text) if self._second else None
                self.processor = int(found[1]) / 1e6 if found else int(text) / 1e9
            if self._memory is not None:
                self.peak = int(self._memory.read_text())


def _file(root: Path, container: str, name: str) -> Path | None:
    """Return a file of a container's control group; None if there is no such group below `root`."""
    wanted = re.compile(rf"(\w+-)?{container}(\.scope)?")  # not podman's own, libpod-conmon-ID.scope
    for folder, below, _ in os.walk(root):
        for group in filter(wanted.fullmatch, below):
            return Path(folder, group, name)
    return None

"""Hosts as network namespaces of Linux, and a router between them that can drop all packets."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

NEAR: Final = "10.221.1.1"
"""The address of the near host."""

_CLONE_NEWNET: Final = 0x40000000


def missing() -> str | None:
    """Return the reason why there can be no networks here, or None."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        return "network namespaces need root and the program ip (Debian: iproute2)"
    name = f"glue-try-{os.getpid()}"
    if subprocess.run(["ip", "netns", "add", name], capture_output=True).returncode != 0:
        return "this machine does not allow network namespaces"
    _run(f"ip netns delete {name}")
    return None


class Networks:
    """A near host, a far host, and a router between them."""

    def __init__(self) -> None:
        self._near, self._router, self.far = (
            f"glue-{role}-{os.getpid()}" for role in ("near", "router", "far")
        )

    def __enter__(self) -> Networks:
        with ExitStack() as ending:
            for name in (self._near, self._router, self.far):
                _run(f"ip netns add {name}")
                ending.callback(_run, f"ip netns delete {name}")
                _run(f"ip -n {name} link set lo up")
            for number, host in ((1, self._near), (2, self.far)):
                inside = f"10.221.{number}"
                _run(f"ip -n {host} link add eth0 type veth peer eth{number} netns {self._router}")
                _run(f"ip -n {host} address add {inside}.1/24 dev eth0")
                _run(f"ip -n {self._router} address add {inside}.2/24 dev eth{number}")
                _run(f"ip -n {host} link set eth0 up")
                _run(f"ip -n {self._router} link set eth{number} up")
                _run(f"ip -n {host} route add default via {inside}.2")
            self.swallow(False)
            self._ending = ending.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()

    def swallow(self, everything: bool) -> None:
        """Let the router silently drop all packets that it should forward, or forward them again."""
        setting = f"net.ipv4.ip_forward={0 if everything else 1}"
        _run(f"ip netns exec {self._router} sysctl --quiet --write {setting}")

    @contextmanager
    def near(self) -> Iterator[None]:
        """Let this thread make its sockets on the near host."""
        with open("/proc/thread-self/ns/net") as before:
            try:
                with open(f"/run/netns/{self._near}") as host:
                    _enter(host.fileno())
                yield
            finally:
                _enter(before.fileno())


def _enter(namespace: int) -> None:
    if ctypes.CDLL(None, use_errno=True).setns(namespace, _CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _run(command: str) -> None:
    subprocess.run(command.split(), check=True, capture_output=True)

"""Tries every network and every file that it can find, and prints what it got."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

_HOSTS = (
    "127.0.0.1",
    "10.0.2.2",
    "10.0.2.3",
    "172.17.0.1",
    "192.168.0.1",
    "192.0.2.1",
    "169.254.169.254",
    "1.1.1.1",
)
_PORTS = (22, 53, 80, 443, 2375, 4096, 4097)
_SKIPPED = ("/proc", "/sys", "/usr", "/opt", "/lib", "/bin", "/sbin", "/etc/ssl", "/var/lib/dpkg")
"""Trees of the image and of the kernel, which hold nothing of the organiser's; a part of /proc is read."""


def reached() -> Iterator[str]:
    """Yield what could be reached over any network."""
    for name in os.listdir("/sys/class/net"):
        if name != "lo":
            yield f"interface {name}"
    for host in _HOSTS:
        for port in _PORTS:
            with socket.socket() as tcp:
                tcp.settimeout(0.2)
                if tcp.connect_ex((host, port)) == 0:
                    yield f"tcp {host}:{port}"
        with socket.socket(type=socket.SOCK_DGRAM) as udp, suppress(OSError):
            udp.sendto(b"x", (host, 53))
            if not host.startswith("127."):
                yield f"udp {host}"
    for kind in ("AF_PACKET", "AF_NETLINK"):
        with suppress(OSError), socket.socket(getattr(socket, kind), socket.SOCK_RAW):
            if kind == "AF_PACKET":
                yield f"a socket of {kind}"
    for name in Path("/proc/net/unix").read_text().split():
        if name.startswith("@"):
            yield f"abstract socket {name}"
    with suppress(OSError):
        yield f"example.org is {socket.gethostbyname('example.org')}"


def files() -> Iterator[Path]:
    """Yield every file that can be listed, outside of what the image and the kernel bring."""
    for folder, folders, names in os.walk("/"):
        folders[:] = [name for name in folders if os.path.join(folder, name) not in _SKIPPED]
        yield from (Path(folder, name) for name in names)
    for process in Path("/proc").glob("[0-9]*"):
        yield from (process / name for name in ("environ", "cmdline", "mountinfo", "root/etc/hostname"))


def found() -> Iterator[str]:
    """Yield sockets, devices that can be opened, and the beginnings of files."""
    for path in files():
        with suppress(OSError):
            if path.is_socket():
                yield f"socket {path}"
            elif path.is_block_device():
                with path.open("rb"):
                    yield f"device {path}"
            elif path.is_file():
                yield f"file {path}: {path.read_bytes()[:1000]!r}"


def gained() -> Iterator[str]:
    """Yield privileges that could be gained."""
    attempts: dict[str, Callable[[], object]] = {
        "root": lambda: os.setuid(0),
        "a namespace": lambda: os.chroot("/proc/1/root"),
        "a device": lambda: os.mknod("/tmp/disk", 0o60600, os.makedev(254, 0)),
        "another priority": lambda: os.nice(-5),
        "the host's name": lambda: socket.sethostname("mine"),
    }
    for what, attempt in attempts.items():
        with suppress(OSError):
            attempt()
            yield what


if __name__ == "__main__":
    for kind, results in (("reached", reached()), ("gained", gained()), ("found", found())):
        for result in results:
            print(f"{kind} {result}")
    print("looked everywhere")
    sys.exit(6)

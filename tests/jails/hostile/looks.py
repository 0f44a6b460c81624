"""Tries every network and every file that it can find, and prints its finds."""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

_HOSTS = (
    *("127.0.0.1", "10.0.2.2", "10.0.2.3", "172.17.0.1", "192.168.0.1", "192.0.2.1"),
    *("169.254.169.254", "1.1.1.1"),
)
_PORTS = (22, 53, 80, 443, 2375, 4096, 4097)
_FAMILIES = 64
"""Linux has 46 address families, from AF_UNSPEC to AF_MCTP."""

_IO_URING_SETUP = 425

_LOAD = (
    *("loadavg", "stat", "meminfo", "vmstat", "uptime", "schedstat", "pressure/cpu", "interrupts"),
    *("sys/fs/file-nr", "sys/fs/inode-nr", "sys/fs/dentry-state", "sys/fs/aio-nr"),
)
"""Files of /proc that show how busy the whole machine is."""

_LOAD_OF_PARTS = (
    *("devices/system/node/node*/*", "devices/system/cpu/cpu*/*/*", "devices/system/cpu/cpu*/cpuidle/*/*"),
    *("block/*/stat", "class/thermal/*/temp", "fs/ext4/*/*", "kernel/mm/*/*"),
)
"""Files of /sys that show the same of memory, processors and disks."""

_SKIPPED = ("/proc", "/sys", "/usr", "/opt", "/lib", "/bin", "/sbin", "/etc/ssl", "/var/lib/dpkg")
"""Directories of the image and the kernel, with nothing of the organiser's; part of /proc is read."""


def reached() -> Iterator[str]:
    """Yield everything that could be reached over any network."""
    for _, name in socket.if_nameindex():
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
    for family in set(range(_FAMILIES)) - {socket.AF_UNIX, socket.AF_INET, socket.AF_INET6}:
        for kind in range(1, 11):
            # Protocol 0 of AF_NETLINK lists network interfaces, of which there is only one.
            for protocol in range(family == socket.AF_NETLINK, 30):
                with suppress(OSError), socket.socket(family, kind, protocol):
                    yield f"a socket of family {family}, type {kind}, protocol {protocol}"
    if (number := io_uring()) >= 0:
        yield f"a ring of system calls, {number}"
    if platform.machine() == "x86_64" and (number := socket_of_32_bits()) >= 0:
        yield f"a socket of AF_VSOCK by a system call of 32 bits, {number}"
    for name in Path("/proc/net/unix").read_text().split():
        if name.startswith("@"):
            yield f"abstract socket {name}"
    with suppress(OSError):
        yield f"example.org is {socket.gethostbyname('example.org')}"


def io_uring() -> int:
    """Return the descriptor of an io_uring, which can make sockets that no filter sees; -1 if refused."""
    return int(ctypes.CDLL(None).syscall(_IO_URING_SETUP, 1, ctypes.create_string_buffer(120)))


def socket_of_32_bits() -> int:
    """Return 0 if the system calls of a 32-bit program make a socket of AF_VSOCK; -1 if they are refused."""
    code = bytes.fromhex("53 b867010000 bb28000000 b901000000 31d2 cd80 5b c3")
    memory = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    memory.write(code)
    call = ctypes.CFUNCTYPE(ctypes.c_int)(ctypes.addressof(ctypes.c_char.from_buffer(memory)))
    child = os.fork()  # a filter may kill the child
    if not child:
        os._exit(0 if call() >= 0 else 1)
    return -1 if os.waitpid(child, 0)[1] else 0


def files() -> Iterator[Path]:
    """Yield every file that can be listed, except those of the image and the kernel."""
    for folder, folders, names in os.walk("/"):
        folders[:] = [name for name in folders if os.path.join(folder, name) not in _SKIPPED]
        yield from (Path(folder, name) for name in names)
    for process in Path("/proc").glob("[0-9]*"):
        yield from (process / name for name in ("environ", "cmdline", "mountinfo", "root/etc/hostname"))


def found() -> Iterator[str]:
    """Yield the machine's load, sockets, devices that can be opened, and the beginnings of files."""
    parts = (path for pattern in _LOAD_OF_PARTS for path in Path("/sys").glob(pattern))
    for path in (*(Path("/proc", name) for name in _LOAD), *parts):
        with suppress(OSError):
            if text := path.read_text():
                yield f"load {path}: {text[:80]!r}"
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

"""How a hub and its peers are set up: frozen values, built by the command line or by a program.

A hub can say which seats are open at which of its addresses. A program that starts some players itself keeps
their roles for itself in this way, whatever a peer from outside says that it is:

    inside = Bind(f"ipc://{folder}/hub", roles=frozenset({Role.EXPERIMENT, Role.ENVIRONMENT}))
    outside = Bind("tcp://127.0.0.1:4097", roles=frozenset({Role.AGENT}))
    Hub(HubConfig(bind=(inside, outside)))

A socket that is bound to one role and one session can be nothing else:

    Bind("ipc:///run/match-17/agent", frozenset({Role.AGENT}), frozenset({"match-17"}))
"""

from __future__ import annotations

import ipaddress
import os
import re
from dataclasses import dataclass, field
from typing import Final

from glue.errors import ConfigError
from glue.protocol.limits import MAX_BODY, MAX_NAME
from glue.protocol.messages import Role

__all__ = ["DEFAULT_HUB", "DEFAULT_SESSION", "Bind", "HubConfig", "LegacyPort", "check_session", "check_url"]

DEFAULT_HUB: Final = "tcp://127.0.0.1:4097"
"""Where a hub listens and its peers look for it. RL-Glue's own port, 4096, is left to its programs."""

DEFAULT_SESSION: Final = "default"

_IPC_PATH_LIMIT: Final = 107
"""Bytes in the path of a Unix socket; Linux, sockaddr_un."""

_BODIES: Final = 4
"""Of the largest, that a session alone may have to keep: task spec, action, call and reply."""

_LONGEST_PATIENCE: Final = 7 * 86400.0
"""Seconds; libzmq counts milliseconds in 31 bits."""

_TCP: Final = re.compile(r"tcp://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\[\]]+):(?P<port>\d{1,9}|\*)")
_LEGACY: Final = re.compile(
    r"((?P<host>\[[0-9a-fA-F:]+\]|[^:/=\[\]]+):)?(?P<port>\d{1,9}|\*)(=(?P<session>.*))?"
)


@dataclass(frozen=True, slots=True)
class Bind:
    """An address of a hub, and which seats a peer can take that connects there.

    Args:
        url: where to listen: `tcp://host:port` or `ipc://path`; `tcp://host:*` takes any free port.
        roles: the roles that are open there; all by default.
        sessions: the sessions that are open there; None for every one.

    Raises:
        ConfigError: the URL is malformed, or nothing is open there.
    """

    url: str
    roles: frozenset[Role] = frozenset(Role)
    sessions: frozenset[str] | None = None

    def __post_init__(self) -> None:
        check_url(self.url)
        if not self.roles or (self.sessions is not None and not self.sessions):
            raise ConfigError(f"nobody could join at {self.url}: name at least one role and one session")

    def admits(self, role: Role, session: str) -> bool:
        """Return whether `role` of `session` can be taken from here."""
        return role in self.roles and (self.sessions is None or session in self.sessions)


def _quarter_of_memory() -> int:
    return max(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4, _BODIES * MAX_BODY)


@dataclass(frozen=True, slots=True)
class HubConfig:
    """Settings of a hub.

    Args:
        bind: where to listen; a URL alone is open to every role of every session.
        heartbeat: seconds between signs of life, and so the time in which a cut connection is noticed.
        patience: seconds that a peer may be unreachable before it is given up and its episode is void.
        max_body: greatest observation, action or text, in bytes.
        max_sessions: sessions at once; a peer that would open one more is refused.
        max_memory: bytes that are kept in all: bodies under way, messages that are not complete, and what
            peers have not read. Beyond it the session or connection that keeps most is ended. By default a
            quarter of the machine's memory.
        insecure: allow addresses that other machines can reach. Peers are not authenticated.

    Raises:
        ConfigError: an address is malformed, or open to others without `insecure`; a time or a limit is
            out of range.
    """

    bind: tuple[str | Bind, ...] = (DEFAULT_HUB,)
    heartbeat: float = 1.0
    patience: float = 5.0
    max_body: int = MAX_BODY
    max_sessions: int = 1024
    max_memory: int = field(default_factory=_quarter_of_memory)
    insecure: bool = False

    def __post_init__(self) -> None:
        for bind in self.binds:
            if not self.insecure and not _is_local(bind.url):
                raise ConfigError(
                    f"{bind.url} can be reached from other machines, and peers are not authenticated: "
                    f"bind tcp://127.0.0.1:PORT, or say --insecure if the network is your own"
                )
        if not 0 < self.heartbeat <= self.patience <= _LONGEST_PATIENCE:
            raise ConfigError(
                f"the heartbeat must be positive and at most the patience, which is a week or less; "
                f"they are {self.heartbeat:g} s and {self.patience:g} s"
            )
        if not 1 <= self.max_body <= MAX_BODY:
            raise ConfigError(f"the greatest body is from 1 to {MAX_BODY} bytes, not {self.max_body}")
        if self.max_memory < _BODIES * self.max_body:
            raise ConfigError(
                f"a hub needs room for {_BODIES} of the largest bodies, that is "
                f"{_BODIES * self.max_body} bytes, not {self.max_memory}"
            )
        if self.max_sessions < 1:
            raise ConfigError(f"a hub serves at least one session, not {self.max_sessions}")

    @property
    def binds(self) -> tuple[Bind, ...]:
        """Where to listen, each with what is open there."""
        return tuple(Bind(bind) if isinstance(bind, str) else bind for bind in self.bind)

    @property
    def max_seats(self) -> int:
        """Sessions that one connection may take part in: a quarter of all, so that others find room."""
        return max(1, self.max_sessions // 4)


@dataclass(frozen=True, slots=True)
class LegacyPort:
    """Where original RL-Glue programs join, and the session they join there.

    Args:
        port: 1 to 65535; 0 takes any free one.
        session: the session's name.
        host: address to listen on.
        roles: the roles that are open there; all by default.
    """

    port: int
    session: str = DEFAULT_SESSION
    host: str = "127.0.0.1"
    roles: frozenset[Role] = frozenset(Role)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}, session {self.session!r}"

    @classmethod
    def parse(cls, text: str, session: str = DEFAULT_SESSION, insecure: bool = False) -> LegacyPort:
        """Return what `[HOST:]PORT[=SESSION]` says; PORT may be `*`, and SESSION is `session` by default.

        Raises:
            ConfigError: `text` is malformed, or open to other machines without `insecure`.
        """
        match = _LEGACY.fullmatch(text)
        if match is None:
            raise ConfigError(f"{text!r} is no port for RL-Glue programs: write [HOST:]PORT[=SESSION]")
        host = match["host"] or "127.0.0.1"
        url = check_url(f"tcp://{host}:{match['port']}")
        if not insecure and not _is_local(url):
            raise ConfigError(
                f"{host} can be reached from other machines, and RL-Glue programs are not authenticated: "
                f"leave the host out, or say --insecure if the network is your own"
            )
        named = match["session"]
        port = 0 if match["port"] == "*" else int(match["port"])
        return cls(port, session if named is None else check_session(named), host.strip("[]"))


def check_url(url: str) -> str:
    """Return `url` if it is an address of a hub.

    Raises:
        ConfigError: it is neither `tcp://host:port` nor `ipc://path`.
    """
    scheme, separator, rest = url.partition("://")
    if not url.isprintable():
        raise ConfigError(f"{url!r:.120} is no address of a hub: it has unprintable characters")
    if separator and scheme == "ipc" and rest:
        if len(rest.encode()) > _IPC_PATH_LIMIT:
            raise ConfigError(
                f"the path of {url} has {len(rest.encode())} bytes; a socket's may have {_IPC_PATH_LIMIT}"
            )
        return url
    match = _TCP.fullmatch(url)
    if match is None:
        raise ConfigError(f"{url!r} is no address of a hub: write tcp://host:port or ipc://path")
    port = match["port"]
    if port != "*" and not 1 <= int(port) <= 65535:
        raise ConfigError(f"the port of {url} is {port}; ports are from 1 to 65535")
    return url


def check_session(name: str) -> str:
    """Return `name` if it can name a session.

    Raises:
        ConfigError: it is empty, too long, or has unprintable characters.
    """
    if not 1 <= len(name) <= MAX_NAME or not name.isprintable():
        raise ConfigError(f"a session has a name of 1 to {MAX_NAME} printable characters, not {name!r:.60}")
    return name


def _is_local(url: str) -> bool:
    match = _TCP.fullmatch(url)
    if match is None:
        return True
    host = match["host"].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False

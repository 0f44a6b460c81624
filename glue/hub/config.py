"""Settings of a hub and its peers: frozen values, made by the command line or by a program.

Each address of a hub can be limited to some roles and sessions. A program that starts some of the players
itself reserves their roles in this way, regardless of the role that a peer from outside claims:

    inside = Bind(f"ipc://{folder}/hub", roles=frozenset({Role.EXPERIMENT, Role.ENVIRONMENT}))
    outside = Bind("tcp://127.0.0.1:4097", roles=frozenset({Role.AGENT}))
    Hub(HubConfig(bind=(inside, outside)))

An address for one role of one session:

    Bind("ipc:///run/match-17/agent", frozenset({Role.AGENT}), frozenset({"match-17"}))

An address that requires a known key, which decides the role and the sessions of its owner:

    Bind("tcp://0.0.0.0:4097", keys=Keys(secret, {public: Permit("carol", frozenset({Role.AGENT}))}))

The time of agents can be limited, see `glue.hub.timing`:

    HubConfig(time=TimeLimits(step_seconds=0.5, bank_seconds=30))
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from glue.errors import ConfigError
from glue.pace import Pace
from glue.wire.messages import MAX_BODY, MAX_NAME, Role

DEFAULT_HUB: Final = "tcp://127.0.0.1:4097"
"""The default address of a hub. RL-Glue's own port, 4096, is left to original RL-Glue programs."""

DEFAULT_SESSION: Final = "default"

HUB_VARIABLE: Final = "GLUE_HUB"
"""Environment variable of the option `--hub`, in every command and client that has it; others likewise."""

SESSION_VARIABLE: Final = "GLUE_SESSION"
KEY_VARIABLE: Final = "GLUE_KEY"
HUB_KEY_VARIABLE: Final = "GLUE_HUB_KEY"

_IPC_PATH_LIMIT: Final = 107
"""Maximum number of bytes in the path of a Unix socket; Linux, sockaddr_un."""

_BODIES: Final = 4
"""Number of bodies that a single session may have to keep: task spec, action, call and reply."""

_MAX_TIMEOUT: Final = 7 * 86400.0
"""Maximum timeout in seconds; libzmq counts milliseconds in 31 bits."""

KEY_SIZE: Final = 32
"""Size of a CURVE key, public or secret, in bytes."""

_TCP: Final = re.compile(r"tcp://(?P<host>\[[0-9a-fA-F:]+\]|[^:/\[\]]+):(?P<port>\d{1,9}|\*)")
_LEGACY: Final = re.compile(
    r"((?P<host>\[[0-9a-fA-F:]+\]|[^:/=\[\]]+):)?(?P<port>\d{1,9}|\*)(=(?P<session>.*))?"
)


@dataclass(frozen=True, slots=True)
class Permit:
    """The roles and sessions permitted to the owner of a key.

    Args:
        name: the name that the owner of the hub gives to the owner of the key.
        roles: the roles that the owner may take.
        sessions: the sessions in which the owner may take them; None for all.
    """

    name: str
    roles: frozenset[Role]
    sessions: frozenset[str] | None = None

    def admits(self, role: Role, session: str) -> bool:
        """Return whether the owner of the key may join `session` as `role`."""
        return role in self.roles and (self.sessions is None or session in self.sessions)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one hub.

    Args:
        secret: the hub's own secret key.
        permits: roles and sessions by public key; any other key may join nothing.

    Raises:
        ConfigError: a key does not have 32 bytes.
    """

    secret: bytes = field(repr=False)
    permits: Mapping[bytes, Permit]

    def __post_init__(self) -> None:
        for key in (self.secret, *self.permits):
            if len(key) != KEY_SIZE:
                raise ConfigError(f"a key has {KEY_SIZE} bytes, not {len(key)}")

    def __str__(self) -> str:
        number = len(self.permits)
        return f"{number} key{'s' * (number != 1)} may join"


@dataclass(frozen=True, slots=True)
class Bind:
    """An address of a hub, and the roles and sessions that peers can join there.

    Args:
        url: address to listen on: `tcp://host:port` or `ipc://path`; `tcp://host:*` takes any free port.
        roles: the roles that are open there; all by default.
        sessions: the sessions that are open there; None for all.
        keys: permits by public key, for CURVE; None admits everybody, unencrypted. A key opens only the
            roles and sessions that both its permit and this address open.

    Raises:
        ConfigError: the URL is malformed, or no role or no session is open there.
    """

    url: str
    roles: frozenset[Role] = frozenset(Role)
    sessions: frozenset[str] | None = None
    keys: Keys | None = None

    def __post_init__(self) -> None:
        check_url(self.url)
        if not self.roles or (self.sessions is not None and not self.sessions):
            raise ConfigError(f"no peer could join at {self.url}: name at least one role and one session")

    @property
    def warning(self) -> str:
        """Those who can join uninvited; empty if keys or a file mode prevent it."""
        if self.keys is not None or (self.url.startswith("ipc://") and self.url[6] != "@"):
            return ""
        return "every user of this machine" if is_local(self.url) else "everyone who reaches this machine"

    def announcement(self, endpoint: str) -> str:
        """Return a line that says where the hub listens, and who else can join there."""
        who = self.warning
        return f"listening on {endpoint}" + (
            f" (open to {who}, unless keys say who may join: glue-keys)" if who else ""
        )

    def admits(self, role: Role, session: str) -> bool:
        """Return whether a peer that connects here can join `session` as `role`."""
        return role in self.roles and (self.sessions is None or session in self.sessions)


@dataclass(frozen=True, slots=True)
class TimeLimits:
    """The time that an agent has in a session.

    An answer that takes longer than `step_seconds` drains the excess from a bank of `bank_seconds`. An agent
    whose time is over is dismissed. See `glue.hub.timing`.

    Args:
        step_seconds: seconds per answer that do not drain the bank.
        bank_seconds: seconds in all for the excess of answers.
        start_seconds: seconds to initialise, for `agent_seed` and `agent_init`.
        total_seconds: seconds for all answers together.

    Raises:
        ConfigError: a time is negative, or not a number of seconds up to a week.
    """

    step_seconds: float = 1.0
    bank_seconds: float = 60.0
    start_seconds: float = 30.0
    total_seconds: float = 600.0

    def __post_init__(self) -> None:
        _check_seconds(self, "step_seconds", "bank_seconds", "start_seconds", "total_seconds")


def _check_seconds(settings: object, *names: str) -> None:
    for name in names:
        seconds = getattr(settings, name)
        if not 0 <= seconds <= _MAX_TIMEOUT:
            raise ConfigError(f"{name} must be from 0 to {_MAX_TIMEOUT:g} seconds, not {seconds}")


def _quarter_of_memory() -> int:
    return max(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4, _BODIES * MAX_BODY)


@dataclass(frozen=True, slots=True)
class HubConfig:
    """Settings of a hub.

    Args:
        bind: addresses to listen on; a plain URL is open to every role of every session.
        heartbeat: seconds between heartbeats, and so the time within which a cut connection is noticed.
        timeout: seconds that a peer may be unreachable before it is given up and its episode is void.
        max_body: maximum size of an observation, action or text, in bytes.
        max_sessions: maximum number of sessions at once; a peer that would open one more is refused.
        max_memory: maximum number of bytes kept in all: bodies in transit, incomplete messages, and data
            that peers have not read. When it is exceeded, the session or connection that uses most is ended.
            By default a quarter of the machine's memory.
        insecure: allow addresses without keys that other machines can reach. Peers are not authenticated.
        time: limits of the agent in every session; None for none.
        pace: of the environment in every session; by default, it waits for the agent.
        greeting: seconds that a connection may take part in no session; then it is dropped, at the
            next heartbeat.
        farewell: maximum number of seconds that the hub waits, when it ends, for its last messages to be read
            and for its last log lines to be written.

    Raises:
        ConfigError: an address is malformed, or reachable by others without `insecure`; a time or a limit is
            out of range.
    """

    bind: tuple[str | Bind, ...] = (DEFAULT_HUB,)
    heartbeat: float = 1.0
    timeout: float = 5.0
    max_body: int = MAX_BODY
    max_sessions: int = 1024
    max_memory: int = field(default_factory=_quarter_of_memory)
    insecure: bool = False
    time: TimeLimits | None = None
    pace: Pace = field(default_factory=Pace)
    greeting: float = 1.0
    farewell: float = 1.0

    def __post_init__(self) -> None:
        for bind in self.binds:
            if not self.insecure and bind.keys is None and not is_local(bind.url):
                raise ConfigError(
                    f"{bind.url} can be reached from other machines, and peers are not authenticated: "
                    "require keys (see glue-keys), bind tcp://127.0.0.1:PORT, or set insecure if the network "
                    "is your own",
                    settings=("keys", "bind", "insecure"),
                )
        if not 0 < self.heartbeat <= self.timeout <= _MAX_TIMEOUT:
            raise ConfigError(
                f"the heartbeat must be positive and at most the timeout, and the timeout a week or less; "
                f"they are {self.heartbeat:g} s and {self.timeout:g} s"
            )
        _check_seconds(self, "greeting", "farewell")
        if not 1 <= self.max_body <= MAX_BODY:
            raise ConfigError(f"max_body must be from 1 to {MAX_BODY} bytes, not {self.max_body}")
        if self.max_memory < _BODIES * self.max_body:
            raise ConfigError(
                f"max_memory must hold {_BODIES} bodies of the maximum size, that is "
                f"{_BODIES * self.max_body} bytes, not {self.max_memory}"
            )
        if self.max_sessions < 1:
            raise ConfigError(f"max_sessions must be at least 1, not {self.max_sessions}")

    @property
    def binds(self) -> tuple[Bind, ...]:
        """The addresses to listen on, each with the roles and sessions that are open there."""
        return tuple(Bind(bind) if isinstance(bind, str) else bind for bind in self.bind)

    @property
    def max_joined(self) -> int:
        """Maximum number of sessions per connection: a quarter of all, so that room is left for others."""
        return max(1, self.max_sessions // 4)


@dataclass(frozen=True, slots=True)
class LegacyPort:
    """A port for original RL-Glue programs, and the session that they join there.

    Args:
        port: 1 to 65535; 0 for any free port.
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
        """Parse `[HOST:]PORT[=SESSION]`; PORT may be `*`, and SESSION is `session` by default.

        Raises:
            ConfigError: `text` is malformed, or reachable from other machines without `insecure`.
        """
        match = _LEGACY.fullmatch(text)
        if match is None:
            raise ConfigError(
                f"{text!r:.120} is not a port for RL-Glue programs: write [HOST:]PORT[=SESSION]"
            )
        host = match["host"] or "127.0.0.1"
        url = check_url(f"tcp://{host}:{match['port']}")
        if not insecure and not is_local(url):
            raise ConfigError(
                f"{host} can be reached from other machines, and RL-Glue programs are not authenticated: "
                "leave the host out, or set insecure if the network is your own",
                settings=("legacy_port", "insecure"),
            )
        named = match["session"]
        port = 0 if match["port"] == "*" else int(match["port"])
        return cls(port, session if named is None else check_session(named), host.strip("[]"))


def check_url(url: str) -> str:
    """Return `url` if it can be the address of a hub.

    Raises:
        ConfigError: it is neither `tcp://host:port` nor `ipc://path`.
    """
    scheme, separator, rest = url.partition("://")
    if not url.isprintable():
        raise ConfigError(f"{url!r:.120} is not the address of a hub: it has unprintable characters")
    if separator and scheme == "ipc" and rest:
        if len(rest.encode()) > _IPC_PATH_LIMIT:
            raise ConfigError(
                f"the path of {url:.80} has {len(rest.encode())} bytes; at most {_IPC_PATH_LIMIT} are allowed"
            )
        return url
    match = _TCP.fullmatch(url)
    if match is None:
        raise ConfigError(f"{url!r:.120} is not the address of a hub: write tcp://host:port or ipc://path")
    port = match["port"]
    if port != "*" and not 1 <= int(port) <= 65535:
        raise ConfigError(f"the port of {url:.120} must be from 1 to 65535, not {port}")
    return url


def check_session(name: str) -> str:
    """Return `name` if it can be the name of a session.

    Raises:
        ConfigError: it is empty, too long, or has unprintable characters.
    """
    if not 1 <= len(name) <= MAX_NAME or not name.isprintable():
        raise ConfigError(
            f"the name of a session must have 1 to {MAX_NAME} printable characters, not {name!r:.60}"
        )
    return name


def is_local(url: str) -> bool:
    """Return whether only this machine can reach an address."""
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

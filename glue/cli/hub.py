"""`glue-hub`: a stand-alone hub, to which experiments connect."""

from __future__ import annotations

import ctypes
import resource
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import click

from glue import __version__
from glue.cli.entry import Terminated
from glue.cli.shared import keys_option, legacy_port_option, pace_options
from glue.console import say
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, Bind, HubConfig, LegacyPort
from glue.hub.io.log import Log, LogLevel
from glue.pace import REPEAT, Pace

_DEFAULTS: Final = HubConfig()

_MMAP_THRESHOLD: Final = -3
"""M_MMAP_THRESHOLD of mallopt(3)."""

_LARGE_BLOCK: Final = 2**20
"""Size in bytes from which a block of memory is returned to the system as soon as it is free."""


@click.command("glue-hub")
@click.option(
    "--bind",
    multiple=True,
    default=(DEFAULT_HUB,),
    show_default=True,
    metavar="URL",
    help="Address to listen on: tcp://host:port or ipc://path. Repeat it for several.",
)
@click.option(
    "--heartbeat",
    type=float,
    default=_DEFAULTS.heartbeat,
    show_default=True,
    help="Seconds between heartbeats.",
)
@click.option(
    "--timeout",
    type=float,
    default=_DEFAULTS.timeout,
    show_default=True,
    help="Seconds that a peer may be unreachable before it is given up and its episode is void.",
)
@click.option(
    "--max-sessions",
    type=click.IntRange(1),
    default=_DEFAULTS.max_sessions,
    show_default=True,
    help="Maximum number of sessions at once.",
)
@click.option(
    "--max-memory",
    type=click.IntRange(64),
    default=_DEFAULTS.max_memory // 2**20,
    show_default="a quarter of the machine's",
    metavar="MIB",
    help="Maximum memory for observations, actions and other messages, in all. When it is exceeded, the "
    "session or connection that uses most is ended.",
)
@pace_options
@legacy_port_option
@keys_option
@click.option(
    "--insecure", is_flag=True, help="Allow addresses without --keys that other machines can reach."
)
@click.option("--quiet", is_flag=True, help="Log only the addresses and the hub's own errors.")
@click.option("--verbose", is_flag=True, help="Log every connection, not only the peers of sessions.")
@click.version_option(__version__, prog_name="glue-hub")
def hub(
    bind: tuple[str, ...],
    heartbeat: float,
    timeout: float,
    max_sessions: int,
    max_memory: int,
    rate: float | None,
    late: str | None,
    delay: int | None,
    legacy_port: tuple[str, ...],
    keys: Path | None,
    insecure: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Run a hub alone, until Ctrl-C.

    Environments, agents and experiments connect to it; a session is one of each, paired by name.
    glue-experiment starts its own hub, and needs this one only with --hub.

    \b
    Examples:
      glue-hub
      glue-hub --bind tcp://127.0.0.1:5000
      glue-experiment --hub tcp://127.0.0.1:5000 --session a --episodes 100
      glue-hub --legacy-port 4096 --legacy-port 5096=b
      glue-hub --bind tcp://*:4097 --keys keys
    """
    from glue.keys.allowed import read_keys

    known = None if keys is None else read_keys(keys)
    config = HubConfig(
        bind=tuple(Bind(url, keys=known) for url in bind),
        heartbeat=heartbeat,
        timeout=timeout,
        max_sessions=max_sessions,
        max_memory=max_memory * 2**20,
        insecure=insecure,
        pace=Pace(rate or 0.0, late or REPEAT, delay or 0),
    )
    ports = [LegacyPort.parse(text, insecure=insecure) for text in legacy_port]
    if quiet and verbose:
        raise ConfigError("--quiet and --verbose contradict each other: give one of them")
    level = LogLevel.ERROR if quiet else LogLevel.CONNECTIONS if verbose else LogLevel.PEERS
    serve_until_interrupted(config, ports, level, keys)


def serve_until_interrupted(
    config: HubConfig,
    ports: Sequence[LegacyPort] = (),
    level: LogLevel = LogLevel.PEERS,
    keys: Path | None = None,
) -> None:
    """Serve until Ctrl-C or SIGTERM, of which every peer is notified; read `keys` again on SIGHUP."""
    from glue.hub.io.server import Hub, renewed_on_hangup
    from glue.keys.allowed import HUB
    from glue.keys.certificates import PUBLIC
    from glue.legacy.gateway import Gateway

    _allow_many_connections()
    # Large free blocks go back to the system: glibc would learn to keep them, and `--max-memory` is a bound.
    with suppress(OSError, AttributeError):  # another C library has no mallopt
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE_BLOCK)
    log = Log(say, level, stamped=True)
    with ExitStack() as stack:
        running = stack.enter_context(Hub(config, log))
        if keys is not None:
            stack.enter_context(renewed_on_hangup(running, keys))
        gateway = Gateway(running, ports, log)
        for bind, endpoint in zip(config.binds, running.endpoints, strict=True):
            say(bind.announcement(endpoint))
        if keys is not None:
            say(f"{config.binds[0].keys}; the hub's public key, for --hub-key, is in {keys / HUB}{PUBLIC}")
        for port in gateway.ports:
            say(f"listening for original RL-Glue programs on {port}")
        try:
            stack.enter_context(running.in_background())
            running.wait()
        except KeyboardInterrupt as interrupt:
            name = "SIGTERM" if isinstance(interrupt, Terminated) else "SIGINT"
            log(f"stopped by {name}")
            running.stop(f"the hub was stopped by {name}")
            raise


def _allow_many_connections() -> None:
    """Raise the limit of file descriptors to its maximum: a tournament needs one for each peer."""
    _, maximum = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(ValueError, OSError):  # macOS reports an infinite maximum, and refuses it
        resource.setrlimit(resource.RLIMIT_NOFILE, (maximum, maximum))

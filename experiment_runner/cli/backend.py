"""The options for where trials run, and the check of their combinations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from experiment_runner.executors.settings import Backend, RunConfig
from glue.errors import ConfigError

_Command = TypeVar("_Command", bound=Callable[..., Any])

_WHERE = {
    Backend.LOCAL: "on this machine",
    Backend.RAY: "on a Ray cluster",
    Backend.SLURM: "as a job array of SLURM",
}

_WORKERS = click.option(
    "--workers",
    type=click.IntRange(1),
    metavar="N",
    help="Trials at a time, each in its own process.",
)
_ADDRESS = click.option(
    "--address",
    metavar="HOST:PORT",
    help="Ray cluster. [default: the one that Ray finds, or else one on this machine]",
)


def backend_options(*backends: Backend) -> Callable[[_Command], _Command]:
    """Return a decorator that adds the options `--workers`, `--engine` and `--address` to a command.

    Args:
        backends: the values of `--engine`.
    """
    engine = click.option(
        "--engine",
        type=click.Choice([backend.value for backend in backends]),
        default=Backend.LOCAL.value,
        show_default=True,
        help=f"Where trials run: {', '.join(_WHERE[backend] for backend in backends)}.",
    )

    def add(command: _Command) -> _Command:
        return _WORKERS(engine(_ADDRESS(command)))

    return add


def check_backend(config: RunConfig) -> None:
    """Check the address of a cluster.

    Raises:
        ConfigError: it is malformed, or trials do not run on a cluster.
    """
    from experiment_runner.executors.ray_cluster import parse_address

    if config.address is not None:
        if config.backend is not Backend.RAY:
            raise ConfigError("--address is the address of a Ray cluster: add --engine ray")
        parse_address(config.address)

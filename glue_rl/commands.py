"""Where every command begins; see `glue.cli.entry`."""

from __future__ import annotations

from glue.cli.entry import start


def agent() -> None:
    """Run `glue-agent`."""
    start("agents.cli.agent")


def compete() -> None:
    """Run `glue-compete`."""
    start("experiment_runner.cli.compete")


def compile_players() -> None:
    """Run `glue-compile`."""
    start("glue.cli.compile")


def conform() -> None:
    """Run `glue-conform`."""
    start("glue.cli.conform")


def environment() -> None:
    """Run `glue-env`."""
    start("env_server.cli.environment")


def experiment() -> None:
    """Run `glue-experiment`."""
    start("experiment_runner.cli.experiment")


def generalise() -> None:
    """Run `glue-generalise`."""
    start("experiment_runner.cli.generalise")


def hub() -> None:
    """Run `glue-hub`."""
    start("glue.cli.hub")


def keys() -> None:
    """Run `glue-keys`."""
    start("glue.cli.keys")


def paper() -> None:
    """Run `glue-paper`."""
    start("experiment_runner.cli.paper")


def plot() -> None:
    """Run `glue-plot`."""
    start("experiment_runner.cli.plot")


def replay() -> None:
    """Run `glue-replay`."""
    start("env_server.cli.replay")


def results() -> None:
    """Run `glue-results`."""
    start("experiment_runner.cli.results")


def view() -> None:
    """Run `glue-view`."""
    start("experiment_runner.cli.view")


def watch() -> None:
    """Run `glue-watch`."""
    start("experiment_runner.cli.watch")

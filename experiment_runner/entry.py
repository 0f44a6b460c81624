"""Where the commands of this package begin; see `glue.entry`."""

from __future__ import annotations

from glue.entry import start


def compete() -> None:
    """Run `glue-compete`."""
    start("experiment_runner.competition.command")


def experiment() -> None:
    """Run `glue-experiment`."""
    start("experiment_runner.commands.experiment")


def generalise() -> None:
    """Run `glue-generalise`."""
    start("experiment_runner.generalisation.command")


def paper() -> None:
    """Run `glue-paper`."""
    start("experiment_runner.paper.command")


def plot() -> None:
    """Run `glue-plot`."""
    start("experiment_runner.commands.plot")


def results() -> None:
    """Run `glue-results`."""
    start("experiment_runner.commands.results")


def view() -> None:
    """Run `glue-view`."""
    start("experiment_runner.view.command")


def watch() -> None:
    """Run `glue-watch`."""
    start("experiment_runner.commands.watch")

"""Where the commands of this package begin; see `glue.entry`."""

from __future__ import annotations

from typing import NoReturn

from glue.entry import start


def compete() -> NoReturn:
    """Run `glue-compete`."""
    start("experiment_runner.competition.command")


def experiment() -> NoReturn:
    """Run `glue-experiment`."""
    start("experiment_runner.commands.experiment")


def generalise() -> NoReturn:
    """Run `glue-generalise`."""
    start("experiment_runner.generalisation.command")


def paper() -> NoReturn:
    """Run `glue-paper`."""
    start("experiment_runner.paper.command")


def plot() -> NoReturn:
    """Run `glue-plot`."""
    start("experiment_runner.commands.plot")


def results() -> NoReturn:
    """Run `glue-results`."""
    start("experiment_runner.commands.results")


def view() -> NoReturn:
    """Run `glue-view`."""
    start("experiment_runner.view.command")


def watch() -> NoReturn:
    """Run `glue-watch`."""
    start("experiment_runner.commands.watch")

"""`glue-plot`: plot the results of experiments."""

from __future__ import annotations

import shutil
from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path

import click

from glue import __version__
from glue.commands import run
from glue.console import say

__all__ = ["main", "plot"]


@click.command("glue-plot")
@click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    help="File to write, .png or .svg; without it, the curves are sketched in the terminal.",
)
@click.option(
    "--kind",
    type=click.Choice(["curves", "scatter", "comparison"]),
    default="curves",
    show_default=True,
    help="Learning curves with confidence bands; every episode as a dot, in a panel for each setting; or a "
    "comparison of the agents' final performance.",
)
@click.option(
    "--window",
    type=click.IntRange(1),
    default=100,
    show_default=True,
    help="Episodes in the running mean, or last episodes that count as final performance.",
)
@click.version_option(__version__, prog_name="glue-plot")
def plot(directories: tuple[Path, ...], out: Path | None, kind: str, window: int) -> None:
    """Plot the results of each RUN, a directory that glue-experiment created, also while it runs.

    \b
    Examples:
      glue-plot runs/mine
      glue-plot runs/mine -o curves.png
      glue-plot runs/mine runs/other --kind comparison -o comparison.svg
    """
    from experiment_runner.analysis.settings import collect
    from experiment_runner.analysis.stats import bootstrap_rng
    from experiment_runner.report.plots import comparison, learning_curves, save, scatter
    from experiment_runner.report.sketch import sketches
    from experiment_runner.store.results import Results

    if out is None and kind != "curves":
        raise click.UsageError(f"--kind {kind} needs a file: --out {kind}.png")
    with ExitStack() as stack:
        found = collect([stack.enter_context(Results.open(directory)) for directory in directories])
    settings = [setting for setting in found if setting.curves().size]
    rng = bootstrap_rng()
    if kind == "comparison":
        agents = defaultdict(list)
        for setting in settings:
            agents[setting.agent].append(setting.curves())
        figure = comparison(agents, rng, window=window)
    else:
        curves = {setting.label: setting.curves() for setting in settings}
        if out is None:
            click.echo(sketches(curves, window, shutil.get_terminal_size().columns))
            return
        if kind == "curves":
            figure = learning_curves(curves, rng, window=window)
        else:
            figure = scatter(curves, window=window)
    assert out is not None
    save(figure, out)
    say(f"wrote {out}")


def main() -> None:
    """Run `glue-plot`."""
    run(plot)


if __name__ == "__main__":
    main()

"""`glue-paper`: reproduce the experiments of Mohan (2010)."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path

import click

from experiment_runner.cli.options import naming_out
from experiment_runner.plan.plan import Plan, check_options
from experiment_runner.study.paper.experiments import ALL, EPISODES, EXPERIMENTS, SOAR, TRIALS, plan_of
from glue import __version__
from glue.cli.shared import DIRECTORY
from glue.console import say
from glue.plugins.loading import find
from glue.wire.messages import Role


@click.command("glue-paper")
@click.argument("names", metavar="EXPERIMENT...", nargs=-1, type=click.Choice([*EXPERIMENTS, ALL, SOAR]))
@click.option(
    "--out",
    type=DIRECTORY,
    default="runs/paper",
    show_default=True,
    help="Directory of the results: a run for each experiment, the tables and the figures. Existing runs "
    "are continued.",
)
@click.option(
    "--trials",
    type=click.IntRange(1),
    show_default=f"{TRIALS}; on Soar 5, of experiments 3 and 8 3",
    help="Trials of each agent on each level.",
)
@click.option(
    "--episodes",
    type=click.IntRange(1),
    show_default=f"{EPISODES}; on Soar 1000",
    help="Episodes of a trial.",
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    default=os.cpu_count() or 1,
    show_default="the number of cores",
    help="Number of trials at a time, each in its own process.",
)
@click.option(
    "--report-only", is_flag=True, help="Do not run anything; write tables and figures of the existing runs."
)
@click.option(
    "--docs",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="Also write the tables to this page, between its marks, and the figures to its images/paper.",
)
@click.version_option(__version__, prog_name="glue-paper")
def paper(
    names: tuple[str, ...],
    out: Path,
    trials: int | None,
    episodes: int | None,
    workers: int,
    report_only: bool,
    docs: Path | None,
) -> int:
    """Reproduce experiments of Mohan (2010), "Reinforcement Learning in Infinite Mario".

    An EXPERIMENT is one of the paper's numbers, 1 to 8; sample, the competition's sample agent, which is
    in every figure; best, an agent that is not in the paper; or all of these. soar-3 to soar-8 are the
    same on the Soar kernel, with agents made of productions, and soar is all of those. At the end, tables
    and figures of all experiments in --out are written.

    \b
    Examples:
      glue-paper all
      glue-paper sample 5 7
      glue-paper 7 --trials 2 --episodes 300 --out runs/quick
      glue-paper --report-only
    """
    from experiment_runner.report.tables import terminal_width
    from experiment_runner.study.paper.report import write_report
    from experiment_runner.study.paper.tables import as_text

    if not names and not report_only:
        raise click.UsageError("name the experiments: numbers from 1 to 8, sample, best, all, or soar")
    if names and report_only:
        raise click.UsageError("--report-only reports on all existing runs: omit the experiments")
    chosen = [name for name in EXPERIMENTS if {name, EXPERIMENTS[name].group} & set(names)]
    plans = {
        name: check_options(
            plan_of(EXPERIMENTS[name], episodes, trials), lambda role, kind: find(Role(role), kind)
        )
        for name in chosen
    }
    failed = 0
    for name, plan in plans.items():
        say(f"{name}: {EXPERIMENTS[name].title}")
        failed += _run(out / name, plan, workers)
    report = write_report(out, docs)
    click.echo(as_text(report.outcomes, terminal_width()), nl=False)
    for what in report.written:
        say(f"wrote {what}")
    return 1 if failed else 0


def _run(directory: Path, plan: Plan, workers: int) -> int:
    """Run the remaining trials of a plan; return the number of trials that failed."""
    from experiment_runner.executors.job import BOTH, Placement, RunConfig
    from experiment_runner.executors.opening import open_run
    from experiment_runner.executors.run import run_trials
    from experiment_runner.report.progress import Progress
    from glue.cli.screen import has_color

    config = RunConfig(Placement(BOTH), workers=workers)
    with ExitStack() as stack:
        with naming_out():
            store = stack.enter_context(open_run(directory, plan))
        return run_trials(store, config, Progress(color=has_color(sys.stderr)), again="the same command")

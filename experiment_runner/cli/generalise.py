"""`glue-generalise`: score an agent on levels that it has not seen."""

from __future__ import annotations

import json
import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from experiment_runner.cli.options import backend_options, check_address, naming_out
from experiment_runner.plan.limits import Backend
from glue import __version__
from glue.console import say
from glue.plugins.naming import complete_names
from glue.wire.messages import Role


@click.group("glue-generalise", invoke_without_command=True)
@click.option(
    "--agent",
    "agent_name",
    help="Agent: an installed name, module:Class or path/to/file.py:Class.",
    shell_complete=complete_names(Role.AGENT),
)
@click.option(
    "--agent-option",
    "agent_options",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of the agent; {seed} in it is the seed of the trial. Repeat it for several.",
)
@click.option("--train", default="train-200", show_default=True, help="Set of levels to learn on.")
@click.option("--test", default="test-1000", show_default=True, help="Set of unseen levels.")
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="NAME",
    help="Score this set of levels, or with NAME:N its first N, or the levels in *.txt of a folder, "
    "for each difficulty, in place of --train and --test. Repeat it for several.",
)
@click.option(
    "--learn",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Episodes on training levels before the agent is scored.",
)
@click.option(
    "--relearn",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Episodes on each level before the one that is scored there.",
)
@click.option(
    "--seed",
    "seeds",
    type=click.IntRange(0),
    multiple=True,
    default=(1, 2, 3),
    show_default=True,
    help="Seed of a trial. Repeat it for several.",
)
@click.option(
    "--ask",
    "questions",
    multiple=True,
    metavar="MESSAGE",
    help="Send the agent this message after each episode; with --set the table has the mean of its answers, "
    "if they are numbers. Repeat it for several.",
)
@click.option(
    "--noise",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    help="Probability of each action to be replaced by a random one.",
)
@click.option("--name", help="Name of the agent in the table. [default: --agent]")
@backend_options(Backend.LOCAL, Backend.RAY)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Directory of the run; if it contains this benchmark's run, that run continues. A name that ends in "
    ".json is the file for the score of every level, and the run is in the directory of that name without "
    "the ending. [default: a new directory in runs/]",
)
@click.option(
    "--table",
    "results",
    type=click.Path(path_type=Path, exists=True),
    multiple=True,
    help="Play nothing; print the table of this file or directory, which --out wrote. Repeat it for several.",
)
@click.option(
    "--certificates",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="With --set, also show the share of these levels with a certificate that were solved.",
)
@click.version_option(__version__, prog_name="glue-generalise")
@click.pass_context
def generalise(
    context: click.Context,
    /,
    agent_name: str | None,
    name: str | None,
    workers: int | None,
    engine: str,
    address: str | None,
    out: Path | None,
    results: tuple[Path, ...],
    certificates: Path | None,
    **of_benchmark: Any,
) -> int:
    """Score an agent on training levels and on unseen levels of Infinite Mario.

    The table shows return and goal rate on both sets of levels, and the gap between them; with --set, those
    of each difficulty of a set. An interrupted run is continued by the same command with --out.

    \b
    Examples:
      glue-generalise --agent random
      glue-generalise --agent hierarchical-internal --learn 2000 --out runs/internal --workers 3
      glue-generalise --agent best --set ladder-v1 --seed 1 --workers 2 --out runs/ladder
      glue-generalise --table runs/internal --table random.json
      glue-generalise verify random.json
    """
    if context.invoked_subcommand:
        return 0
    from experiment_runner.cli.make_plan import own_directory
    from experiment_runner.executors.job import BOTH, Placement, RunConfig
    from experiment_runner.executors.run import run_trials
    from experiment_runner.plan.plan import RoleSpec
    from experiment_runner.report.progress import Progress
    from experiment_runner.store.database import reported
    from experiment_runner.study.generalisation.benchmark import (
        Benchmark,
        document,
        open_benchmark,
        read_scores,
    )
    from experiment_runner.study.generalisation.players import LAST_ACTIONS, LAST_REWARD, set_name
    from experiment_runner.study.generalisation.summary import table
    from experiment_runner.study.generalisation.verification import solvable
    from glue.cli.screen import has_color

    certified = solvable(read_scores(certificates)) if certificates else frozenset()
    if results:
        print(table([read_scores(path) for path in results], certified, plain=sys.stdout.isatty()))
        return 0
    if agent_name is None:
        raise click.UsageError("name the agent with --agent, or results with --table")
    of_benchmark |= {each: set_name(of_benchmark[each]) for each in ("train", "test")}
    of_benchmark["sets"] = map(set_name, of_benchmark["sets"])
    distinct = {each: tuple(dict.fromkeys(of_benchmark[each])) for each in ("sets", "seeds", "questions")}
    benchmark = Benchmark(name or agent_name, agent_name, **of_benchmark | distinct)
    config = RunConfig(
        Placement(BOTH),
        backend=Backend(engine),
        workers=workers,
        address=address,
        questions=(LAST_REWARD, LAST_ACTIONS, *benchmark.questions),
    )
    check_address(config.backend, address)
    is_file = out is not None and out.suffix == ".json"
    given = out.with_suffix("") if out is not None and is_file else out
    with ExitStack() as stack:
        directory = stack.enter_context(own_directory(given, f"generalise-{RoleSpec(agent_name).label}"))
        again = "the same command"
        if out is None:
            again += f" with --out {shlex.quote(str(directory))}"
        with naming_out():
            store = stack.enter_context(open_benchmark(directory, benchmark, say))
        failed = run_trials(store, config, Progress(color=has_color(sys.stderr)), again=again)
        if failed:
            say(f"{failed} of {len(store.trials())} trials have failed: {again} plays them again")
            return 1
        scores = document(store, benchmark)
    if out is not None and is_file:
        with reported(f"cannot write {out}"):
            out.write_text(json.dumps(scores) + "\n", encoding="utf-8")
        say(f"wrote {out}")
    print(table([scores], certified, plain=sys.stdout.isatty()))
    say(f"results in {directory}")
    return 0


@generalise.command("verify")
@click.argument("path", type=click.Path(path_type=Path, exists=True))
def verify(path: Path) -> int:
    """Play the actions of every score again, and compare.

    PATH is a run, or a file that --out wrote. The exit code is 1 if a score is not what its actions earn.
    """
    from experiment_runner.study.generalisation.benchmark import read_scores
    from experiment_runner.study.generalisation.verification import differences

    wrong = 0
    for difference in differences(read_scores(path), say):
        print(difference)
        wrong += 1
    print(f"{wrong} scores are wrong" if wrong else "every score is what its actions earn")
    return 1 if wrong else 0

"""`glue-results`: list, show, compare, tabulate, export, merge and remove runs, and save a trained agent."""

from __future__ import annotations

import warnings
from typing import Final

import click

from experiment_runner.cli.options import LazyGroup
from glue import __version__

_COMMANDS: Final = {
    "results_shown": {
        "list": "List the runs in FOLDER (by default runs) and its subfolders.",
        "show": "Show the results of each RUN: a line for each setting, then failures and other events.",
        "compare": "Compare the agents of two runs over the trials that both have: A less B, "
        "in each environment.",
        "table": "Write the table of a paper: a row for each agent, a column for each environment "
        "of each RUN.",
        "power": "Show how many trials of two agents are needed to detect a difference D, from a pilot RUN.",
        "sensitivity": "Show how sensitive each agent of a sweep over several environments is "
        "to its options.",
    },
    "results_written": {
        "export": "Export the episodes of a RUN as one table: trial, episode, return, steps, terminal, ...",
        "merge": "Merge runs into a new one; the originals stay unchanged.",
        "gather": "Move the results of a job array to its RUN; the array's last job does this automatically.",
        "stream": "Send the results of a RUN to TensorBoard, W&B, MLflow or Trackio, also "
        "while the run is in progress.",
        "agent": "Write the agent of a RUN, from the newest checkpoint of its trial, to a file.",
        "remove": "Remove each RUN, after confirmation.",
    },
}
"""The modules of the subcommands, and the first sentence of the help of each."""


@click.group("glue-results", cls=LazyGroup, modules=_COMMANDS)
@click.version_option(__version__, prog_name="glue-results")
def results() -> None:
    """Work with the results of experiments, also while they run.

    A run is a directory that glue-experiment created (its --out).

    \b
    Examples:
      glue-results list
      glue-results show runs/mine
      glue-results export runs/mine --out mine.csv
      glue-results table runs/mine --format latex
      glue-results merge runs/lab1 runs/lab2 --out runs/both
      glue-results agent runs/mine --out mine.agent
      glue-results remove runs/mistake
    """
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's: returns may be infinite or NaN

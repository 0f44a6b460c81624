"""Carry out a plan for a person or a script: with progress, a recording, a page, and a table at the end."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import click

from experiment_runner.executors.resume import kept_if_begun, open_run
from experiment_runner.executors.run import RunConfig, run_trials
from experiment_runner.plan import Plan
from experiment_runner.players import listening
from experiment_runner.recording import recorded
from experiment_runner.report.progress import JsonLines, Progress
from experiment_runner.report.tables import summarize, tabulate, terminal_width
from experiment_runner.view.starting import viewed
from glue.console import say

__all__ = ["carry_out"]


def carry_out(
    directory: Path, plan: Plan, config: RunConfig, record: Path | None, as_json: bool, view: bool
) -> int:
    """Run what is unfinished of a plan; return the exit code: 1 if a trial has failed.

    Args:
        directory: of the run, new or to be continued.
        plan: of the run.
        config: how it is executed, checked for this plan.
        record: file of the recording; None for none.
        as_json: print JSON lines instead of a table.
        view: show the run on a page, which stays until Ctrl-C.
    """
    progress = Progress()
    lines = JsonLines(progress) if as_json else None
    began = time.monotonic()
    with kept_if_begun(directory, say), ExitStack() as stack:
        # Before anything is written, because an address may be in use.
        addresses = stack.enter_context(ExitStack())
        meeting = addresses.enter_context(listening(plan, config.meeting))
        # A recording may be one of the run's own files: then the run's folder has to be there first.
        inside = record is not None and record.absolute().parent == directory.absolute()
        recording = None if inside else stack.enter_context(recorded(record))
        store = stack.enter_context(open_run(directory, plan, say=progress.say))
        if inside:
            recording = stack.enter_context(recorded(record))
        wait = stack.enter_context(viewed(directory, progress.say)) if view else None
        failed = run_trials(store, replace(config, meeting=meeting), lines or progress, recording)
        addresses.close()  # a player that joins from now on would not be served
        seconds = time.monotonic() - began
        if lines is not None:
            lines.write(summarize(store, seconds))
        else:
            click.echo(tabulate(store, seconds, terminal_width()))
        if wait is not None:
            store.close()
            wait()
    if record is not None and not record.exists():
        say(f"no episode was started, so {record} was not written")
    return 1 if failed else 0

"""A table of a study: printed, and written to a page of the documents between its marks."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from experiment_runner.store.run_data import written
from experiment_runner.study.paper.report import with_tables

docs_option: Final = click.option(
    "--docs",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="Also write the table to this page, between its marks.",
)


def show(begin: str, table: str, docs: Path | None) -> None:
    """Print a table; with a page, write it there after the mark `begin`, too."""
    print(table, end="")
    if docs is not None:
        page = with_tables(docs, {begin: table})
        with written(docs) as partial:
            partial.write_text(page, encoding="utf-8")

"""Texts of strangers in a run, wherever one is shown: names, reasons and answers come from anyone."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.analysis.settings import collect
from experiment_runner.competition.board.forms import as_csv
from experiment_runner.competition.board.forms import as_text as board_text
from experiment_runner.competition.board.standings import Forfeit, Standing, Standings
from experiment_runner.executors.opening import open_run
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.comparing import COLUMNS, compared
from experiment_runner.report.overview import Overview, as_object, as_text, overview
from experiment_runner.report.progress import Progress
from experiment_runner.report.tables import format_table, tabulate
from experiment_runner.store.records import EpisodeResult, Reading
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import episode_table, metric_table, write_csv, write_json
from experiment_runner.view.catalog import Catalog, run_in_full
from experiment_runner.view.curves import Wanted, curves
from experiment_runner.view.export import as_page
from experiment_runner.view.stream import as_json

HOSTILE = "=cmd|x\x1b[2J\r\u202e\x9b31m<b>\nError: forged"
PLAN = Plan(episodes=1, environments=(RoleSweep("mines"),), agents=(RoleSweep("sarsa"),))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which every text is hostile: of the folder, players, trials, failures, events, answers."""
    directory = tmp_path_factory.mktemp("runs") / HOSTILE.replace("/", "")
    with open_run(directory, PLAN) as store:
        trial = store.trials()[0].spec.id
        read = (Reading(1, {"total reward": 1.0, "m": 1.0}),)
        store.record_all([(trial, EpisodeResult(1, 1.0, 1, True, 0.1), None, (), read)])
        store.record_player(trial, "agent", HOSTILE, HOSTILE)
        store.record_failure(trial, HOSTILE)
        store.record_void(trial, 2, HOSTILE)
        store.record_event("unseeded", HOSTILE)
        store.record_event("start", HOSTILE)
    role = json.dumps({"name": HOSTILE, "options": {HOSTILE: HOSTILE}, "label": HOSTILE})
    with contextlib.closing(
        sqlite3.connect(directory / "results.sqlite", isolation_level=None)
    ) as connection:
        connection.execute("UPDATE trials SET id = ?, agent = ?, environment = ?", (HOSTILE, role, role))
        connection.execute(
            "UPDATE metric_names SET names = replace(names, 'm', ?)", (HOSTILE.split("\n")[0],)
        )
        connection.execute("INSERT INTO answers VALUES (1, 1, ?, ?)", (HOSTILE, HOSTILE))
    return directory


def text_of(write: Callable[[Any, io.StringIO], None], table: Any) -> str:
    file = io.StringIO()
    write(table, file)
    return file.getvalue()


def progress(results: Results) -> str:
    shown = io.StringIO()
    report = Progress(shown)
    report.start(results.trials())
    report.begin(results.trials()[0].spec, 0, 0)
    report.rename(results.trials()[0].spec, HOSTILE)
    report.episode(results.trials()[0].spec, EpisodeResult(1, 1.0, 1, True, 0.1))
    report.end(results.trials()[0].spec)
    report.say(f"note: {HOSTILE}")
    return shown.getvalue()


SHOWN: dict[str, Callable[[Results], str]] = {
    "show": lambda run: as_text([run]),
    "list": lambda run: format_table(Overview.COLUMNS, [overview(run).cells()], prose=True),
    "the table at the end": lambda run: tabulate(run, 1.0),
    "compare": lambda run: format_table(COLUMNS, [row.cells() for row in compared(run, run, "episodes")]),
    "names of settings": lambda run: collect([run])[0].label,
    "progress": progress,
    "CSV": lambda run: text_of(write_csv, episode_table(run)),
    "CSV of metrics": lambda run: text_of(write_csv, metric_table(run)),
    "JSON": lambda run: text_of(write_json, episode_table(run)),
    "JSON of a run": lambda run: json.dumps(as_object(run)),
}


def shown_texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, part in value.items():
            yield name
            yield from shown_texts(part)
    elif isinstance(value, list):
        for part in value:
            yield from shown_texts(part)


def is_harmless(text: str) -> bool:
    return all(line.isprintable() and not line.startswith("Error: forged") for line in text.split("\n"))


@pytest.mark.parametrize("where", SHOWN)
def test_it_is_printable_and_begins_no_line(run: Path, where: str) -> None:
    with Results.open(run) as results:
        shown = SHOWN[where](results)
    assert is_harmless(shown)
    if where.startswith("CSV"):
        cells = [cell for row in csv.reader(io.StringIO(shown)) for cell in row]
        assert any("cmd" in cell for cell in cells)
        assert [cell for cell in cells if cell.startswith(("=", "+", "@"))] == []
    if where.startswith("JSON"):
        assert shown.isascii()


def test_on_the_page_every_text_is_printable(run: Path) -> None:
    found = [
        Catalog([run.parent]).changes(),
        run_in_full(run),
        curves(Wanted((run,), 0, "episodes", (0, 10))),
    ]
    texts = [*shown_texts(json.loads(as_json(found)))]
    assert any("?[2J??" in text for text in texts)
    assert [text for text in texts if not text.replace("\n", "").isprintable()] == []


def test_on_the_board_of_a_competition() -> None:
    standing = Standing(HOSTILE, forfeits=(Forfeit("t", 0, HOSTILE),), missing=HOSTILE)
    board = Standings(HOSTILE, ("t",), (standing,), HOSTILE)
    assert is_harmless(board_text(board))
    shown = as_csv(board)
    assert is_harmless(shown)
    assert [cell for row in csv.reader(io.StringIO(shown)) for cell in row if cell.startswith("=")] == []
    page = as_page(board).replace("<meta", "")
    assert "<b>" not in page
    assert page.replace("\n", "").isprintable()

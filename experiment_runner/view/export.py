"""The page's standings as one HTML file, which needs nothing else: no network, no script, no other file.

It has the page's style sheet, its tables and its drawings of curves.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.board.forms import LEGEND, line_of, number
from experiment_runner.competition.board.standings import Standing, Standings
from experiment_runner.report import svg
from glue.console import printable

_STYLE: Final = Path(__file__).with_name("static") / "style.css"
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'"
_AXES: Final = ("share of the task (%)", "reward so far")


def figures(board: Standings) -> list[dict[str, Any]]:
    """Return the learning curves of each task as JSON: name, drawing, and names with samples of lines."""
    placed = [standing for standing in board.entrants if standing.place is not None]
    drawn = []
    for task in board.tasks:
        curves = {
            number: standing.tasks[task].curve
            for number, standing in enumerate(placed)
            if standing.tasks[task].curve
        }
        if curves:
            # An entrant has the same line in every task.
            lines = [svg.Line((), ())] * len(placed)
            for number, curve in curves.items():
                lines[number] = svg.Line([100 * i / max(len(curve) - 1, 1) for i in range(len(curve))], curve)
            legend = [{"name": placed[number].name, "sample": svg.sample(number)} for number in curves]
            drawn.append({"task": task, "svg": svg.draw(lines, _AXES)["svg"], "legend": legend})
    return drawn


def as_page(board: Standings) -> str:
    """Return the standings as an HTML page."""
    title = _escape(board.competition)
    placed = [standing for standing in board.entrants if standing.place is not None]
    forfeits = [
        (standing.name, lost.task, str(lost.trial), lost.reason)
        for standing in board.entrants
        for lost in standing.forfeits
    ]
    missing = [(other.name, other.missing) for other in board.entrants if other.missing]
    header = ("place", "entrant", "mean rank", "total", "95 % interval", "by total", *board.tasks)
    body = [f"<h1>{title}</h1>", _table("Places", header, [_row(standing, board) for standing in placed])]
    if missing:
        body.append(_table("Without a place", ("entrant", "why"), missing))
    if forfeits:
        body.append(_table("Forfeits", ("entrant", "task", "trial", "reason"), forfeits))
    if players := [(one.name, one.player, one.id) for one in board.entrants if one.id]:
        body.append(_table("Programs", ("entrant", "program", "id"), players))
    body += [f"<p>{_escape(line_of(act))}</p>" for act in board.acts]
    body.append("<h2>Learning</h2><p>Sum of rewards over the course of a task; mean over trials.</p>")
    body.append(_drawings(board))
    if board.seeds:
        rows = [(s.task, str(s.trial), str(s.seed), json.dumps(dict(s.options))) for s in board.seeds]
        body.append(_table("Seeds", ("task", "trial", "seed", "options"), rows))
    body += [f'<dl class="terms">{"".join(_legend())}</dl>', f'<p class="quiet">{_held(board)}</p>']
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f'<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>\n{_STYLE.read_text(encoding='utf-8')}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


def _escape(text: str) -> str:
    """Return a text as HTML."""
    return html.escape(printable(text))


def _held(board: Standings) -> str:
    without = sum(standing.place is None for standing in board.entrants)
    verified = (
        "Every score was verified by replay."
        if not without
        else (
            f"Every score in the table of places was verified by replay; {without} of {len(board.entrants)} "
            "entrants have no place."
        )
    )
    return f"{verified} Held by {_escape(board.program)}."


def _drawings(board: Standings) -> str:
    parts = []
    for figure in figures(board):
        names = "".join(f"<li>{one['sample']} {_escape(one['name'])}</li>" for one in figure["legend"])
        task = _escape(figure["task"])
        parts.append(
            f'<figure class="card" role="img" aria-label="Learning curves of {task}">'
            f"<figcaption>{task}</figcaption>"
            f'{figure["svg"]}<ul class="legend">{names}</ul></figure>'
        )
    return f'<div class="figures">{"".join(parts)}</div>'


def _row(standing: Standing, board: Standings) -> tuple[str, ...]:
    scores = (standing.tasks[task] for task in board.tasks)
    return (
        str(standing.place),
        standing.name,
        f"{standing.mean_rank:g}",
        number(standing.total),
        f"{number(standing.low)} to {number(standing.high)}",
        str(standing.place_by_total),
        *(f"{number(task.score)} ({task.rank:g})" for task in scores),
    )


def _legend() -> Iterable[str]:
    for line in LEGEND:
        term, _, meaning = line.partition(" ")
        yield f"<dt>{_escape(term)}</dt><dd>{_escape(meaning.strip())}</dd>"


def _table(caption: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [
        f'<div class="scroll"><table class="board"><caption>{caption}</caption>',
        "<thead><tr>"
        + "".join(f'<th scope="col">{_escape(name)}</th>' for name in header)
        + "</tr></thead><tbody>",
        *("<tr>" + "".join(f"<td>{_escape(cell)}</td>" for cell in row) + "</tr>" for row in rows),
        "</tbody></table></div>",
    ]
    return "\n".join(lines)

"""The standings as one HTML page, which needs nothing beside itself: no network, no script, no other file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

from experiment_runner.competition.board.forms import LEGEND, number
from experiment_runner.competition.board.standings import Standing, Standings

__all__ = ["as_page"]

_STYLE: Final = """\
body { font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
body { color: #222; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: .3rem .8rem; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap; }
th:nth-child(2), td:nth-child(2), td.text, th.text { text-align: left; white-space: normal; }
figure { display: inline-block; margin: 1rem 1.5rem 1rem 0; }
svg { background: #fafafa; border: 1px solid #ddd; }
small, dd { color: #555; }
@media (prefers-color-scheme: dark) {
  body { background: #181818; color: #ddd; } svg { background: #222; border-color: #444; }
  th, td { border-color: #444; } small, dd { color: #aaa; }
}
"""

_COLORS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999900", "#888888")
"""Okabe and Ito's, which the colour-blind can tell apart."""

_WIDTH, _HEIGHT, _MARGIN = 420, 240, 10


def as_page(board: Standings) -> str:
    """Return the standings as an HTML page."""
    title = escape(board.competition)
    placed = [standing for standing in board.entrants if standing.place is not None]
    forfeits = [
        (standing.name, lost.task, str(lost.trial), lost.reason)
        for standing in board.entrants
        for lost in standing.forfeits
    ]
    missing = [(other.name, other.missing) for other in board.entrants if other.missing]
    header = ("place", "entrant", "mean rank", "total", "95 % interval", "by total", *board.tasks)
    body = [
        f"<h1>{title}</h1>",
        _table(header, (_row(standing, board) for standing in placed)),
        f"<dl>{''.join(_legend())}</dl>",
        "<h2>Learning</h2><p>What was earned so far, over the course of a task; mean over trials.</p>",
        *(_figure(task, placed) for task in board.tasks),
    ]
    if forfeits:
        body += ["<h2>Forfeits</h2>", _table(("entrant", "task", "trial", "reason"), forfeits, text=True)]
    if missing:
        body += ["<h2>Without a place</h2>", _table(("entrant", "reason"), missing, text=True)]
    if board.seeds:
        rows = [(s.task, str(s.trial), str(s.seed), json.dumps(dict(s.options))) for s in board.seeds]
        body += ["<h2>Seeds</h2>", _table(("task", "trial", "seed", "options"), rows, text=True)]
    body.append(f"<p><small>Every score was verified by replay. Held by {escape(board.program)}.</small></p>")
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="viewport" content="width=device-width">\n'
        f"<title>{title}</title>\n<style>\n{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


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
        yield f"<dt>{escape(term)}</dt><dd>{escape(meaning.strip())}</dd>"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], text: bool = False) -> str:
    kind = ' class="text"' if text else ""
    lines = ["<table>", "<tr>" + "".join(f"<th{kind}>{escape(name)}</th>" for name in header) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td{kind}>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])


def _figure(task: str, placed: Sequence[Standing]) -> str:
    """Return the learning curves of a task as inline SVG, with a legend."""
    curves = [
        (standing.name, standing.tasks[task].curve) for standing in placed if standing.tasks[task].curve
    ]
    low = min((min(curve) for _, curve in curves), default=0.0)
    high = max((max(curve) for _, curve in curves), default=0.0)
    lines, names = [], []
    for i, (name, curve) in enumerate(curves):
        color = _COLORS[i % len(_COLORS)]
        dashes = f' stroke-dasharray="{2 + i // len(_COLORS)} 3"' if i >= len(_COLORS) else ""
        points = " ".join(
            f"{_MARGIN + (_WIDTH - 2 * _MARGIN) * k / max(len(curve) - 1, 1):.1f},"
            f"{_HEIGHT - _MARGIN - (_HEIGHT - 2 * _MARGIN) * (value - low) / (high - low or 1):.1f}"
            for k, value in enumerate(curve)
        )
        lines.append(
            f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="2"{dashes}>'
            f"<title>{escape(name)}</title></polyline>"
        )
        names.append(f'<span style="color:{color}">&#9644;</span> {escape(name)}')
    return (
        f"<figure><figcaption><b>{escape(task)}</b> "
        f"<small>{number(low)} to {number(high)}</small></figcaption>"
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
        f'aria-label="learning curves of {escape(task)}">{"".join(lines)}</svg>'
        f"<div>{' '.join(names)}</div></figure>"
    )

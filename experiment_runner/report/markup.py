"""The table of a paper: results of agents in environments, in LaTeX (booktabs) or Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from experiment_runner.analysis.settings import Setting
from experiment_runner.analysis.stats import FEW_TRIALS
from experiment_runner.report.overview import FEW, setting_numbers
from experiment_runner.report.tables import counted, decimal, markdown_table, unfinished
from glue.console import one_line
from glue.errors import ExperimentError

_RETURN: Final = "mean return"  # the only column's title, if the environment has no name
_MINUS: Final = re.compile(r"-(?=\d)")
_SPECIAL: Final = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}


class Markup(NamedTuple):
    """A language of tables: how it writes a text, a number, and rows with their notes."""

    text: Callable[[str], str]
    number: Callable[[str], str]
    table: Callable[[Sequence[Sequence[str]], Sequence[str]], str]


def paper_table(settings: Sequence[Setting], over: str, markup: Markup) -> str:
    """Return the table of some settings: a row for each agent, a column for each environment.

    Args:
        settings: of returns.
        over: `episodes` or `steps`.
        markup: the language.

    Raises:
        ExperimentError: there is nothing to show.
    """
    if not settings:
        raise ExperimentError("there is nothing to show: the runs have no trials")
    cells: dict[str, dict[str, str]] = {}
    numbers = setting_numbers(settings, over)
    for setting, found in zip(settings, numbers, strict=True):
        cells.setdefault(setting.agent, {})[setting.environment] = _cell(found, markup)
    environments = list(dict.fromkeys(setting.environment for setting in settings))
    header = ["agent", *(markup.text(one_line(name)) if name else _RETURN for name in environments)]
    rows = [
        [markup.text(one_line(agent)), *(row.get(name, "") for name in environments)]
        for agent, row in cells.items()
    ]
    return markup.table([header, *rows], _notes(settings, numbers, over))


def _cell(numbers: Mapping[str, Any], markup: Markup) -> str:
    mean, low, high = (numbers[name] for name in ("mean", "low", "high"))
    if mean is None:
        return ""
    few = FEW if numbers["few_trials"] else ""
    interval = "" if low is None else f" [{markup.number(decimal(low))}, {markup.number(decimal(high))}]{few}"
    return markup.number(decimal(mean)) + interval


def _notes(settings: Sequence[Setting], numbers: Sequence[dict[str, object]], over: str) -> list[str]:
    counts = sorted({len(setting.counted()) for setting in settings})
    trials = counted(counts[0], "trial") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} trials"
    part = "last 100 episodes" if over == "episodes" else "last tenth of the steps"
    notes = [f"Mean over {trials} of the mean return of the {part}, with its 95 % bootstrap interval"]
    if any(row["few_trials"] for row in numbers):
        notes.append(f"{FEW.strip()} of fewer than {FEW_TRIALS} trials: the interval may well miss the mean")
    notes += unfinished([trial for setting in settings for trial in setting.trials])
    return [f"{note}." for note in notes]


def _latex(rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    header, *body = (" & ".join(row) + r" \\" for row in rows)
    columns = "l" * len(rows[0])
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", header, r"\midrule", *body, r"\bottomrule"]
    return "\n".join([*(f"% {note}" for note in notes), *lines, r"\end{tabular}"])


def _markdown(rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    header, *body = rows
    return f"{markdown_table(header, body, len(header))}\n\n{' '.join(notes)}"


LATEX: Final = Markup(
    lambda text: "".join(_SPECIAL.get(character, character) for character in text),
    lambda number: f"${number}$",
    _latex,
)
"""LaTeX, with the package booktabs."""

MARKDOWN: Final = Markup(
    lambda text: re.sub(r"([\\|`*_<>\[\]])", r"\\\1", text),
    lambda number: _MINUS.sub("\N{MINUS SIGN}", number),
    _markdown,
)
"""Markdown with tables, as of GitHub."""

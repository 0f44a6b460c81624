"""The report on the experiments of Mohan (2010): tables and figures in files, and in a page of the docs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from experiment_runner.analysis.stats import FloatArray
from experiment_runner.report.plots import learning_curves, save, scatter
from experiment_runner.report.tables import counted
from experiment_runner.store.database import reported
from experiment_runner.store.run_data import written
from experiment_runner.study.paper.experiments import ALL, EXPERIMENTS, PAPER_LEVEL, SOAR, PaperLevel
from experiment_runner.study.paper.outcomes import WINDOW, LevelResults, load
from experiment_runner.study.paper.tables import as_csv, as_markdown, as_soar_markdown
from glue.errors import ExperimentError

REPORT: Final = "report"
BEGIN: Final = "<!-- written by glue-paper, from here -->"
SOAR_BEGIN: Final = "<!-- written by glue-paper soar, from here -->"
END: Final = "<!-- to here -->"
_SAMPLE: Final = "sample"
_BEST: Final = "best"
_IN_CURVES: Final = (_SAMPLE, "4", "5", "6", "7", "8", _BEST)


class Report(NamedTuple):
    """The outcomes that were reported, and descriptions of the files that were written."""

    outcomes: list[LevelResults]
    written: list[str]


def write_report(out: Path, docs: Path | None = None) -> Report:
    """Write tables and figures of all runs in `out` to its subfolder `REPORT`.

    Args:
        out: contains the run directories.
        docs: a Markdown page; the tables are written between its marks `BEGIN` and `END`, those about the
            agents on the Soar kernel between `SOAR_BEGIN` and `END`, and the figures to images/paper next to
            it. Experiments without runs in `out` stay as they are.

    Raises:
        ExperimentError: no episode is finished yet, a mark is missing, or a file cannot be read or written.
    """
    outcomes = load(out)
    if not outcomes:
        raise ExperimentError(f"{out} contains no finished episode of any experiment")
    sections = _sections(outcomes)
    page = None if docs is None else with_tables(docs, sections)
    drawn = figures(outcomes)
    folder = _folder(out / REPORT)
    _write(folder / "tables.md", "\n".join(sections.values()))
    _write(folder / "tables.csv", as_csv(outcomes))
    for name, figure in drawn.items():
        for ending in ("png", "svg"):
            save(figure, folder / f"{name}.{ending}")
    files = [f"{folder / 'tables.md'}", f"{folder / 'tables.csv'}"]
    if drawn:
        files.append(f"{counted(len(drawn), 'figure')} to {folder}, as PNG and SVG")
    if docs is not None and page is not None:
        _write(docs, page)
        images = _folder(docs.parent / "images" / "paper")
        for name, figure in drawn.items():
            save(figure, images / f"{name}.png")
        files += [f"{docs}", f"{counted(len(drawn), 'figure')} to {images}"]
    return Report(outcomes, files)


def _sections(outcomes: list[LevelResults]) -> dict[str, str]:
    """Return the tables by the marks that they follow."""
    sections = {}
    for group, mark, write in ((ALL, BEGIN, as_markdown), (SOAR, SOAR_BEGIN, as_soar_markdown)):
        if found := [outcome for outcome in outcomes if outcome.experiment.group == group]:
            sections[mark] = write(found)
    return sections


def with_tables(docs: Path, sections: Mapping[str, str]) -> str:
    """Return the text of a page with the sections after their marks."""
    with reported(f"cannot read {docs}"):
        text = docs.read_text(encoding="utf-8")
    for mark, tables in sections.items():
        before, begin, rest = text.partition(mark)
        _, end, after = rest.partition(END)
        if not begin or not end:
            raise ExperimentError(f"{docs} must have the lines {mark} and {END}, in this order")
        text = f"{before}{begin}\n\n{tables}\n{end}{after}"
    return text


def _folder(path: Path) -> Path:
    with reported(f"cannot make {path}"):
        path.mkdir(parents=True, exist_ok=True)
    return path


def _write(path: Path, text: str) -> None:
    with written(path) as partial:
        partial.write_text(text, encoding="utf-8")


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(outcomes: Sequence[LevelResults]) -> dict[str, Figure]:
    """Return the figures that can be drawn from these outcomes, by name.

    figure-2, ...        the paper's: every episode of every trial as a dot, on the paper's level
    soar-3, ...          the same for experiments on the Soar kernel, with our own agent
    figure-13-nearest    the same for experiment 8 on the level where our reward is closest to the paper's
    curves-0, curves-1   learning curves of the hierarchical agents, `best` and the sample agent, on the
                         paper's level seed at difficulty 0 and 1
    best                 every episode of `best` on the paper's level seed, by difficulty

    Raises:
        ExperimentError: matplotlib is not installed.
    """
    drawn = {}
    for experiment in EXPERIMENTS.values():
        level = PaperLevel(PAPER_LEVEL.seed, experiment.difficulties[0])
        panels = {o.agent: o.curves for o in outcomes if o.experiment is experiment and o.level == level}
        if panels and (experiment.figure is not None or experiment.group == SOAR):
            name = f"figure-{experiment.figure}" if experiment.group == ALL else experiment.name
            drawn[name] = scatter(panels, window=WINDOW, reference=_sample(outcomes, level))
    nearest = _nearest([outcome for outcome in outcomes if outcome.level.seed != PAPER_LEVEL.seed])
    if nearest is not None:
        name = f"{nearest.agent}, level seed {nearest.level.seed}"
        drawn[f"figure-{nearest.experiment.figure}-nearest"] = scatter({name: nearest.curves}, window=WINDOW)
    for difficulty in (0, 1):
        level = PaperLevel(PAPER_LEVEL.seed, difficulty)
        curves = {o.agent: o.curves for o in outcomes if o.experiment.name in _IN_CURVES and o.level == level}
        if curves:
            drawn[f"curves-{difficulty}"] = learning_curves(
                {("", name): one for name, one in curves.items()}, window=WINDOW
            )
    best = {
        f"difficulty {o.level.difficulty}": o.curves
        for o in outcomes
        if o.experiment.name == _BEST and o.level.seed == PAPER_LEVEL.seed
    }
    if best:
        drawn[_BEST] = scatter(best, window=WINDOW)
    return drawn


def _nearest(outcomes: Sequence[LevelResults]) -> LevelResults | None:
    """Return the outcome whose reward is closest to the published one."""
    distances = {
        abs(float(outcome.reward.value) - outcome.published.reward): outcome
        for outcome in outcomes
        if outcome.published is not None and outcome.published.reward is not None
    }
    return distances[min(distances)] if distances else None


def _sample(outcomes: Sequence[LevelResults], level: PaperLevel) -> tuple[str, FloatArray] | None:
    for outcome in outcomes:
        if outcome.experiment.name == _SAMPLE and outcome.level == level:
            return "the sample agent", outcome.curves
    return None

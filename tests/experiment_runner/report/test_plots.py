from __future__ import annotations

import sys
import xml.etree.ElementTree
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.figure import Figure
from PIL import Image

from experiment_runner.analysis.curves import StepTotals
from experiment_runner.analysis.stats import tolerance_interval
from experiment_runner.report import plots
from glue.errors import ExperimentError

FloatArray = npt.NDArray[np.float64]


def learner(final: float, trials: int = 4, episodes: int = 300) -> FloatArray:
    chance = np.random.default_rng(int(final))
    rise = final * (1 - np.exp(-np.arange(episodes) / 50))
    return rise + chance.normal(0, 3, (trials, episodes)) + chance.normal(0, 3, (trials, 1))


LEARNERS = {"slow": learner(50), "quick": learner(80)}
CURVES = {("", name): values for name, values in LEARNERS.items()}


FINAL = "last 100 episodes"


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_learning_curve_is_the_running_mean_over_trials() -> None:
    figure = plots.learning_curves(CURVES, window=20)
    (axes,) = figure.axes
    slow, quick = axes.lines
    assert legend_of(figure) == ["slow (!)", "quick (!)"]
    np.testing.assert_array_equal(slow.get_xdata(), np.arange(20, 301))
    last = np.asarray(quick.get_ydata())[-1]
    assert last == pytest.approx(LEARNERS["quick"][:, -20:].mean())
    assert slow.get_color() != quick.get_color()
    assert slow.get_linestyle() != quick.get_linestyle()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("episode", "episode return (reward)")
    assert "running mean of 20 episodes over 4 trials" in " ".join(figure.get_suptitle().split())


def test_band_holds_the_mean_and_spans_the_trials() -> None:
    figure = plots.learning_curves({("", "slow"): LEARNERS["slow"]}, window=20)
    (band,) = figure.axes[0].collections
    corners = np.asarray(band.get_paths()[0].vertices)
    at_end = corners[corners[:, 0] == 300][:, 1]
    trials = LEARNERS["slow"][:, -20:].mean(axis=1)
    assert trials.min() <= at_end.min() < trials.mean() < at_end.max() <= trials.max()


@pytest.mark.parametrize("over", ["episodes", "steps", "a metric"])
def test_tolerance_band_is_the_interval_of_single_trials(over: str) -> None:
    values = learner(50, trials=60)
    if over == "episodes":
        figure = plots.learning_curves({("", "a"): values}, window=20, layout=plots.Layout(tolerance=True))
        last = values[:, -20:].mean(axis=1)
    elif over == "steps":
        steps = np.arange(301.0)
        trials = [StepTotals(steps, np.concatenate([[0.0], one.cumsum()])) for one in values]
        figure = plots.step_curves({("", "a"): trials}, window=30, layout=plots.Layout(tolerance=True))
        last = values[:, -30:].mean(axis=1)
    else:
        steps = np.arange(1.0, 301.0)
        figure = plots.metric_curves(
            {("", "a"): [(steps, one) for one in values]}, plots.Layout(label="error", tolerance=True)
        )
        last = values[:, -1]
    (band,) = figure.axes[0].collections
    corners = np.asarray(band.get_paths()[0].vertices)
    at_end = corners[corners[:, 0] == 300][:, 1]
    assert (at_end.min(), at_end.max()) == pytest.approx(tolerance_interval(last))
    assert "tolerance intervals" in " ".join(figure.get_suptitle().split())


def test_window_shrinks_for_a_short_run() -> None:
    figure = plots.learning_curves({("", "short"): learner(10, episodes=30)})
    assert "running mean of 3 episodes" in figure.get_suptitle()


def test_curve_shorter_than_the_window_is_left_out() -> None:
    figure = plots.learning_curves({**CURVES, ("", "begun"): learner(10, episodes=5)}, window=20)
    assert legend_of(figure) == ["slow (!)", "quick (!)"]


def test_curves_without_a_value_are_an_error() -> None:
    with pytest.raises(ExperimentError, match="explored"):
        plots.learning_curves({("", "a"): np.full((2, 100), np.nan)}, layout=plots.Layout(label="explored"))


def test_single_trial_is_drawn_without_a_band() -> None:
    figure = plots.learning_curves({("", "one"): learner(10, trials=1)})
    assert "over 1 trial," in figure.get_suptitle()
    assert not [path for band in figure.axes[0].collections for path in band.get_paths()]


def test_scatter_shows_every_episode_of_every_trial() -> None:
    figure = plots.scatter(LEARNERS, window=20)
    assert [axes.get_title(loc="left").replace("\N{NO-BREAK SPACE}", " ") for axes in figure.axes] == [
        "slow (4 trials)",
        "quick (4 trials)",
    ]
    dots, line = figure.axes[0].lines[:2]
    assert sorted(np.asarray(dots.get_ydata())) == sorted(LEARNERS["slow"].ravel())
    assert sorted(np.asarray(dots.get_xdata())) == sorted([*range(1, 301)] * 4)
    np.testing.assert_allclose(np.asarray(line.get_ydata())[-1], LEARNERS["slow"][:, -20:].mean())


def test_scatter_has_the_reference_in_every_panel() -> None:
    figure = plots.scatter(LEARNERS, reference=("sample agent", learner(30)))
    assert "sample agent" in legend_of(figure)
    for axes in figure.axes:
        (line,) = [line for line in axes.lines if line.get_label() == "sample agent"]
        assert np.asarray(line.get_ydata())[-1] == pytest.approx(learner(30)[:, -30:].mean())


def test_comparison_marks_mean_and_interquartile_mean() -> None:
    reached = np.array([1.0, 2.0, 3.0, 10.0])
    (axes,) = plots.comparison({"": {"a": reached, "b": reached + 5}}, final=FINAL).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a (!)", "b (!)"]
    marks = {
        (line.get_label(), float(np.asarray(line.get_xdata())[0]))
        for line in axes.lines
        if str(line.get_label()).endswith("mean")
    }
    assert marks == {("mean", 4.0), ("interquartile mean", 2.5)}


def test_comparison_has_a_panel_with_its_own_scale_for_each_environment() -> None:
    easy, hard, long = np.full(5, 100.0), np.zeros(2), "an environment " * 9
    figure = plots.comparison({"easy": {"a": easy, "b": easy}, long: {"a": hard}}, final=FINAL)
    figure.draw_without_rendering()
    panels = figure.axes
    lines = [line for axes in panels for line in axes.lines if line.get_label() == "mean"]
    means = [np.asarray(line.get_xdata()).item() for line in lines]
    assert means == [100, 0]
    assert [axes.get_title(loc="left").replace("\n", " ") for axes in panels] == ["easy", long.strip()]
    assert all(axes.title.get_window_extent().x1 <= figure.bbox.x1 for axes in panels)


def test_interval_of_few_trials_is_marked() -> None:
    few, enough = ({"": {"a": np.arange(float(n))}} for n in (4, 5))
    assert "unreliable" in plots.comparison(few, final=FINAL).get_suptitle()
    assert "unreliable" not in plots.comparison(enough, final=FINAL).get_suptitle()
    assert "unreliable" in plots.learning_curves({("", "a"): np.ones((4, 3))}).get_suptitle()


@pytest.mark.parametrize("name", ["_private", "$_$", "_$^$"])
def test_a_name_of_any_characters_is_shown_as_it_is(tmp_path: Path, name: str) -> None:
    figure = plots.learning_curves(
        {(name, name): learner(9.0, 5), (name, "b"): learner(9.0, 5)}, layout=plots.Layout(label=name)
    )
    assert [text.strip().replace("\\$", "$") for text in legend_of(figure)] == [name, "b"]
    plots.save(figure, tmp_path / "figure.png")
    plots.save(
        plots.comparison({name: {name: np.ones(5)}}, final=FINAL, layout=plots.Layout(label=name)),
        tmp_path / "figure.png",
    )
    plots.save(plots.scatter({name: learner(9.0)}, layout=plots.Layout(label=name)), tmp_path / "figure.png")


@pytest.mark.parametrize("empty", [{}, {"a": np.empty((0, 0))}])
def test_nothing_to_draw_is_an_error(empty: dict[str, FloatArray]) -> None:
    with pytest.raises(ExperimentError, match="nothing to draw yet"):
        plots.learning_curves({("", name): values for name, values in empty.items()})
    with pytest.raises(ExperimentError, match="nothing to draw yet"):
        plots.scatter(empty)
    with pytest.raises(ExperimentError, match="nothing to draw yet"):
        plots.comparison({"": empty}, final=FINAL)


def test_each_environment_has_a_panel_with_its_own_scale_and_an_agent_one_look() -> None:
    curves = {
        (environment, agent): learner(height, trials=trials)
        for environment, height in (("low", 10), ("high", 900))
        for agent, trials in (("a", 5), ("b", 2))
    }
    figure = plots.learning_curves(curves, layout=plots.Layout("Mine", (7.0, 3.0), 1))
    low, high = figure.axes
    assert [axes.get_title(loc="left") for axes in (low, high)] == ["low", "high"]
    assert low.get_ylim()[1] < 100 < high.get_ylim()[1]
    assert [line.get_color() for line in low.lines] == [line.get_color() for line in high.lines]
    assert legend_of(figure) == ["a", "b (!)"]
    assert (figure.get_suptitle(), tuple(figure.get_size_inches())) == ("Mine", (7.0, 3.0))
    assert low.get_position().x0 == high.get_position().x0  # one below the other
    apart = plots.profiles({key: values[:, -1] for key, values in curves.items()})
    assert [axes.get_title(loc="left") for axes in apart.axes] == ["low", "high"]


def test_figures_are_the_same_byte_for_byte(tmp_path: Path) -> None:
    for kind in ("png", "svg", "pdf"):
        one, two = (tmp_path / f"{attempt}.{kind}" for attempt in ("one", "two"))
        for path in (one, two):
            plots.save(plots.learning_curves(CURVES), path)
        assert one.read_bytes() == two.read_bytes()
    assert xml.etree.ElementTree.fromstring((tmp_path / "one.svg").read_bytes()).tag.endswith("svg")
    with Image.open(tmp_path / "one.png") as image:
        assert image.width == 1280
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 20


def test_users_style_neither_changes_a_figure_nor_is_changed(tmp_path: Path) -> None:
    plots.save(plots.learning_curves(CURVES), tmp_path / "plain.svg")
    with mpl.rc_context({"font.size": 30, "axes.grid": False}):
        plots.save(plots.learning_curves(CURVES), tmp_path / "styled.svg")
        assert mpl.rcParams["font.size"] == 30
    assert (tmp_path / "plain.svg").read_bytes() == (tmp_path / "styled.svg").read_bytes()


@pytest.mark.parametrize(
    ("name", "why"), [("x.gif", r"x\.gif"), ("absent/x.png", r"cannot write .*absent/x.png: No such file")]
)
def test_figure_that_cannot_be_written_leaves_nothing(tmp_path: Path, name: str, why: str) -> None:
    with pytest.raises(ExperimentError, match=why):
        plots.save(plots.scatter(LEARNERS), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_missing_matplotlib_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ExperimentError, match=r"need matplotlib: pip install 'glue-rl\[plot\]'"):
        plots.scatter(LEARNERS)

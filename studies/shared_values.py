"""Rank correlation of the values that agents on the Soar kernel and our own learned for the same states.

Both hold a value for each keystroke in a state, for each operator with its object, and for each operator in
a context. Ours are under hashed keys, so each of Soar's rules is looked up by the key of its conditions. Rank
correlation (Spearman's) compares two trials over the values that both have updated. Two trials of one agent
differ as well, since they explore differently: their correlation is the baseline.

    glue-paper soar
    python -m studies.shared_values runs/paper --docs docs/paper.md
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Final, NamedTuple

import click
import numpy as np

from agents.mario.agent import LEFT, RIGHT, STAY, action_number
from agents.mario.objects import (
    A_COIN,
    A_MONSTER,
    A_QUESTION,
    AWAY,
    NO_MOTION,
    STATIONARY,
    TOWARDS,
    VERTICAL,
    absolute_motion,
)
from agents.mohan2010 import flo
from agents.sarsa import extend, feature
from agents.soar.agents import parse_rules
from agents.soar.mario_link import SPRITES
from experiment_runner.analysis.stats import FloatArray
from experiment_runner.report.tables import markdown_table
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.results import Results
from experiment_runner.study.paper.experiments import EXPERIMENTS, SOAR
from glue.cli.shared import run
from glue.errors import SaveError
from glue.saves import unpack
from studies.pages import docs_option, show
from studies.soar_values import CONTEXT, KEYSTROKE, OPERATOR, Learned, learned_values

BEGIN: Final = "<!-- written by studies.shared_values, from here -->"
_HEADER: Final = (
    "experiment", "agent", "values of", "shared", "Soar and ours", "two of ours", "two on Soar",
)  # fmt: skip

Values = Mapping[int, float]
"""Learned values that were updated, by our agents' keys."""

_SETTINGS: Final = {"grid": 2, "tile_above": False}
_FEWEST: Final = 10
"""Minimum number of shared values for a meaningful correlation."""

_KINDS: Final = {code: number for number, code in SPRITES.items()}
_DIRECTIONS: Final = {"left": LEFT, "stay": STAY, "right": RIGHT}
_OPERATORS: Final = {
    "tackle-monster": flo.TACKLE_MONSTER,
    "search-question": flo.SEARCH_QUESTION,
    "grab-coin": flo.GRAB_COIN,
}
_TILES: Final = {"coin": A_COIN, "question": A_QUESTION}
_MOTIONS: Final = {
    "stationary": STATIONARY,
    "vertical": VERTICAL,
    "towards": TOWARDS,
    "away": AWAY,
    "none": NO_MOTION,
}
_SIGNS: Final = {"left": -1, "down": -1, "not": 0, "right": 1, "up": 1}


class Agreement(NamedTuple):
    """Similarity of values of one kind: rank correlations, means over pairs of trials; None without pairs.

    shared  mean number of values that two trials, one on Soar and one of ours, have both updated
    """

    experiment: str
    agent: str
    kind: str
    shared: float
    soar_and_ours: float | None
    two_of_ours: float | None
    two_on_soar: float | None


def agreements(directory: Path) -> list[Agreement]:
    """Compare the values at the newest checkpoints of all two-level agents on Soar with those of ours.

    Args:
        directory: contains the run directories, each with the name of its experiment.

    Raises:
        ExperimentError: a run cannot be read.
        SaveError: a checkpoint is damaged.
    """
    found = []
    for name, experiment in EXPERIMENTS.items():
        on_soar, ours = (experiment.agents[0].label, experiment.agents[-1].label)
        with reported(f"cannot read {directory / name}"):
            compared = experiment.group == SOAR and on_soar != "soar-flat" and holds_run(directory / name)
        if not compared:
            continue
        soar, own = _saves(directory / name, on_soar), _saves(directory / name, ours)
        if not soar or not own:
            continue
        rules = [_soar_values(save, on_soar) for save in soar]
        table = [_our_values(save, ours) for save in own]
        for kind in (KEYSTROKE, OPERATOR, CONTEXT):
            on = [{key: value for key, (which, value) in trial.items() if which == kind} for trial in rules]
            if any(on):
                found.append(Agreement(name, on_soar, kind, *_compare(on, table)))
    return found


def key_of(learned: Learned) -> int:
    """Return the key under which our agents keep the value of one of Soar's rules.

    Raises:
        SaveError: the rule describes something that our agents do not see.
    """
    try:
        return int(_key_of(learned))
    except (KeyError, ValueError, IndexError):
        raise SaveError(f"a rule describes what our agents do not see: {learned}") from None


def spearman(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the rank correlation of two sequences of numbers; equal numbers share their mean rank."""
    one, other = _ranks(first), _ranks(second)
    if not np.ptp(one) or not np.ptp(other):
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _compare(
    soar: Sequence[Values], ours: Sequence[Values]
) -> tuple[float, float | None, float | None, float | None]:
    kind = set().union(*soar)
    own = [{key: trial[key] for key in kind & trial.keys()} for trial in ours]
    pairs = list(product(soar, own))
    shared = float(np.mean([len(one.keys() & other.keys()) for one, other in pairs]))
    return shared, _mean(pairs), _mean(list(combinations(own, 2))), _mean(list(combinations(soar, 2)))


def _mean(pairs: Sequence[tuple[Values, Values]]) -> float | None:
    found = []
    for one, other in pairs:
        shared = sorted(one.keys() & other.keys())
        if len(shared) >= _FEWEST:
            found.append(spearman([one[key] for key in shared], [other[key] for key in shared]))
    return float(np.mean(found)) if found else None


def _ranks(numbers: Sequence[float]) -> FloatArray:
    _, place, count = np.unique(np.asarray(numbers, np.float64), return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def _saves(directory: Path, agent: str) -> list[bytes]:
    with Results.open(directory) as results:
        trials = [t.spec.id for t in results.trials() if t.spec.agent and t.spec.agent.label == agent]
        return [found[1].agent for found in map(results.checkpoint, trials) if found is not None]


def _soar_values(save: bytes, agent: str) -> dict[int, tuple[str, float]]:
    """Return the values that a Soar agent has updated (all that are not 0), and their kinds, by our keys."""
    text = unpack(save, agent, {}).array("rules", np.int8).tobytes().decode()
    learned = learned_values(parse_rules(text))
    return {key_of(what): (what.kind, value) for what, value in learned.items() if value}


def _our_values(save: bytes, agent: str) -> Values:
    saved = unpack(save, agent, _SETTINGS)
    return dict(
        zip(saved.array("keys", np.uint64).tolist(), saved.array("values", np.float64).tolist(), strict=True)
    )


def _key_of(learned: Learned) -> np.uint64:
    if learned.kind == CONTEXT:
        words = learned.seen.split("-")  # threat-yes-coin-no-question-yes
        present = [name for name, answer in zip(words[::2], words[1::2], strict=True) if answer == "yes"]
        kinds = {"threat": A_MONSTER, **_TILES}
        bits = sum(1 << kinds[name] for name in present)
        return _row(flo.CONTEXT, _OPERATORS[learned.chosen], bits)
    parts = learned.seen.split("*")
    dx, dy = int(parts[1]), int(parts[2])
    if parts[0] in _TILES:
        thing = (_TILES[parts[0]], 0, dx, dy, 0)
        size = parts[3:]
    else:
        thing = (A_MONSTER, _KINDS[parts[0]], dx, dy, _motion(parts[3]))
        size = parts[4:]
    if learned.kind == OPERATOR:
        return _row(flo.FLO_LEVEL, *thing)
    words = learned.chosen.split("-")
    direction = _DIRECTIONS.get(words[0], STAY)
    action = action_number(direction, "jump" in words, "fast" in words)
    return _row(flo.KLO_LEVEL, *thing, _KINDS[size[0]], action)


def _row(first: int, *others: int) -> np.uint64:
    """Return the key of a row of numbers, as `flo.describe` and its callers write them."""
    key = feature(first)
    for number in others:
        key = extend(np.uint64(key), number)
    return key


def _motion(text: str) -> int:
    if text in _MOTIONS:
        return _MOTIONS[text]
    across, up = (_SIGNS[sign] for sign in text.split("-"))
    return absolute_motion(float(across), float(up))


def as_markdown(found: Sequence[Agreement]) -> str:
    """Return a table in Markdown."""
    rows = []
    for one in found:
        ranks = (one.soar_and_ours, one.two_of_ours, one.two_on_soar)
        shown = ("" if rank is None else f"{rank:.2f}" for rank in ranks)
        rows.append((one.experiment, f"`{one.agent}`", one.kind, f"{one.shared:,.0f}", *shown))
    return f"**Rank correlation of the values**\n\n{markdown_table(_HEADER, rows, texts=3)}\n"


@click.command("python -m studies.shared_values")
@click.argument("runs", type=click.Path(path_type=Path, exists=True, file_okay=False))
@docs_option
def shared_values(runs: Path, docs: Path | None) -> None:
    """Compare the values that agents on Soar and ours have learned in the runs of `glue-paper soar`."""
    show(BEGIN, as_markdown(agreements(runs)), docs)


if __name__ == "__main__":
    run(shared_values)

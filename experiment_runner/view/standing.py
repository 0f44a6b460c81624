"""The standings of a competition as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from experiment_runner.competition.board.forms import LEGEND, as_json
from experiment_runner.competition.board.standings import standings
from experiment_runner.competition.organiser import competition_of
from experiment_runner.store.results import Results

__all__ = ["standings_of"]


def standings_of(directory: Path) -> dict[str, Any]:
    """Return the board of a competition, and how far it has come; nothing of the secret seed.

    Raises:
        ExperimentError: the directory holds no competition, or cannot be read.
    """
    with Results.open(directory) as results:
        board: dict[str, Any] = json.loads(as_json(standings(results, competition_of(directory))))
        progress = {"matches": len(results.trials()), "over": len(results.outcomes())}
        return board | progress | {"legend": LEGEND}

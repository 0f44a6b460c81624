"""Certificates of levels: for each, actions that reach its goal, found by one search of the whole level.

    python -m studies.certificates ladder-v1 --out docs/certificates/ladder-v1.json.gz
    glue-generalise verify docs/certificates/ladder-v1.json.gz

A certificate is a score of a level, see `experiment_runner.study.generalisation.benchmark.document`.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import click
import numpy as np

from agents.planner.search import SETTINGS, STAY, make_room, model, search
from env_server.mario import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import VERSION, LevelSet
from experiment_runner.store.output import written
from experiment_runner.study.generalisation.benchmark import Benchmark, read_scores
from experiment_runner.study.generalisation.players import ACTIONS, level_set
from experiment_runner.study.generalisation.summary import Document, table
from experiment_runner.study.generalisation.verification import replay
from glue.cli.shared import run
from glue.compiled.jit import announce_compilation
from glue.errors import ConfigError

_SIMS: Final = 1_000_000
"""Model steps of the search for a certificate."""
_WEIGHT: Final = 1.5
_TASK: Final = InfiniteMario().parameters
_DIGITS: Final = "".join(ACTIONS)


@click.command("certificates")
@click.argument("levels", metavar="SET")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="File of the certificates; those in it are kept, and the others added. It is compressed if its name "
    "ends in .gz.",
)
def certificates(levels: str, out: Path) -> None:
    """Find a certificate for each level of a set: actions that reach the goal, planned with the level known.

    SET is the name of a set, or NAME:N for its first N levels. The command may be interrupted and run again.
    """

    def keep(document: Document) -> None:
        text = json.dumps(document, separators=(",", ":")).encode() + b"\n"
        with written(out) as partial:
            partial.write_bytes(gzip.compress(text, mtime=0) if out.suffix == ".gz" else text)

    print(table([certify(levels, read_scores(out) if out.exists() else None, keep)]))


def certify(name: str, known: Document | None, keep: Callable[[Document], None]) -> Document:
    """Find a certificate for each level of a set.

    Args:
        name: of the set, as `level_set` takes it.
        known: certificates that were found before; their levels are skipped.
        keep: called with the certificates so far, every 100 levels and at the end.

    Raises:
        ConfigError: there is no such set, or `known` are certificates of other levels.
    """
    column = name.partition(":")[0]
    levels = level_set(name)
    trial: dict[str, Any] = {"seed": 0, column: [], "level_sets_version": VERSION}
    benchmark = Benchmark("certificates", "planner", sets=(column,), seeds=(0,))
    if known is not None:
        if known.get("name") != benchmark.name or known.get("sets") != [column]:
            raise ConfigError(f"these are not certificates of {column}")
        trial[column] = list(known["trials"][0][column])
    document = {**asdict(benchmark), "trials": [trial]}
    done = {score["level"] for score in trial[column]}
    for count, number in enumerate([number for number in levels.numbers if number not in done], 1):
        trial[column].append(_certificate(levels, number))
        if count % 100 == 0:
            keep(document)
    trial[column].sort(key=lambda score: int(score["level"]))
    keep(document)
    return document


def _certificate(levels: LevelSet, number: int) -> dict[str, Any]:
    """Return the score of the way found to the goal, or a score without actions."""
    game = Game(levels.level(_TASK, number))
    game.start()
    way, sims = _find_way(game.world, game.level_map, _SIMS)
    actions = "".join(_DIGITS[action] for action in way)
    return {
        "level": number,
        "difficulty": levels.difficulty(number),
        **replay(levels, number, actions),
        "seconds": 0.0,
        "sims": sims,
        "actions": actions,
        "answers": {},
    }


def _find_way(world: Any, level: Any, sims: int) -> tuple[list[int], int]:
    """Search for actions that reach the goal, regardless of their cost.

    In the first of two searches, a state is not visited again at another time.

    Args:
        world: the record of a game that has just begun; it is not changed.
        level: the record of its level, all columns of which are known.
        sims: maximum model steps of a search; each takes 4 kB of memory.

    Returns:
        The actions by number, none if no way was found, and the model steps.
    """
    worlds, levels = model.make()
    worlds[0], levels[0] = world, level
    columns = int(levels["columns"][0])
    scratch, _ = model.make()
    settings: Any = np.zeros(1, SETTINGS)
    how = settings[0]
    how["weight"], how["sims"] = _WEIGHT, sims
    how["end"] = how["columns"] = columns
    plan = np.zeros(int(worlds["max_trial_steps"][0]) + 1, np.int64)
    spent = 0
    for hard in (True, False):
        how["hard"] = hard
        plan[:] = -1
        with announce_compilation("the planner"):
            room = make_room(sims, columns)
            length = search(worlds, levels, scratch, scratch.view(np.uint8), *room, settings, plan)
        spent += int(how["used"])
        way: list[int] = plan[:length].tolist()
        scratch[0] = worlds[0]
        for action in way:
            model.step(scratch, levels, action)
        if scratch["win_timer"][0] > 0:
            # The game notices the win when it draws again.
            return way + [STAY] * int(scratch["playing"][0]), spent
    return [], spent


if __name__ == "__main__":
    run(certificates)

"""Certificates of levels: for each, actions that reach its goal, found by one search of the whole level.

    python -m studies.certificates ladder-v1 --out docs/certificates/ladder-v1.json.gz
    glue-generalise verify docs/certificates/ladder-v1.json.gz

A certificate is a score of a level, see `experiment_runner.study.generalisation.benchmark.document`.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import click
import numpy as np

from agents.planner.search import SETTINGS, STAY, make_room, model, search
from env_server.mario import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import VERSION, LevelFolder, LevelSet
from experiment_runner.store.run_data import written
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


@click.command("python -m studies.certificates")
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

    SET is the name of a set, or NAME:N for its first N levels, or a folder of levels in files. The command
    may be interrupted and run again.
    """

    def keep(document: Document) -> None:
        text = json.dumps(document, separators=(",", ":")).encode() + b"\n"
        with written(out) as partial:
            partial.write_bytes(gzip.compress(text, mtime=0) if out.suffix == ".gz" else text)

    document = certify(levels, read_scores(out) if out.exists() else None, keep)
    print(table([document]))
    for line in unsolved(document, level_set(levels)):
        print(line)


def certify(name: str, known: Document | None, keep: Callable[[Document], None]) -> Document:
    """Find a certificate for each level of a set.

    Args:
        name: of the set, as `level_set` takes it.
        known: certificates that were found before; their levels are skipped.
        keep: called with the certificates so far, every 100 levels and at the end.

    Raises:
        ConfigError: there is no such set, or `known` are certificates of other levels.
    """
    levels = level_set(name)
    column = name.partition(":")[0] if isinstance(levels, LevelSet) else levels.name
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


def unsolved(document: Document, levels: LevelSet | LevelFolder) -> Iterator[str]:
    """Yield a line about each level without a solution: whether the search has tried all it distinguishes."""
    for score in document["trials"][0][document["sets"][0]]:
        if not score["goal"]:
            steps = f"{score['sims']:,} model steps"
            found = f"no way was found in {steps}"
            if score.get("exhausted"):
                found = f"no way among all states that the search tells apart ({steps})"
            yield f"{levels.title(score['level'])}: {found}"


def _certificate(levels: LevelSet | LevelFolder, number: int) -> dict[str, Any]:
    """Return the score of the way found to the goal, or a score without actions."""
    game = Game(levels.level(_TASK, number))
    game.start()
    way, sims, exhausted = _find_way(game.world, game.level_map, _SIMS)
    actions = "".join(_DIGITS[action] for action in way)
    return {
        "level": number,
        "difficulty": levels.difficulty(number),
        **replay(levels, number, actions),
        "seconds": 0.0,
        "sims": sims,
        **({"exhausted": exhausted} if not way else {}),
        "actions": actions,
        "answers": {},
    }


def _find_way(world: Any, level: Any, sims: int) -> tuple[list[int], int, bool]:
    """Search for actions that reach the goal, regardless of their cost.

    In the first of two searches, a state is not visited again at another time. If that search ends early, it
    has tried all twelve actions in every state that it tells apart (`agents.planner.search.describe`): in the
    first one met of each combination of Mario's position in 4 by 4 pixels, his speed, jump and size, whether
    he carries a shell, and the numbers of coins and kills. Another state of a combination, with other last
    digits or other places of the enemies, may lead on: this is evidence that there is no way, and no proof.

    Args:
        world: the record of a game that has just begun; it is not changed.
        level: the record of its level, all columns of which are known.
        sims: maximum model steps of a search; each takes 4 kB of memory.

    Returns:
        The actions by number, none if no way was found, the model steps, and whether the first search ended
        early.
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
    spent, exhausted = 0, False
    for hard in (True, False):
        how["hard"] = hard
        plan[:] = -1
        with announce_compilation("the planner"):
            room = make_room(sims, columns)
            length = search(worlds, levels, scratch, scratch.view(np.uint8), *room, settings, plan)
        spent += int(how["used"])
        exhausted |= hard and bool(how["used"] < sims)
        way: list[int] = plan[:length].tolist()
        scratch[0] = worlds[0]
        for action in way:
            model.step(scratch, levels, action)
        if scratch["win_timer"][0] > 0:
            # The game notices the win when it draws again.
            return way + [STAY] * int(scratch["playing"][0]), spent, False
    return [], spent, exhausted


if __name__ == "__main__":
    run(certificates)

"""Results verified by replay, and certificates: for each level, actions that reach its goal.

Both are documents, see `experiment_runner.study.generalisation.benchmark.document`. A score holds the
actions of its episode, so that anybody can play them in the simulator and compare what they earn.
Certificates are found by `python -m studies.certificates`; without a solution, a score holds no actions, only
the model steps spent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from env_server.mario import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import VERSION, LevelFolder, LevelSet
from experiment_runner.study.generalisation.players import ACTIONS, Noise, is_won, level_set, scored_levels
from experiment_runner.study.generalisation.summary import Document
from glue.errors import ConfigError

_TASK: Final = InfiniteMario().parameters
_MOST_ACTIONS: Final = 100_000


def differences(document: Document, say: Callable[[str], None]) -> Iterator[str]:
    """Play the actions of every score again; yield a description of each score that is not what they earn, or
    that is there more than once.

    Args:
        document: scores that may come from anybody.
        say: receives the number of levels without an episode, if there are any, and at the end the number of
            scores that were replayed.

    Raises:
        ConfigError: the document is not of these sets, or its fields are missing or of another type.
    """
    replayed = 0
    seen: set[tuple[str, int, int]] = set()
    try:
        noise, attempt = float(document.get("noise", 0.0)), int(document["relearn"])
        columns = {name: name for name in document["sets"]}
        columns = columns or {"train": document["train"], "test": document["test"]}
        for trial in document["trials"]:
            if trial.get("level_sets_version") != VERSION:
                raise ConfigError(f"these scores are of other sets of levels than version {VERSION}")
            for column, name in columns.items():
                levels, numbers = level_set(str(name)), {number for _, number in scored_levels(str(name))}
                missing = len(numbers - {score["level"] for score in trial[column] if score["actions"]})
                if missing:
                    say(f"{missing} of {len(numbers)} levels of {name} have no episode, seed {trial['seed']}")
                for score in trial[column]:
                    if int(score["level"]) not in numbers:
                        raise ConfigError(f"level {score['level']} is not one of {name}")
                    one = column, int(trial["seed"]), int(score["level"])
                    if one in seen:
                        yield f"{name}, level {one[2]}, seed {one[1]}: it is there more than once"
                    seen.add(one)
                    wrong = _difference(
                        score, levels, Noise(noise, int(trial["seed"]), score["level"], attempt)
                    )
                    replayed += 1
                    if wrong:
                        yield f"{name}, level {score['level']}, seed {trial['seed']}: {wrong}"
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"these are not scores that can be replayed: {error!r:.200}") from None
    say(f"{replayed} episodes were replayed")


def _difference(score: dict[str, Any], levels: LevelSet | LevelFolder, noise: Noise) -> str:
    """Return in words how a score differs from a replay of its actions; empty if it does not."""
    actions = str(score["actions"])
    if not actions and not score.get("sims"):
        return "its actions are not recorded"
    if len(actions) > _MOST_ACTIONS or not set(actions) <= ACTIONS.keys():
        return "its actions are not those of Infinite Mario"
    number = int(score["level"])
    earned, ended = _played(levels, number, actions, noise)
    if len(actions) != earned["steps"] or (actions and not ended):
        return (
            f"its {len(actions)} actions are not those of an episode, of which {earned['steps']} were played"
        )
    found = {"difficulty": levels.difficulty(number), **earned}
    return "; ".join(
        f"{name} is {score[name]}, replayed {found[name]}" for name in found if score[name] != found[name]
    )


def replay(
    levels: LevelSet | LevelFolder, number: int, actions: str, noise: Noise | None = None
) -> dict[str, Any]:
    """Return the outcome of actions, given by their digits, on a level, up to the end of the episode."""
    return _played(levels, number, actions, noise)[0]


def _played(
    levels: LevelSet | LevelFolder, number: int, actions: str, noise: Noise | None
) -> tuple[dict[str, Any], bool]:
    """Return the outcome of actions, and whether the episode has ended."""
    game = Game(levels.level(_TASK, number))
    game.start()
    earned, steps, ended = 0.0, 0, False
    for digit in actions:
        action = ACTIONS[digit]
        reward, _, ended = game.step(*InfiniteMario.buttons_of(noise(action) if noise else action))
        earned += reward
        steps += 1
        if ended:
            break
    return {"steps": steps, "goal": is_won(game), "episode_return": earned}, bool(ended)


def solvable(document: Document) -> set[int]:
    """Return the numbers of the levels for which certificates hold a solution."""
    scores = (score for trial in document["trials"] for name in document["sets"] for score in trial[name])
    return {score["level"] for score in scores if score["goal"]}

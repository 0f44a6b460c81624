"""How well `planner-learns` identifies physical constants, compared to a planner that knows them.

    python -m studies.physics instance-0 instance-7 random mdps --levels 200

Both play one episode on each level: the levels of test-1000 with the constants of a published task or
with random ones, or the published tasks themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any, Final, NamedTuple

import click
import numpy as np

from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent
from env_server.mario import InfiniteMario, model
from env_server.mario.game import Game
from env_server.mario.parameters import INSTANCES, MDPS, Parameters, resolve
from experiment_runner.analysis.stats import mean
from experiment_runner.report.tables import markdown_table
from experiment_runner.study.generalisation.players import is_won, level_set
from experiment_runner.study.generalisation.summary import estimated
from glue.cli.shared import run
from glue.errors import ConfigError

GROUPS: Final = (*(f"instance-{number}" for number in range(INSTANCES)), *MDPS, "random", "mdps")
"""Names of groups of tasks: constants on the levels of test-1000, or the 20 MDPs on their own levels."""

_HEAD: Final = (
    "constants", "levels", "identified in 10 steps", "median steps", "predicted from then on", "goals",
    "goals, told", "difference in points", "return", "return, told",
)  # fmt: skip
_TOLERANCE: Final = 0.001
_FEW: Final = 10  # steps
_MIXING: Final = 0x706879  # keeps random constants apart from other random numbers
_RISE: Final = (56.0, 200.0)  # pixels that Mario jumps with random constants
_HELD: Final = 4  # ticks for which a jump is held


class PhysicsResult(NamedTuple):
    """An episode of the agent that learns, and one of the agent that is told the constants."""

    identified: float  # steps until five constants were within 0.001; infinite if they never were
    predicted: float  # share of the steps since then in which Mario moved as predicted
    learned: bool  # whether the first agent reached the goal
    told: bool  # whether the second agent did
    learned_return: float
    told_return: float


def outcomes(group: str, levels: int) -> Iterator[PhysicsResult]:
    """Play a group of tasks, on the first `levels` levels of test-1000.

    Raises:
        ConfigError: there is no such group.
    """
    if group not in GROUPS:
        raise ConfigError(f"no group of tasks is called {group!r:.40}: choose from {', '.join(GROUPS)}")
    task_spec = InfiniteMario().env_init()
    learner = LearningPlannerAgent()
    for task in _tasks(group, levels):
        values = _constants(task)
        told = PlannerAgent(constants=" ".join(f"{name}={values[name]!r}" for name in values))
        learner.agent_init(task_spec)
        told.agent_init(task_spec)
        identified, predicted, *learned = _learn(learner, task, np.array([*values.values()]))
        game = Game(task)
        total = _play(told, game, lambda: None)
        yield PhysicsResult(identified, predicted, bool(learned[0]), is_won(game), learned[1], total)


def physics_table(groups: Sequence[str], played: Sequence[Sequence[PhysicsResult]]) -> str:
    """Return a table in Markdown, a row for each group."""
    rows = []
    for group, found in zip(groups, played, strict=True):
        steps = [outcome.identified for outcome in found]
        since = [outcome.predicted for outcome in found if np.isfinite(outcome.identified)]
        learned, told = (
            np.array([[getattr(one, name)] for one in found], float) for name in ("learned", "told")
        )
        rows.append(
            [
                *(group, str(len(found))),
                f"{np.mean([count <= _FEW for count in steps]):.3f}",
                f"{np.median(steps):g}",
                f"{np.mean(since):.4f}" if since else "",
                *(str(int(goals.sum())) for goals in (learned, told)),
                estimated(100 * (learned - told), mean, 1),
                *(
                    f"{np.mean([getattr(one, name) for one in found]):.1f}"
                    for name in PhysicsResult._fields[4:]
                ),
            ]
        )
    return markdown_table(_HEAD, rows, texts=1)


def _tasks(group: str, levels: int) -> Iterator[Parameters]:
    if group == "mdps":
        yield from (resolve({}, mdp=mdp) for mdp in MDPS)
        return
    chosen = level_set(f"test-1000:{levels}")
    for number in chosen.numbers:
        if group == "random":
            task = replace(Parameters(), **_random_constants(np.random.default_rng([_MIXING, number])))
        elif group in MDPS:
            task = resolve({}, mdp=group)
        else:
            task = resolve({}, instance=int(group.removeprefix("instance-")))
        yield chosen.level(task, number)


def _random_constants(rng: np.random.Generator) -> dict[str, Any]:
    """Return real-valued constants with which Mario jumps at least three tiles and at most twelve."""
    while True:
        walk = float(rng.uniform(0.3, 1.6))
        fall, jump = float(rng.uniform(0.42, 0.92)), -float(rng.uniform(1, 3.9))
        time = int(rng.integers(5, 16))
        speed, rise = 0.0, 0.0
        for tick in range(30):
            speed = -jump * (time - max(tick - 1, 0)) if tick < _HELD else max(speed * fall - 3, 0.0)
            rise += speed
        if _RISE[0] <= rise <= _RISE[1]:
            return {
                "speed_walk": walk,
                "speed_run": float(rng.uniform(max(walk, 0.6), 2.4)),
                "speed_jump": jump,
                "accel_fall": fall,
                "speed_slidejump": -float(rng.uniform(1, 2)),
                "jump_time": time,
            }


def _constants(task: Parameters) -> dict[str, float]:
    values = asdict(task)
    return {name: values[name] for name in model.CONSTANTS}


def _learn(
    agent: LearningPlannerAgent, task: Parameters, truth: model.Reals
) -> tuple[float, float, bool, float]:
    """Return steps until identification, share of steps predicted since, goal, return."""
    five = [i for i, name in enumerate(model.CONSTANTS) if name != "speed_slidejump"]
    game = Game(task)
    identified, steps, before = np.inf, 0, 0

    def chosen() -> None:
        nonlocal identified, steps, before
        if np.isinf(identified) and np.abs(agent.physics.constants - truth)[five].max() <= _TOLERANCE:
            identified, before = steps, agent.physics.surprises
        steps += 1

    total = _play(agent, game, chosen)
    wrong = agent.physics.surprises - before
    return identified, 1 - wrong / max(steps - identified, 1), is_won(game), total


def _play(agent: PlannerAgent, game: Game, chosen: Callable[[], None]) -> float:
    """Play an episode; return the sum of its rewards.

    Args:
        agent: initialised; it is not notified of the end of the episode.
        game: not started.
        chosen: called before each action is carried out.
    """
    total, ended = 0.0, False
    action = agent.agent_start(game.start())
    while not ended:
        chosen()
        reward, observation, ended = game.step(*InfiniteMario.buttons_of(action))
        total += reward
        if not ended:
            action = agent.agent_step(reward, observation)
    return total


@click.command("python -m studies.physics")
@click.argument("groups", nargs=-1, required=True)
@click.option(
    "--levels", type=click.IntRange(1, 1000), default=200, show_default=True, help="Levels of test-1000."
)
def physics(groups: tuple[str, ...], levels: int) -> None:
    """Show how well planner-learns identifies physical constants, compared to a planner that knows them.

    GROUPS are the constants to play with: instance-N, proving-N, testing-N or random; or mdps, the 20 MDPs.
    """
    print(physics_table(groups, [list(outcomes(group, levels)) for group in groups]))


if __name__ == "__main__":
    run(physics)

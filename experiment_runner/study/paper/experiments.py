"""The experiments of Mohan (2010) as data: agents, levels, and the paper's numbers.

Each experiment is an ordinary plan with a run directory, which `glue-results` and `glue-plot` read too.
Source: S. Mohan (2010), "Reinforcement Learning in Infinite Mario".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from experiment_runner.plan.plan import Plan, RoleSpec, RoleSweep
from glue.errors import ExperimentError

TRIALS: Final = 10
EPISODES: Final = 5000
ALL: Final = "all"
SOAR: Final = "soar"
SEED: Final = 0  # the random seed; the paper's agents were seeded by the clock


class PaperLevel(NamedTuple):
    """A level of type 0 (overground), with the game's parameters of instance 0."""

    seed: int
    difficulty: int


PAPER_LEVEL: Final = PaperLevel(121, 0)
_OTHER_SEEDS: Final = tuple(range(1, 11))


class Published(NamedTuple):
    """The paper's numbers for an agent: mean return of the last 100 episodes, and when it converged."""

    reward: float | None
    convergence: str


@dataclass(frozen=True, slots=True)
class PaperExperiment:
    """One experiment: every agent plays every level.

    Args:
        name: its name on the command line: the paper's number, if it has one.
        title: a short description.
        agents: the paper's agent first, then others for comparison.
        difficulties: of the levels.
        level_seeds: of the levels.
        figure: the number of its figure in the paper, None if it has none.
        published: the paper's numbers for the first agent, by difficulty.
        group: a word that also selects it on the command line.
        episodes: of a trial, unless the command line says otherwise.
        trials: of each agent on each level, unless the command line says otherwise.
    """

    name: str
    title: str
    agents: tuple[RoleSweep, ...]
    difficulties: tuple[int, ...] = (0,)
    level_seeds: tuple[int, ...] = (PAPER_LEVEL.seed,)
    figure: int | None = None
    published: Mapping[int, Published] = field(default_factory=dict)
    group: str = ALL
    episodes: int = EPISODES
    trials: int = TRIALS


def plan_of(experiment: PaperExperiment, episodes: int | None = None, trials: int | None = None) -> Plan:
    """Return the plan of an experiment, with its own numbers of episodes and trials unless given."""
    episodes = episodes or experiment.episodes
    trials = trials or experiment.trials
    mario = RoleSweep(
        "mario",
        {
            "instance": 0,
            "level_type": 0,
            "level_seed": experiment.level_seeds,
            "level_difficulty": experiment.difficulties,
        },
    )
    return Plan(episodes, 0, trials, SEED, (mario,), experiment.agents, "id")


def level_of(environment: RoleSpec) -> PaperLevel:
    """Return the level of an environment of a plan of `plan_of`.

    Raises:
        ExperimentError: the environment does not set the level.
    """
    seed, difficulty = (environment.options.get(name) for name in ("level_seed", "level_difficulty"))
    if not isinstance(seed, int) or not isinstance(difficulty, int):
        raise ExperimentError(f"{environment.label} does not set the level, as those of glue-paper do")
    return PaperLevel(seed, difficulty)


def _flat(name: str) -> tuple[RoleSweep, ...]:
    """Return an agent without the update by the terminal reward, as published, and the textbook version."""
    return RoleSweep(name), RoleSweep(name, {"terminal_update": True}, f"{name}-textbook")


_FAILS: Final = Published(None, "none")

_PAPER: Final = (
    PaperExperiment("sample", "the sample agent", (RoleSweep("sample"),), (0, 1),
        published={0: Published(128.48, "first success")}),
    PaperExperiment("1", "flat, propositional", _flat("tiles"),
        figure=2, published={0: Published(None, "none in 10000")}),
    PaperExperiment("2", "flat, propositional, linear", _flat("tiles-coarse"),
        figure=3, published={0: _FAILS}),
    PaperExperiment("3", "flat, object-oriented", _flat("objects-flat"),
        figure=5, published={0: Published(None, "none in 5000")}),
    PaperExperiment("4", "programmed selection", (RoleSweep("hierarchical-programmed"),), (0, 1),
        figure=8, published={0: Published(146.91, "about 1500"), 1: _FAILS}),
    PaperExperiment("5", "learned selection", (RoleSweep("hierarchical"),), (0, 1),
        figure=9, published={0: Published(145.95, "about 600, or 400"), 1: _FAILS}),
    PaperExperiment("6", "background facts", (RoleSweep("hierarchical-facts"),), (0, 1),
        figure=10, published={0: Published(148.56, "like 5"), 1: _FAILS}),
    PaperExperiment("7", "internal rewards", (RoleSweep("hierarchical-internal"),), (0, 1),
        figure=11, published={0: Published(145.98, "about 200"), 1: _FAILS}),
    PaperExperiment("8", "object-based coarse coding", (RoleSweep("objects-coarse"),), (1,),
        (PAPER_LEVEL.seed, *_OTHER_SEEDS), figure=13, published={1: Published(61.93, "")}),
    PaperExperiment("best", "beyond the paper", (RoleSweep("best"),), (0, 1, 2, 3),
        (PAPER_LEVEL.seed, *_OTHER_SEEDS)),
)  # fmt: skip


def _on_soar(number: str, agent: str, trials: int = 5) -> PaperExperiment:
    """Return an experiment of the paper for an agent on the Soar kernel and our own agent.

    A step takes Soar several hundred times as long.
    """
    (paper,) = (experiment for experiment in _PAPER if experiment.name == number)
    difficulty = paper.difficulties[0]
    return PaperExperiment(
        f"{SOAR}-{number}",
        f"{paper.title}, Soar beside ours",
        (RoleSweep(agent), paper.agents[0]),
        (difficulty,),
        published={difficulty: paper.published[difficulty]},
        group=SOAR,
        episodes=1000,
        trials=trials,
    )


EXPERIMENTS: Final[Mapping[str, PaperExperiment]] = {
    experiment.name: experiment
    for experiment in (
        *_PAPER,
        _on_soar("3", "soar-flat", trials=3),
        _on_soar("4", "soar-hierarchical-programmed"),
        _on_soar("5", "soar-hierarchical"),
        _on_soar("6", "soar-hierarchical-facts"),
        _on_soar("7", "soar-hierarchical-internal"),
        _on_soar("8", "soar-objects-coarse", trials=3),
    )
}
"""All experiments by name, in the order in which they run. The sample agent is in every figure."""

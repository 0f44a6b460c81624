"""Play an agent on sets of levels: learn on some, then be scored on each of others, once.

Every scored level is begun from the same agent: what it had learned before (agent_save) is loaded again, so
that neither the order of the levels nor what is learned on them matters. An agent that cannot save goes on as
it is. Every episode is played in a fresh game, because Infinite Mario keeps the buttons that an episode
leaves pressed into the next one, and they can change its return.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from env_server.mario import InfiniteMario
from env_server.mario.level_sets import VERSION, numbered_level
from glue.core.experiment import Experiment
from glue.core.local import local
from glue.errors import Unsupported
from glue.roles import Agent

__all__ = ["Evaluation", "Score", "evaluate"]

_MIXING: Final = 0x67656E  # keeps the order of the levels apart from the players' random numbers


@dataclass(frozen=True, slots=True)
class Score:
    """What an agent got on one level: the return, whether it reached the goal, and how many steps it made."""

    level: int
    episode_return: float
    goal: bool
    steps: int


@dataclass(frozen=True, slots=True)
class Evaluation:
    """One trial: its seed, the scores on both sets, and the seconds that learning and being scored took."""

    seed: int
    train: tuple[Score, ...]
    test: tuple[Score, ...]
    learning_seconds: float
    scoring_seconds: float

    def document(self) -> dict[str, Any]:
        """Return this as JSON has it."""
        return {**asdict(self), "level_sets_version": VERSION}


def evaluate(
    agent: Agent,
    seed: int,
    train: Sequence[int],
    test: Sequence[int],
    *,
    learn: int = 0,
    relearn: int = 0,
    progress: Callable[[str], None] = lambda line: None,
) -> Evaluation:
    """Let an agent learn on the training levels, then score it on each level of both sets.

    Args:
        agent: the agent; it is initialised with the seed.
        seed: of the agent, and of the order in which it meets the training levels.
        train, test: numbers of levels.
        learn: episodes on training levels before it is scored, each on a level drawn evenly.
        relearn: episodes on a level before the one that is scored there.
        progress: receives lines for people.

    Raises:
        GlueError: the agent fails.
    """
    environment = InfiniteMario()
    order = np.random.default_rng([_MIXING, seed])
    with local(agent, environment) as glue:
        player = _Player(glue, environment)
        glue.rl_init(seed)
        began = time.perf_counter()
        for episode in range(learn):
            player.play(train[int(order.integers(len(train)))])
            if (episode + 1) % 1000 == 0:
                progress(f"seed {seed}: {episode + 1} of {learn} episodes of learning")
        learned = _saved(glue)
        scored = time.perf_counter()
        progress(f"seed {seed}: {len(train)} training levels and {len(test)} unseen ones")
        on_train, on_test = (
            tuple(player.score(level, relearn, learned) for level in levels) for levels in (train, test)
        )
        glue.rl_cleanup()
    return Evaluation(seed, on_train, on_test, scored - began, time.perf_counter() - scored)


class _Player:
    """Plays episodes on numbered levels, each in a fresh game."""

    def __init__(self, glue: Experiment, environment: InfiniteMario) -> None:
        self._glue = glue
        self._environment = environment

    def score(self, level: int, relearn: int, learned: bytes | None) -> Score:
        if learned is not None:
            self._glue.rl_agent_load(learned)
        for _ in range(relearn):
            self.play(level)
        return self.play(level)

    def play(self, level: int) -> Score:
        glue, task = self._glue, numbered_level(self._environment.parameters, level)
        self._environment.env_init()  # rl_init would make the agent forget what it has learned
        glue.rl_env_message(
            f"level level_seed={task.level_seed} level_type={task.level_type} "
            f"level_difficulty={task.level_difficulty}"
        )
        glue.rl_start()
        step = glue.rl_step()
        while not step.terminal:
            step = glue.rl_step()
        return Score(level, glue.rl_return(), step.reward == task.reward_goal, glue.rl_num_steps())


def _saved(glue: Experiment) -> bytes | None:
    try:
        return glue.rl_agent_save()
    except Unsupported:
        return None

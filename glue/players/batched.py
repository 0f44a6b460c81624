"""Several environments as one, whose session holds them all: `glue-env NAME --batch 64`.

An environment whose name stands in the entry-point group `glue.batches` too has a class of its own for many
games, which takes the environment and the number of games.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points

import numpy as np

from glue.batches import Batch, Ragged, batch_task_spec, pack_batch, unpack_actions
from glue.errors import ConfigError
from glue.roles import Environment, SeedableEnvironment, TruncatingEnvironment, offers
from glue.types import CUT_OFF, Action, Observation

__all__ = ["BatchedEnvironments", "make_batch"]


def make_batch(name: str, make: Callable[[], Environment], games: int) -> Environment:
    """Return many games of the environment called `name` as one.

    Args:
        name: as for `glue.make`.
        make: makes one environment.
        games: how many games, at least one.

    Raises:
        ConfigError: so many do not fit.
    """
    for point in entry_points(group="glue.batches", name=name):
        batch: Environment = point.load()(make(), games)
        return batch
    return BatchedEnvironments([make() for _ in range(games)])


class BatchedEnvironments:
    """`environments`, of one kind, stepped together; a game that is over begins anew at once.

    Each gets a seed of its own, made from the one given. A batch never ends: the experiment limits its steps.

    Args:
        environments: at least one.

    Raises:
        ConfigError: there is none.
    """

    def __init__(self, environments: Sequence[Environment]) -> None:
        if not environments:
            raise ConfigError("a batch has at least one environment")
        self.__wrapped__ = environments[0]
        self._environments = [*environments]

    def env_batch(self) -> int:
        """Return how many games there are."""
        return len(self._environments)

    def env_seed(self, seed: int) -> None:
        """Seed each environment that can be seeded."""
        children = np.random.SeedSequence(seed).spawn(len(self._environments))
        for environment, child in zip(self._environments, children, strict=True):
            if offers(environment, SeedableEnvironment):
                environment.env_seed(int(child.generate_state(1, np.uint64)[0] >> np.uint64(1)))

    def env_init(self) -> str:
        """Initialise each environment; return the task spec of all.

        Raises:
            ConfigError: they have different ones.
        """
        specs = [environment.env_init() for environment in self._environments]
        if len({*specs}) > 1:
            raise ConfigError(f"the environments of a batch have one task spec, not {len({*specs})}")
        return batch_task_spec(len(specs), specs[0])

    def env_start(self) -> Observation:
        """Begin an episode in each game."""
        observations = [environment.env_start() for environment in self._environments]
        games = len(observations)
        return pack_batch(Batch(np.zeros(games), np.zeros(games, np.int32), Ragged.of(observations)))

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        """Carry out an action in each game; return the sum of the rewards, the batch, and False."""
        games = len(self._environments)
        actions = unpack_actions(action, games).values(Action)
        rewards, terminals = np.zeros(games), np.zeros(games, np.int32)
        observations: list[Observation] = []
        last: list[Observation] = []
        for i, (environment, one) in enumerate(zip(self._environments, actions, strict=True)):
            rewards[i], observation, terminal = environment.env_step(one)
            if terminal:
                terminals[i] = 1
                if offers(environment, TruncatingEnvironment) and environment.env_truncated():
                    terminals[i] = CUT_OFF
                    last.append(observation)
                observation = environment.env_start()
            observations.append(observation)
        batch = Batch(rewards, terminals, Ragged.of([*observations, *last]))
        return float(rewards.sum()), pack_batch(batch), False

    def env_cleanup(self) -> None:
        """Clean each environment up."""
        for environment in self._environments:
            environment.env_cleanup()

    def env_message(self, message: str) -> str:
        """Pass a message to each environment; return the answers, a line each, or one if they are equal."""
        answers = [environment.env_message(message) for environment in self._environments]
        return answers[0] if len({*answers}) == 1 else "\n".join(answers)

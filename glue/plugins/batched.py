"""Several environments served as one, in one session: `glue-env NAME --batch 64`.

An environment whose name is also in the entry-point group `glue.batches` has its own class for many games,
which takes the environment and the number of games.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from glue.batches import Batch, Ragged, batch_task_spec, pack_batch, unpack_actions
from glue.engine.calls import Answer, role_calls
from glue.errors import ConfigError, PeerFailed
from glue.installed import entry_points
from glue.roles import Environment, EnvironmentLike, MaskEnvironment, SeedableEnvironment, offers
from glue.types import CUT_OFF, Action, Observation, Step
from glue.wire.messages import Kind, Role


def make_batch(name: str, make: Callable[[], Environment], games: int) -> Environment:
    """Return many games of the environment called `name` as one.

    Args:
        name: as for `glue.make`.
        make: makes one environment.
        games: number of games, at least one.

    Raises:
        ConfigError: so many games do not fit.
    """
    for point in entry_points("glue.batches").select(name=name):
        batch: Environment = point.load()(make(), games)
        return batch
    return BatchedEnvironments([make() for _ in range(games)])


class BatchedEnvironments(Environment):
    """`environments`, of one kind, stepped together; a game that is over starts again at once.

    Each gets its own seed, derived from the one given. A batch never ends: the experiment limits its steps.

    Args:
        environments: at least one.

    Raises:
        ConfigError: there is none, or one has masks, for which a batch has no place; extras are left out.
    """

    def __init__(self, environments: Sequence[EnvironmentLike]) -> None:
        if not environments:
            raise ConfigError("a batch has at least one environment")
        if any(offers(environment, MaskEnvironment) for environment in environments):
            raise ConfigError("a batch of games carries no masks of the legal actions: play them singly")
        self.__wrapped__: EnvironmentLike = environments[0]
        self._environments = [*environments]
        self._calls = [role_calls(Role.ENVIRONMENT, environment) for environment in environments]

    def env_batch(self) -> int:
        """Return the number of games."""
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
            ConfigError: their task specs differ.
        """
        specs = [self._call(game, Kind.ENV_INIT)[1] for game in range(len(self._environments))]
        if len({*specs}) > 1:
            raise ConfigError(f"the environments of a batch have one task spec, not {len({*specs})}")
        return batch_task_spec(len(specs), specs[0])

    def env_start(self) -> Observation:
        """Begin an episode in each game."""
        observations = [self._call(game, Kind.ENV_START)[1] for game in range(len(self._environments))]
        games = len(observations)
        return pack_batch(Batch(np.zeros(games), np.zeros(games, np.int32), Ragged.of(observations)))

    def env_step(self, action: Action) -> Step:
        """Carry out an action in each game; return the sum of the rewards, the batch, and False."""
        games = len(self._environments)
        actions = unpack_actions(action, games).values(Action)
        rewards, terminals = np.zeros(games), np.zeros(games, np.int32)
        observations: list[Observation] = []
        last: list[Observation] = []
        for i, one in enumerate(actions):
            (rewards[i], terminals[i]), observation = self._call(i, Kind.ENV_STEP, one)
            if terminals[i]:
                if terminals[i] == CUT_OFF:
                    last.append(observation)
                observation = self._call(i, Kind.ENV_START)[1]
            observations.append(observation)
        batch = Batch(rewards, terminals, Ragged.of([*observations, *last]))
        return Step(float(rewards.sum()), pack_batch(batch), False)

    def env_cleanup(self) -> None:
        """Clean up each environment."""
        for game in range(len(self._environments)):
            self._call(game, Kind.ENV_CLEANUP)

    def env_message(self, message: str) -> str:
        """Pass a message to each environment; return the answers, one per line, or one if they are equal."""
        answers = [self._call(game, Kind.ENV_MESSAGE, message)[1] for game in range(len(self._environments))]
        return answers[0] if len({*answers}) == 1 else "\n".join(answers)

    def _call(self, game: int, kind: Kind, body: Any = None) -> Answer:
        """Return the answer of a game, checked like that of a single environment.

        Raises:
            PeerFailed: the answer is of the wrong type, or does not conform to the task spec.
        """
        try:
            return self._calls[game][kind]((), body)
        except PeerFailed as error:
            raise PeerFailed(f"game {game}: {error}") from error

"""Actions that are checked before an environment receives them."""

from __future__ import annotations

from typing import Any

from glue.errors import ConfigError, PeerFailed, TaskSpecError
from glue.roles import BatchEnvironment, Wrapper, offers
from glue.taskspec import Space, legal_values, mask_sizes, parse_task_spec
from glue.types import Action, Observation, step_of


class CheckedActions(Wrapper):
    """`environment`, which receives no action outside its task spec or the mask of its last observation.

    Args:
        environment: an environment.

    Raises:
        ConfigError: the environment is many games at once.
        PeerFailed: in env_step, the agent's action is illegal.
    """

    env_waits = True
    """Whether its hub must wait for agents: elsewhere an action is not carried out where it was chosen."""

    def __init__(self, environment: Any) -> None:
        if offers(environment, BatchEnvironment):
            raise ConfigError("the actions of many games at once cannot be checked")
        self.__wrapped__ = environment
        self._actions: Space | None = None
        self._shown = Observation()

    def env_init(self) -> str:
        task_spec: str = self.__wrapped__.env_init()
        try:
            self._actions = parse_task_spec(task_spec).actions
        except TaskSpecError:
            self._actions = None
        return task_spec

    def env_start(self) -> Observation:
        self._shown = self.__wrapped__.env_start()
        return self._shown

    def env_step(self, action: Action) -> Any:
        if self._actions is not None and (why := self._actions.check(action) or self._masked(action)):
            raise PeerFailed(f"the agent's {action!r:.80} is illegal: {why}")
        answer = self.__wrapped__.env_step(action)
        self._shown = step_of(answer).observation
        return answer

    def _masked(self, action: Action) -> str:
        """Return which int of an action the mask forbids, and the mask; "" if it forbids none."""
        assert self._actions is not None
        if not self._shown.packed_mask:
            return ""
        legal = legal_values(self._shown, mask_sizes(self._actions))
        for number, (value, allowed) in enumerate(zip(action.ints.tolist(), legal, strict=True)):
            low = int(self._actions.ints[number].ends[0])
            if not allowed[value - low]:
                bits = "".join("01"[bit] for bit in allowed[:64].tolist()) + "..." * (len(allowed) > 64)
                return f"int {number} is {value}, and the mask of the values from {low} on is {bits}"
        return ""

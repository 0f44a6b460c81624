"""Base of all agents' input links: the step's number, the reward, and whether the episode has ended.

    (<input-link> ^step 17 ^reward -0.01)        step counts from 1, from the start of the agent
    (<input-link> ^terminal yes)                 only in the last cycle of an episode

Only changes are written to working memory: Soar spends its time on changes.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping

from agents.soar.kernel import Kernel
from glue.taskspec import TaskSpec
from glue.types import Action, Observation


class SoarLink(abc.ABC):
    """The input link and the output link of a Soar agent.

    Args:
        kernel: the agent's kernel.
        task: the task's description.
    """

    def __init__(self, kernel: Kernel, task: TaskSpec) -> None:
        self._kernel = kernel
        self._steps = 0
        self._step = kernel.add_int(kernel.input, "step", 0)
        self._reward = kernel.add_float(kernel.input, "reward", 0.0)
        self._terminal = None

    def begin(self, observation: Observation) -> None:
        """Put the first observation of an episode on the input link."""
        if self._terminal is not None:
            self._kernel.remove(self._terminal)
            self._terminal = None
        self._forget()
        self.see(0.0, observation)

    def see(self, reward: float, observation: Observation) -> None:
        """Put a reward and the next observation on the input link.

        Raises:
            RemoteProtocolError: the observation does not fit the task.
        """
        self._count(reward)
        self._put(observation)

    def end(self, reward: float) -> None:
        """Put the last reward of an episode on the input link."""
        self._count(reward)
        self._terminal = self._kernel.add_text(self._kernel.input, "terminal", "yes")

    @abc.abstractmethod
    def action(self, name: str, parameters: Mapping[str, str]) -> Action:
        """Return the action of a command on the output link.

        Raises:
            SoarError: the command is not an action.
        """

    @abc.abstractmethod
    def _put(self, observation: Observation) -> None:
        """Put an observation on the input link."""

    @abc.abstractmethod
    def _forget(self) -> None:
        """Forget the previous episode."""

    def _count(self, reward: float) -> None:
        self._steps += 1
        self._kernel.update(self._step, self._steps)
        self._kernel.update(self._reward, reward)

"""One agent in the Soar kernel: its productions, its input and output, and its runs.

A kernel belongs to the thread that made it, so each thread has one for all its agents. It has no listener,
and lives as long as the thread: soar-sml 9.6.5 crashes when one of several kernels is shut down. Only this
module imports soar-sml, and only when an agent is made.

Every agent's input link has the step's number, the reward, and whether the episode has ended:

    (<input-link> ^step 17 ^reward -0.01)        step counts from 1, from the start of the agent
    (<input-link> ^terminal yes)                 only in the last cycle of an episode

Only changes are written to working memory: Soar spends its time on changes.
"""

from __future__ import annotations

import abc
import itertools
import threading
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from glue.errors import ConfigError, SimulatorError
from glue.installed import needing
from glue.taskspec import TaskSpec
from glue.types import Action, Observation

Element = Any
"""An element of working memory, as soar-sml returns it."""

_SETTINGS: Final = (
    "watch 0",
    "soar timers off",
    "output agent-writes off",
    "chunk never",
    "epmem --disable",
    "smem --disable",
)
"""Commands that turn off unneeded features, which would cost time or memory over many episodes."""

_SHOWN: Final = 1500
"""Maximum number of characters of Soar's output that an error shows, from its end."""


class SoarError(SimulatorError):
    """Soar refused something, or its agent did not act; the message shows Soar's output."""


class _Kernels(threading.local):
    """The kernel of each thread, and the agents in it by their names."""

    def __init__(self) -> None:
        import soar_sml

        self.agents: dict[str, Kernel] = {}
        self.halted = soar_sml.sml_RUNSTATE_HALTED
        self.kernel = soar_sml.Kernel.CreateKernelInCurrentThread(True, soar_sml.Kernel.kSuppressListener)
        self.kernel.AddRhsFunction("once", self._once, None)

    def _once(self, _event: int, _data: object, agent: Any, _function: str, command: str) -> str:
        self.agents[agent.GetAgentName()].execute_once(command)
        return ""


class Kernel:
    """A Soar agent in the kernel of this thread.

    Args:
        name: name of the agent, for Soar's own messages.
        max_cycles: maximum number of decision cycles in a step.

    Attributes:
        once: the first lines of the commands that the right-hand side function `once` has executed, and that
            it will skip.

    Raises:
        ConfigError: soar-sml is not installed.
    """

    def __init__(self, name: str, max_cycles: int) -> None:
        self._kernels = _kernels()
        self._name = name
        self._unique_name = f"{name}-{next(_numbers)}"
        self._max_cycles = max_cycles
        self.once: set[str] = set()
        self._failure: Exception | None = None
        self._agent = self._kernels.kernel.CreateAgent(self._unique_name)
        self._kernels.agents[self._unique_name] = self
        self._agent.SetBlinkIfNoChange(False)
        self.input: Element = self._agent.GetInputLink()
        # Bound once: an observation takes a hundred of these calls.
        self.add_identifier: Callable[[Element, str], Element] = self._agent.CreateIdWME
        self.add_link: Callable[[Element, str, Element], Element] = self._agent.CreateSharedIdWME
        self.add_int: Callable[[Element, str, int], Element] = self._agent.CreateIntWME
        self.add_float: Callable[[Element, str, float], Element] = self._agent.CreateFloatWME
        self.add_text: Callable[[Element, str, str], Element] = self._agent.CreateStringWME
        self.update: Callable[[Element, int | float | str], object] = self._agent.Update
        self.remove: Callable[[Element], object] = self._agent.DestroyWME
        for line in (*_SETTINGS, f"soar max-nil-output-cycles {max_cycles}"):
            self.command(line)

    def close(self) -> None:
        """Remove the agent from the kernel; nothing else may be called afterwards."""
        if self._kernels.agents.pop(self._unique_name, None):
            self._kernels.kernel.DestroyAgent(self._agent)

    # Productions and commands

    def command(self, line: str) -> str:
        """Execute a line of Soar's command language; return what it prints.

        Raises:
            SoarError: Soar does not accept the line.
        """
        printed: str = self._agent.ExecuteCommandLine(line)
        if not self._agent.GetLastCommandLineResult():
            raise SoarError(f"Soar does not accept {line!r:.200}: {_end_of(printed)}")
        return printed

    def source(self, file: Path) -> None:
        """Load a file of productions, and the files that it sources, which it names relative to itself.

        Raises:
            ConfigError: Soar does not accept a line of it.
        """
        try:
            self.command(f'source "{file.resolve().as_posix()}"')
        except SoarError as error:
            raise ConfigError(f"the productions of {str(file)!r} do not load: {error}") from None

    def value_rules(self) -> str:
        """Return the rules that give operators a numeric value, as productions, with their current values."""
        return self.command("print --rl --full")

    def execute_once(self, command: str) -> None:
        """Execute a command unless one with the same first line was executed; an error ends the run."""
        first_line = command.partition("\n")[0]
        if first_line not in self.once:
            self.once.add(first_line)
            try:
                self.command(command)
            except SoarError as error:
                self._failure = self._failure or error  # no exception can pass through the kernel

    # Runs

    def run(self) -> tuple[str, Mapping[str, str]]:
        """Run until the agent has put a command on its output link; return the command's name and parameters.

        Raises:
            SoarError: the agent has halted, or has sent no command in the decision cycles allowed for a step.
        """
        self._agent.Commit()
        self._agent.RunSelfTilOutput()
        self._raise_failure()
        if self._agent.GetRunState() == self._kernels.halted:
            raise SoarError(
                f"the Soar agent {self._name} has halted in the middle of an episode: a rule executed "
                f"(halt), or the kernel gave up; its goal stack is\n{_end_of(self.command('print --stack'))}"
            )
        if not self._agent.GetNumberCommands():
            raise SoarError(
                f"the Soar agent {self._name} has put no command on its output link in {self._max_cycles} "
                f"decision cycles; its goal stack is\n{_end_of(self.command('print --stack'))}"
            )
        command = self._agent.GetCommand(self._agent.GetNumberCommands() - 1)
        identifier = command.ConvertToIdentifier()
        children = (identifier.GetChild(i) for i in range(identifier.GetNumberChildren()))
        return command.GetCommandName(), {
            child.GetAttribute(): child.GetValueAsString() for child in children if child is not None
        }

    def run_cycle(self) -> None:
        """Run one decision cycle; the agent may send a command or not, or halt."""
        self._agent.Commit()
        self._agent.RunSelf(1)
        self._raise_failure()

    def reinitialize(self) -> None:
        """Empty working memory except for the input; learned values stay.

        With learning on, Soar would update the last operators of substates with the reward on the input.
        """
        self.command("rl --set learning off")
        self._agent.InitSoar()
        self.command("rl --set learning on")

    @property
    def cycles(self) -> int:
        """The number of decision cycles since `reinitialize`."""
        return int(self._agent.GetDecisionCycleCounter())

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


_numbers = itertools.count(1)


@cache
def _kernels() -> _Kernels:
    require_soar()
    return _Kernels()


def require_soar() -> None:
    """Raise ConfigError if soar-sml is not installed."""
    with needing("soar", "this agent needs soar-sml"):
        import soar_sml  # noqa: F401


def _end_of(printed: str) -> str:
    """Return the end of Soar's output, without the marks that it prints for loaded productions."""
    lines = [line for line in printed.strip().splitlines() if line.strip("*#& ")]
    return "\n".join(lines)[-_SHOWN:]


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

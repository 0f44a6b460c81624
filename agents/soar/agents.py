"""The agents made of Soar productions, by name: those of Mohan (2010), one for mines, and the user's own.

RL-Glue's agent, played by Soar: one run of the kernel for each step of the episode.

Soar's random numbers are reseeded for each episode, from the agent's seed and the episode's number, so
a saved agent continues with the same episodes. Soar has one generator for all kernels of a process, so
agents that take turns in one process disturb each other's random numbers.

A saved agent is the rules that hold its learned values, in Soar's own syntax, parsed without trusting
them: a rule is a production whose only action is a numeric preference. A save may come from anyone, and the
actions of other productions can execute any Soar command.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np

from agents.mario.agent import SarsaOptions, Seed, SeededAgent
from agents.soar.kernel import Kernel, SoarLink, require_soar
from agents.soar.mario_link import MarioLink
from agents.soar.task_link import TaskLink
from glue.errors import ConfigError, SaveError
from glue.options import Option
from glue.saves import Saved, pack, unpack
from glue.taskspec import TaskSpec, parse_task_spec
from glue.types import Action, Observation

PRODUCTIONS: Final = Path(__file__).parent / "productions"
"""The folder of the productions that come with this package."""

MaxCycles = Annotated[
    int, Option("decision cycles that a step may take before the agent counts as stuck", low=1, high=100_000)
]

_EXPLORATION: Final = ("epsilon", "temperature")
_MAX_RULES: Final = 1_000_000
_RULE: Final = re.compile(
    r"sp \{(?P<name>[^\s{}|\"]+)\n"
    r"(?P<conditions>(?:    +[^\n]*\n)+?)"
    r"    -->\n"
    r"    \(<[\w*-]+> \^operator <[\w*-]+> = -?\d+\.\d+\)\n"
    r"\}\s*"
)
_QUOTED: Final = re.compile(r"\|[^|{}\n]*\|")


class SoarPlayer(SeededAgent):
    """An agent made of Soar productions.

    Args:
        productions: the file to load.
        max_cycles: maximum number of decision cycles in a step.
        seed: a seed to use instead of the experiment's; None to use the experiment's.

    Raises:
        ConfigError: soar-sml is not installed, or there is no such file.
    """

    def __init__(self, productions: Path, max_cycles: int, seed: int | None) -> None:
        require_soar()
        if not productions.is_file():
            raise ConfigError(f"there is no file of productions {str(productions)!r}")
        self._productions = productions
        self._max_cycles = max_cycles
        super().__init__(seed)
        self._task: TaskSpec | None = None
        self._kernel: Kernel | None = None
        self._link: SoarLink | None = None
        self._episodes = 0
        self._cycles = 0

    def _new_link(self, kernel: Kernel, task: TaskSpec) -> SoarLink:
        """Return the input and output links for a task.

        Raises:
            ConfigError: this agent does not play the task.
        """
        return TaskLink(kernel, task)

    def _commands(self) -> Iterable[str]:
        """Return the commands that apply the agent's options, once the productions have been loaded."""
        return ()

    def agent_init(self, task_spec: str) -> None:
        """Forget everything, and load the productions into a new kernel.

        Raises:
            ConfigError: the productions do not load, or the task does not fit.
            TaskSpecError: the task spec does not parse.
        """
        self._task = parse_task_spec(task_spec)
        self._new_kernel()
        self._episodes = self._cycles = 0

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; nothing more is learned from a truncated one (cut off).

        Raises:
            SoarError: the agent does not act. All other calls raise it, too.
        """
        kernel, link = self._connected()
        self._reinitialize(kernel)
        self._episodes += 1
        words = np.random.SeedSequence((self._seed, self._episodes)).generate_state(1)
        kernel.command(f"decide srand {int(words[0])}")
        link.begin(observation)
        return link.action(*kernel.run())

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from the reward and choose the next action."""
        kernel, link = self._connected()
        link.see(reward, observation)
        return link.action(*kernel.run())

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward."""
        kernel, link = self._connected()
        link.end(reward)
        kernel.run_cycle()
        self._reinitialize(kernel)

    def agent_cleanup(self) -> None:
        """Close the kernel, and lose everything learned."""
        if self._kernel is not None:
            self._kernel.close()
        self._kernel = self._link = None

    def agent_message(self, message: str) -> str:
        """Answer `values`, the number of learned values, `cycles`, that of decision cycles, and `epsilon`."""
        if self._kernel is not None:
            if message == "values":
                return str(len(parse_rules(self._kernel.value_rules())))
            if message == "cycles":
                return str(self._cycles + self._kernel.cycles)
            if message == "epsilon":
                return repr(self._exploration(self._kernel)[0])
        return f"agent {self.name} answers, after its init, only the messages values, cycles and epsilon"

    def agent_save(self) -> bytes:
        """Return the learned values as productions, with the counters.

        Soar prints values to six decimals. The agent itself continues from the saved values, so that an agent
        that loads them continues in the same way.
        """
        kernel, _ = self._connected()
        self._reinitialize(kernel)
        saved = Saved(
            self.name,
            {},
            {"seed": self._seed, "episodes": self._episodes, "cycles": self._cycles},
            {
                "exploration": np.array(self._exploration(kernel)),
                "rules": _text_array(kernel.value_rules()),
                "once": _text_array("\n".join(sorted(kernel.once))),
            },
        )
        self._restore(saved)
        return pack(saved)

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned.

        Raises:
            SaveError: `data` is damaged, or of another agent, or holds anything except rules for values.
        """
        self._connected()
        self._restore(unpack(data, self.name, {}))

    def _connected(self) -> tuple[Kernel, SoarLink]:
        if self._kernel is None or self._link is None:
            raise ConfigError(f"agent {self.name} needs agent_init first")
        return self._kernel, self._link

    def _reinitialize(self, kernel: Kernel) -> None:
        if kernel.cycles:
            self._cycles += kernel.cycles
            kernel.reinitialize()

    def _exploration(self, kernel: Kernel) -> list[float]:
        return [float(kernel.command(f"decide indifferent-selection --{name}")) for name in _EXPLORATION]

    def _restore(self, saved: Saved) -> None:
        """Continue from a saved state, in a new kernel.

        Soar's order of equal choices depends on everything that its kernel has seen.
        """
        exploration = saved.array("exploration", np.float64, low=0.0).tolist()
        if len(exploration) != len(_EXPLORATION):
            raise SaveError(f"saved {self.name}: exploration must have {len(_EXPLORATION)} numbers")
        rules = parse_rules(_text(saved, "rules"))
        once = _text(saved, "once").split("\n")
        seed, episodes, cycles = (saved.number(name) for name in ("seed", "episodes", "cycles"))
        kernel = self._new_kernel()
        kernel.once.update(once)
        kernel.command("production excise --rl")
        for rule in reversed(rules):  # Soar prints the newest first
            kernel.command(rule)
        for name, number in zip(_EXPLORATION, exploration, strict=True):
            kernel.command(f"decide indifferent-selection --{name} {number!r}")
        self._seed, self._episodes, self._cycles = seed, episodes, cycles

    def _new_kernel(self) -> Kernel:
        """Return a new kernel with only the productions, in place of the old one."""
        assert self._task is not None
        self.agent_cleanup()
        kernel = self._kernel = Kernel(self.name, self._max_cycles)
        kernel.source(self._productions)
        for line in ("rl --set learning on", *self._commands()):
            kernel.command(line)
        self._link = self._new_link(kernel, self._task)
        return kernel


def _text_array(text: str) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
    return np.frombuffer(text.encode(), np.int8)


def _text(saved: Saved, name: str) -> str:
    try:
        return saved.array(name, np.int8).tobytes().decode()
    except UnicodeDecodeError:
        raise SaveError(f"saved {saved.player}: {name} is not a text") from None


def parse_rules(text: str) -> list[str]:
    """Return the rules of a text as commands, one `sp { ... }` each, in the order of the text.

    Raises:
        SaveError: the text holds anything else.
    """
    rules: list[str] = []
    end = 0
    text = text.strip()
    while end < len(text):
        match = _RULE.match(text, end)
        if match is None or len(rules) == _MAX_RULES or not _is_balanced(match["conditions"]):
            raise SaveError(
                f"saved rules: rule {len(rules) + 1} is not one that holds a value: {text[end : end + 200]!r}"
            )
        rules.append(match.group().strip())
        end = match.end()
    return rules


def _is_balanced(conditions: str) -> bool:
    """Return whether the braces of conditions are balanced, and none closes the production."""
    if "-->" in conditions:
        return False
    depth = 0
    for character in _QUOTED.sub("", conditions):
        depth += {"{": 1, "}": -1}.get(character, 0)
        if depth < 0 or character in '|"':
            return False
    return depth == 0


class SoarAgent(SoarPlayer):
    """Your own Soar productions, in any task; docs/soar.md describes the input link."""

    name = "soar"

    def __init__(
        self,
        *,
        productions: Annotated[str, Option("file of Soar productions (.soar) to load")] = "",
        max_cycles: MaxCycles = 100,
        seed: Seed = None,
    ) -> None:
        if not productions:
            raise ConfigError(
                "agent soar needs productions, the file of its Soar productions (.soar)",
                settings=("productions",),
            )
        super().__init__(Path(productions), max_cycles, seed)


class SoarMinesAgent(SoarPlayer):
    """An example of a Soar agent: it learns the way across the mines."""

    name = "soar-mines"

    def __init__(self, *, max_cycles: MaxCycles = 100, seed: Seed = None) -> None:
        super().__init__(PRODUCTIONS / "mines.soar", max_cycles, seed)


class SoarHierarchicalAgent(SoarPlayer):
    """Experiment 5 on the Soar kernel: two levels; the order of the operators is learned.

    Its productions, like those of every agent below, are in the file of its name.
    """

    name = "soar-hierarchical"

    @dataclass(frozen=True, kw_only=True)
    class Options(SarsaOptions):
        max_cycles: MaxCycles = 100

    def __init__(self, **options: Any) -> None:
        self._options = self.Options(**options)
        file = PRODUCTIONS / "mario" / f"{self.name.removeprefix('soar-')}.soar"
        super().__init__(file, self._options.max_cycles, self._options.seed)

    def _commands(self) -> Iterable[str]:
        options = self._options
        return (
            f"rl --set learning-rate {options.step_size!r}",
            f"rl --set discount-rate {options.discount!r}",
            f"decide indifferent-selection --epsilon {options.epsilon!r}",
            f"decide indifferent-selection --reduction-rate epsilon exponential {options.reduction!r}",
        )

    def _new_link(self, kernel: Kernel, task: TaskSpec) -> SoarLink:
        self._check_task(task.version, str(task))
        return MarioLink(kernel, task)


class SoarHierarchicalProgrammedAgent(SoarHierarchicalAgent):
    """Experiment 4 on the Soar kernel: two levels; the order of the operators is programmed."""

    name = "soar-hierarchical-programmed"


class SoarHierarchicalFactsAgent(SoarHierarchicalAgent):
    """Experiment 6 on the Soar kernel: as 5, and what lies above a reachable platform is reachable."""

    name = "soar-hierarchical-facts"


class SoarHierarchicalInternalAgent(SoarHierarchicalAgent):
    """Experiment 7 on the Soar kernel: as 6, but keystrokes are rewarded for their operator's goal."""

    name = "soar-hierarchical-internal"


class SoarObjectsCoarseAgent(SoarHierarchicalAgent):
    """Experiment 8 on the Soar kernel: as 6, but a keystroke's value is a sum over objects of a kind."""

    name = "soar-objects-coarse"


class SoarFlatAgent(SoarHierarchicalAgent):
    """Experiment 3 on the Soar kernel: one level; a state is all objects that are related to Mario."""

    name = "soar-flat"

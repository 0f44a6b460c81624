"""The agents made of Soar productions, by name: those of Mohan (2010), one for mines, and the user's own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from agents.mario.agent import SarsaOptions, Seed
from agents.soar.kernel import Kernel, SoarLink
from agents.soar.mario_link import MarioLink
from agents.soar.player import PRODUCTIONS, MaxCycles, SoarPlayer
from agents.soar.task_link import TaskLink
from glue.errors import ConfigError
from glue.options import Option
from glue.taskspec import MARIO, TaskSpec


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

    def _new_link(self, kernel: Kernel, task: TaskSpec) -> SoarLink:
        return TaskLink(kernel, task)


class SoarMinesAgent(SoarPlayer):
    """An example of a Soar agent: it learns the way across the mines."""

    name = "soar-mines"

    def __init__(self, *, max_cycles: MaxCycles = 100, seed: Seed = None) -> None:
        super().__init__(PRODUCTIONS / "mines.soar", max_cycles, seed)

    def _new_link(self, kernel: Kernel, task: TaskSpec) -> SoarLink:
        return TaskLink(kernel, task)


class SoarHierarchicalAgent(SoarPlayer):
    """Experiment 5 on the Soar kernel: two levels; the order of the operators is learned."""

    name = "soar-hierarchical"
    _file: ClassVar[str] = "hierarchical.soar"

    @dataclass(frozen=True, kw_only=True)
    class Options(SarsaOptions):
        max_cycles: MaxCycles = 100

    def __init__(self, **options: Any) -> None:
        self._options = self.Options(**options)
        file = PRODUCTIONS / "mario" / self._file
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
        if task.version != MARIO:
            raise ConfigError(
                f"agent {self.name} plays Infinite Mario only, whose task spec begins VERSION {MARIO}; "
                f"it received {str(task)!r:.80}: use it with the environment mario"
            )
        return MarioLink(kernel, task)


class SoarHierarchicalProgrammedAgent(SoarHierarchicalAgent):
    """Experiment 4 on the Soar kernel: two levels; the order of the operators is programmed."""

    name = "soar-hierarchical-programmed"
    _file = "hierarchical-programmed.soar"


class SoarHierarchicalFactsAgent(SoarHierarchicalAgent):
    """Experiment 6 on the Soar kernel: as 5, and what lies above a reachable platform is reachable."""

    name = "soar-hierarchical-facts"
    _file = "hierarchical-facts.soar"


class SoarHierarchicalInternalAgent(SoarHierarchicalAgent):
    """Experiment 7 on the Soar kernel: as 6, but keystrokes are rewarded for their operator's goal."""

    name = "soar-hierarchical-internal"
    _file = "hierarchical-internal.soar"


class SoarObjectsCoarseAgent(SoarHierarchicalAgent):
    """Experiment 8 on the Soar kernel: as 6, but a keystroke's value is a sum over objects of a kind."""

    name = "soar-objects-coarse"
    _file = "objects-coarse.soar"


class SoarFlatAgent(SoarHierarchicalAgent):
    """Experiment 3 on the Soar kernel: one level; a state is all objects that are related to Mario."""

    name = "soar-flat"
    _file = "flat.soar"

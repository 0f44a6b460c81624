"""The two-level object-oriented agents: experiments 4 to 8.

At the top a functional-level operator (FLO) is chosen, a task tied to one object; inside it, step by
step, keystroke-level operators (KLO). Both levels learn by SARSA. A visit to an FLO is a small
episode of its own: its last KLO is updated with the reward alone. The FLO level learns from the sum
of the rewards between two choices of a learned FLO, undiscounted, except for the unlearned FLOs
(move-to-goal, avoid-pit) chosen in between: each discounts everything after it.
Source: Mohan (2010), sections 6 and 7; what the paper leaves open is listed in docs/agents.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

from agents.mario.monsters import THREATS_2010, THREATS_2012
from agents.mario.options import Discount, Epsilon, Reduction, Seed, StepSize
from agents.mario.scene import set_senses
from agents.mohan2010 import flo
from agents.mohan2010.learner import Grid, Learning, MarioLearner
from agents.mohan2010.levels import Memory, end, step
from glue.compiled.records import Array, new
from glue.options import Option
from glue.saves import Setting

__all__ = [
    "HierarchicalAgent",
    "HierarchicalFactsAgent",
    "HierarchicalInternalAgent",
    "HierarchicalProgrammedAgent",
    "ObjectsCoarseAgent",
]

TileAbove = Annotated[bool, Option("whether KLO values depend on the tile above (author's agents: yes)")]


class HierarchicalAgent(MarioLearner):
    """Experiment 5: the FLO is chosen by learned values; avoid-pit still comes first, move-to-goal last."""

    name = "hierarchical"
    _step = step
    _end = end

    _ranks: ClassVar[Sequence[int]] = flo.LEARNED
    _context: ClassVar[bool] = True
    _via_platforms: ClassVar[bool] = False
    _threats: ClassVar[tuple[int, int, int, int]] = THREATS_2010
    _absolute_motion: ClassVar[bool] = False
    _sum_objects: ClassVar[bool] = False

    def __init__(
        self,
        *,
        step_size: StepSize = 0.3,
        discount: Discount = 0.9,
        epsilon: Epsilon = 0.1,
        reduction: Reduction = 0.9999,
        grid: Grid = 2,
        tile_above: TileAbove = False,
        learning: Learning = True,
        seed: Seed = None,
    ) -> None:
        super().__init__(
            step_size=step_size,
            discount=discount,
            epsilon=epsilon,
            reduction=reduction,
            learning=learning,
            seed=seed,
        )
        self._grid = grid
        self._tile_above = tile_above

    def _settings(self) -> Mapping[str, Setting]:
        return {"grid": self._grid, "tile_above": self._tile_above}

    def _new_memory(self) -> Array:
        memories = new(Memory)
        design = memories["design"]
        design["ranks"] = self._ranks
        design["context"] = self._context
        design["sum_objects"] = self._sum_objects
        design["tile_above"] = self._tile_above
        set_senses(design["senses"], self._grid, self._threats, self._absolute_motion, self._via_platforms)
        return memories


class HierarchicalProgrammedAgent(HierarchicalAgent):
    """Experiment 4: the FLOs have a programmed order; values choose among those of one kind."""

    name = "hierarchical-programmed"
    _ranks = flo.PROGRAMMED
    _context = False


class HierarchicalFactsAgent(HierarchicalAgent):
    """Experiment 6: as 5, and whatever lies above a reachable platform is reachable."""

    name = "hierarchical-facts"
    _via_platforms = True


class HierarchicalInternalAgent(HierarchicalFactsAgent):
    """Experiment 7: as 6, but KLOs are rewarded for their FLO's goal, not by the environment."""

    name = "hierarchical-internal"

    def __init__(
        self,
        *,
        step_size: StepSize = 0.3,
        discount: Discount = 0.9,
        epsilon: Epsilon = 0.1,
        reduction: Reduction = 0.9999,
        internal_step: Annotated[float, Option("KLO's reward for a step (author's agent: -0.01)")] = -0.01,
        internal_goal: Annotated[float, Option("KLO's reward for the FLO's goal (author's agent: 1)")] = 1.0,
        internal_death: Annotated[float, Option("KLO's reward for dying (author's agent: -10)")] = -10.0,
        grid: Grid = 2,
        tile_above: TileAbove = False,
        learning: Learning = True,
        seed: Seed = None,
    ) -> None:
        super().__init__(
            step_size=step_size,
            discount=discount,
            epsilon=epsilon,
            reduction=reduction,
            grid=grid,
            tile_above=tile_above,
            learning=learning,
            seed=seed,
        )
        self._internal = {
            "internal": True,
            "internal_step": internal_step,
            "internal_goal": internal_goal,
            "internal_death": internal_death,
        }

    def _new_memory(self) -> Array:
        memories = super()._new_memory()
        for name, value in self._internal.items():
            memories["design"][name] = value
        return memories


class ObjectsCoarseAgent(HierarchicalFactsAgent):
    """Experiment 8: as 6, but a KLO's value is a sum over all objects of its FLO's kind."""

    name = "objects-coarse"
    _threats = THREATS_2012
    _absolute_motion = True
    _sum_objects = True

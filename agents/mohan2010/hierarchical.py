"""The two-level object-oriented agents: experiments 4 to 8.

At the top a functional-level operator (FLO) is chosen, a task tied to one object; inside it, step by
step, keystroke-level operators (KLO). Both levels learn by SARSA. A visit to an FLO is a small
episode of its own: its last KLO is updated only with the reward. The FLO level learns from the sum
of the rewards between two choices of a learned FLO, undiscounted, except for the unlearned FLOs
(move-to-goal, avoid-pit) chosen in between: each discounts everything after it.
Source: Mohan (2010), sections 6 and 7; docs/agents.md lists the points that the paper leaves open.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from agents.mario.monsters import THREATS_2010, THREATS_2012
from agents.mario.scene import set_senses
from agents.mohan2010 import flo
from agents.mohan2010.learner import MarioLearner, ObjectOptions
from agents.mohan2010.levels import Memory, end, step
from glue.compiled.records import Array, new
from glue.options import Option
from glue.saves import Setting


class HierarchicalAgent(MarioLearner):
    """Experiment 5: the FLO is chosen by learned values; avoid-pit still comes first, move-to-goal last."""

    @dataclass(frozen=True, kw_only=True)
    class Options(ObjectOptions):
        tile_above: Annotated[
            bool, Option("whether KLO values depend on the tile above (author's agents: yes)")
        ] = False

    _options: Options

    name = "hierarchical"
    _step = step
    _end = end

    _ranks: ClassVar[Sequence[int]] = flo.LEARNED
    _context: ClassVar[bool] = True
    _via_platforms: ClassVar[bool] = False
    _threats: ClassVar[tuple[int, int, int, int]] = THREATS_2010
    _absolute_motion: ClassVar[bool] = False
    _sum_objects: ClassVar[bool] = False

    def _settings(self) -> Mapping[str, Setting]:
        return {"grid": self._options.grid, "tile_above": self._options.tile_above}

    def _new_memory(self) -> Array:
        memories = new(Memory)
        design = memories["design"]
        design["ranks"] = self._ranks
        design["context"] = self._context
        design["sum_objects"] = self._sum_objects
        design["tile_above"] = self._options.tile_above
        set_senses(
            design["senses"], self._options.grid, self._threats, self._absolute_motion, self._via_platforms
        )
        return memories


class HierarchicalProgrammedAgent(HierarchicalAgent):
    """Experiment 4: the FLOs have a programmed order; values choose among those of one kind."""

    name = "hierarchical-programmed"
    _ranks = flo.PROGRAMMED
    _context = False


class HierarchicalFactsAgent(HierarchicalAgent):
    """Experiment 6: as 5, and everything above a reachable platform is reachable."""

    name = "hierarchical-facts"
    _via_platforms = True


class HierarchicalInternalAgent(HierarchicalFactsAgent):
    """Experiment 7: as 6, but KLOs are rewarded for their FLO's goal, not by the environment."""

    @dataclass(frozen=True, kw_only=True)
    class Options(HierarchicalAgent.Options):
        internal_step: Annotated[float, Option("KLO's reward for a step (author's agent: -0.01)")] = -0.01
        internal_goal: Annotated[float, Option("KLO's reward for the FLO's goal (author's agent: 1)")] = 1.0
        internal_death: Annotated[float, Option("KLO's reward for dying (author's agent: -10)")] = -10.0

    _options: Options

    name = "hierarchical-internal"

    def _new_memory(self) -> Array:
        memories = super()._new_memory()
        design, options = memories["design"], self._options
        design["internal"] = True
        design["internal_step"] = options.internal_step
        design["internal_goal"] = options.internal_goal
        design["internal_death"] = options.internal_death
        return memories


class ObjectsCoarseAgent(HierarchicalFactsAgent):
    """Experiment 8: as 6, but a KLO's value is a sum over all objects of its FLO's kind."""

    name = "objects-coarse"
    _threats = THREATS_2012
    _absolute_motion = True
    _sum_objects = True

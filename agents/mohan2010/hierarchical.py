"""The two-level object-oriented agents, experiments 4 to 8, and their compiled code.

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

import numpy as np

from agents import sarsa
from agents.mario.agent import NUM_ACTIONS
from agents.mario.objects import (
    MAX_OBJECTS,
    THREATS_2010,
    THREATS_2012,
    Object,
    Scene,
    Senses,
    forget_monsters,
    look,
    set_senses,
    tile_above,
)
from agents.mohan2010 import flo
from agents.mohan2010.learner import FULL, MALFORMED, MarioLearner, ObjectOptions
from agents.sarsa import Keys, Learner, Taken, Values, epsilon_greedy, extend, feature
from glue.compiled.jit import entry, jit
from glue.compiled.records import Array, Flag, Int, Real, new
from glue.options import Option
from glue.saves import Setting


class Design:
    """The parameters that differ between experiments; see the classes of `agents.mohan2010.hierarchical`."""

    senses: Annotated[Senses, Senses]
    ranks: Annotated[flo.Numbers, np.int64, 4]
    context: Flag
    sum_objects: Flag
    tile_above: Flag
    internal: Flag
    internal_step: Real
    internal_goal: Real
    internal_death: Real


class Memory:
    """The working memory of a hierarchical agent.

    current, current_id  the running FLO and the id of its object; NONE at the start of an episode
    last_klo             the last KLO, without features in an FLO that does not learn
    last_flo             the last learned FLO, to be updated next
    flo_return           the rewards since it was chosen, each times the weight at its time
    weight               the discount to the power of the number of unlearned FLOs chosen since
    """

    design: Annotated[Design, Design]
    scene: Annotated[Scene, Scene]
    current: Int
    current_id: Int
    last_klo: Annotated[Taken, Taken]
    last_flo: Annotated[Taken, Taken]
    flo_return: Real
    weight: Real
    # scratch space
    kept: Annotated[flo.Numbers, np.int64, MAX_OBJECTS]
    flo_values: Annotated[Values, np.float64, MAX_OBJECTS]
    flo_keys: Annotated[Keys, np.uint64, 2]
    klo_values: Annotated[Values, np.float64, NUM_ACTIONS]
    states: Annotated[Keys, np.uint64, sarsa.MAX_FEATURES]
    state_count: Int


@entry
def step(learners: Array, table: Array, memories: Array, body: bytes, reward: float, begins: bool) -> int:
    """Learn from the reward, and return the KLO to send; or FULL or MALFORMED."""
    learner = learners[0]
    memory = memories[0]
    scene = memory.scene
    if not sarsa.has_room(learner, table, sarsa.MAX_FEATURES + 2):
        return FULL
    if begins:
        _forget(memory)
    if not look(scene, memory.design.senses, body):
        return MALFORMED

    count = flo.keep_preferred(scene, memory.design.ranks, memory.kept)
    which = flo.find(scene, memory.kept, count, memory.current, memory.current_id)
    goes_on = which != flo.NONE or (count == 0 and memory.current == flo.MOVE_TO_GOAL)
    memory.flo_return += memory.weight * reward
    if goes_on:
        action = _choose_klo(learner, table, memory, which)
        target = _klo_reward(memory, reward) + learner.discount * memory.klo_values[action]
        sarsa.update(learner, table, memory.last_klo, target)
    else:
        sarsa.update(learner, table, memory.last_klo, _last_klo_reward(memory, reward))
        which = _choose_flo(learner, table, memory, count)
        action = _choose_klo(learner, table, memory, which)
    sarsa.take(memory.last_klo, memory.states, memory.state_count, action)
    if learner.learning:
        learner.cycles += 1 if goes_on else 3
    return action


@entry
def end(learners: Array, table: Array, memories: Array, reward: float) -> None:
    """Learn from the last reward of an episode, at both levels."""
    learner = learners[0]
    memory = memories[0]
    memory.flo_return += memory.weight * reward
    sarsa.update(learner, table, memory.last_klo, _terminal_klo_reward(memory, reward))
    sarsa.update(learner, table, memory.last_flo, memory.flo_return)
    _forget(memory)


@jit
def _forget(memory: Memory) -> None:
    forget_monsters(memory.scene)
    memory.current = flo.NONE
    memory.last_klo.count = 0
    memory.last_flo.count = 0


# The functional level


@jit
def _choose_flo(learner: Learner, table: Array, memory: Memory, count: int) -> int:
    """Open an FLO; return the index of its object, or NONE for move-to-goal.

    If the FLO is learned, the learned FLO before it is updated.
    """
    scene = memory.scene
    if count == 0:
        memory.current = flo.MOVE_TO_GOAL
        memory.weight *= learner.discount
        return flo.NONE
    bits = flo.context(scene)
    for i in range(count):
        keys = _flo_features(memory, scene.objects[memory.kept[i]], bits)
        memory.flo_values[i] = sarsa.sum_of_values(table, memory.flo_keys, keys)
    chosen = epsilon_greedy(learner, memory.flo_values, count)
    which = memory.kept[chosen]
    thing = scene.objects[which]
    memory.current = thing.kind
    memory.current_id = thing.id
    if flo.is_learned(thing.kind):
        target = memory.flo_return + memory.weight * learner.discount * memory.flo_values[chosen]
        sarsa.update(learner, table, memory.last_flo, target)
        memory.last_flo.count = _flo_features(memory, thing, bits)
        for i in range(memory.last_flo.count):
            memory.last_flo.keys[i] = memory.flo_keys[i]
        memory.flo_return = 0.0
        memory.weight = 1.0
    else:
        memory.weight *= learner.discount
    return int(which)


@jit
def _flo_features(memory: Memory, thing: Object, bits: int) -> int:
    """Fill in the keys of an FLO's values, that of its object and that of its context; return how many."""
    if not flo.is_learned(thing.kind):
        return 0
    memory.flo_keys[0] = flo.describe(flo.FLO_LEVEL, thing)
    memory.flo_keys[1] = extend(extend(feature(flo.CONTEXT), thing.kind), bits)
    return 2 if memory.design.context else 1


# The keystroke level


@jit
def _choose_klo(learner: Learner, table: Array, memory: Memory, which: int) -> int:
    """Choose a KLO in the FLO for an object (NONE: move-to-goal), and record the KLO's features."""
    memory.state_count = 0
    if memory.current == flo.MOVE_TO_GOAL:
        return flo.move_right(memory.scene.screen)
    if memory.current == flo.AVOID_PIT:
        return flo.jump_the_pit()
    if memory.design.sum_objects:
        for i in range(memory.scene.count):
            if memory.scene.objects[i].kind == memory.current and memory.state_count < len(memory.states):
                _add_state(memory, memory.scene.objects[i])
    else:
        _add_state(memory, memory.scene.objects[which])
    sarsa.action_values(table, memory.states, memory.state_count, memory.klo_values)
    return epsilon_greedy(learner, memory.klo_values, NUM_ACTIONS)


@jit
def _add_state(memory: Memory, thing: Object) -> None:
    """Add the key of one object as the keystroke level sees it."""
    screen = memory.scene.screen
    state = extend(flo.describe(flo.KLO_LEVEL, thing), screen.mario.kind)
    if memory.design.tile_above:
        state = extend(state, tile_above(screen))
    memory.states[memory.state_count] = state
    memory.state_count += 1


@jit
def _klo_reward(memory: Memory, reward: float) -> float:
    """Return the reward of a KLO whose FLO continues."""
    return memory.design.internal_step if memory.design.internal else reward


@jit
def _last_klo_reward(memory: Memory, reward: float) -> float:
    """Return the reward of the last KLO of an FLO, before the next FLO is chosen."""
    design = memory.design
    if not design.internal:
        return reward
    if flo.is_learned(memory.current) and flo.goal_reached(
        memory.scene, memory.current, memory.current_id, design.senses.grid
    ):
        return design.internal_step + design.internal_goal
    return design.internal_step


@jit
def _terminal_klo_reward(memory: Memory, reward: float) -> float:
    """Return the reward of the last KLO of an episode; a reward that is not negative means the finish."""
    if not memory.design.internal:
        return reward
    return memory.design.internal_death if reward < 0.0 else 0.0


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

"""Games stepped as Gymnasium wants them: episodes that end, are cut off and begin anew, in one compiled call.

`Games` holds N games with what a learner is shown of them. Nothing of it depends on how many games there are
or on how many threads step them.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

import numpy as np
import numpy.typing as npt

from env_server.gym.views import VIEWS, write_view
from env_server.mario.environment import check_parameters
from env_server.mario.level_sets import DIFFICULTIES, TYPES, level_seed, resolve_levels, splitmix
from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.reward import ordinary_reward, terminal_reward
from env_server.mario.sim.state import WORLD, World, Worlds
from env_server.mario.sim.step import act, begin
from env_server.mario.threads import Threads
from glue.compiled.jit import announce_compilation, entry, jit
from glue.compiled.records import Array, Flag, Int, Real, Word, layout
from glue.compiled.turns import Gate, begin_turn, end_turn
from glue.errors import ConfigError
from glue.types import Observation

__all__ = ["DISABLED", "INFOS", "NEXT_STEP", "SAME_STEP", "Games"]

NEXT_STEP: Final = 0
SAME_STEP: Final = 1
DISABLED: Final = 2

INFOS: Final = ("timeout", "goal", "level_seed", "level_type", "level_difficulty")
"""What an info says, in this order: whether the step limit or the goal ended the episode, and the level."""
_MAX_STEPS: Final = 2**31 - 1

# What a call can order of a game: an action, by its number, or one of these.
_BEGIN: Final = -1
_LEAVE: Final = -2

Bytes = npt.NDArray[np.uint8]
Reals = npt.NDArray[np.float32]


class Lane:
    """What a game needs beyond its world."""

    key: Word  # which levels its episodes are played on, with `episode`
    episode: Int  # how many have begun since the seed
    begun: Flag
    over: Flag  # the episode has ended or was cut off
    reward: Real
    terminated: Flag
    truncated: Flag
    info: Annotated[npt.NDArray[np.int64], np.int64, 5]
    final_info: Annotated[npt.NDArray[np.int64], np.int64, 5]


class Setup:
    """What is the same for all games."""

    view_number: Int  # of `View`
    mode: Int
    max_steps: Int
    first_level: Int
    levels: Int  # 0: the task's own level
    level_type: Int  # -1: as the level's number says
    level_difficulty: Int


class Games:
    """N games of a task.

    Args:
        count: N.
        view: the name of a view.
        mode: NEXT_STEP, SAME_STEP or DISABLED.
        threads: how many threads step them.
        max_episode_steps: steps after which an episode is cut off; None for no such limit.
        levels, num_levels, start_level: see `env_server.mario.level_sets`.
        options: of `InfiniteMario`.

    Attributes:
        cells, reals: what is shown, shapes (N, bytes) and (N, reals) of the view.
        final_cells, final_reals: with SAME_STEP, what was shown last of episodes that are over.
        lanes: shape (N,); see `Lane`.

    Raises:
        ConfigError, SimulatorError: an argument is out of bounds, or two contradict each other.
    """

    def __init__(
        self,
        count: int,
        view: str,
        mode: int,
        threads: int,
        max_episode_steps: int | None,
        levels: str | None,
        num_levels: int | None,
        start_level: int | None,
        options: dict[str, Any],
    ) -> None:
        if view not in tuple(VIEWS):  # it may be of any type
            raise ConfigError(f"observation is one of {', '.join(VIEWS)}, not {view!r:.80}")
        if max_episode_steps is not None and not 1 <= max_episode_steps <= _MAX_STEPS:
            raise ConfigError(f"max_episode_steps must be from 1 to {_MAX_STEPS}, not {max_episode_steps}")
        chosen = resolve_levels(levels, num_levels, start_level)
        if chosen is not None and "level_seed" in options:
            raise ConfigError("level_seed is one level: leave it out, or levels, num_levels and start_level")
        options = {name: _plain(value) for name, value in options.items()}
        task = check_parameters(options)
        shape = VIEWS[view]
        self.lanes: Array = np.zeros(count, layout(Lane))
        self._setup: Array = np.zeros(1, layout(Setup))
        setup = self._setup
        setup["view_number"] = shape.number
        setup["mode"] = mode
        setup["max_steps"] = max_episode_steps or _MAX_STEPS
        if chosen is not None:
            setup["first_level"], setup["levels"] = chosen.start, len(chosen)
        for name in ("level_type", "level_difficulty"):
            setup[name] = options.get(name, -1)
        self.worlds: Worlds = np.zeros(count, WORLD)
        for i in range(count):
            task.write_to(self.worlds[i])
        self.task = task
        self.cells: Bytes = np.zeros((count, shape.bytes), np.uint8)
        self.reals: Reals = np.zeros((count, shape.reals), np.float32)
        finals = count if mode == SAME_STEP else 0
        self.final_cells: Bytes = np.zeros((finals, shape.bytes), np.uint8)
        self.final_reals: Reals = np.zeros((finals, shape.reals), np.float32)
        self._orders = np.zeros(count, np.int8)
        self._threads = Threads(threads, count)
        self._load()

    def __len__(self) -> int:
        return len(self.lanes)

    def close(self) -> None:
        """End the threads."""
        self._threads.close()

    def seed(self, i: int, key: int) -> None:
        """Forget everything that earlier episodes of game `i` left behind; `key` chooses its levels."""
        self.worlds[i] = np.zeros((), WORLD)
        self.task.write_to(self.worlds[i])
        self.lanes[i] = np.zeros((), self.lanes.dtype)
        self.lanes["key"][i] = key

    def reset(self, which: npt.NDArray[np.bool_]) -> None:
        """Begin an episode in the games that `which`, shape (N,), chooses."""
        self._orders[:] = np.where(which, _BEGIN, _LEAVE)
        self._run()

    def step(self, actions: npt.NDArray[np.int64], choices: npt.NDArray[np.int64]) -> int:
        """Carry out an action in every game.

        Args:
            actions: shape (N, K): direction, jump and run, or their number; see `env_server.gym.spaces`.
            choices: how many there are of each, shape (K,).

        Returns:
            -1; or `i`, if game `i` has no episode to step in, or `N + i`, if it has no such action. Then no
            game was stepped.
        """
        refused = int(_order(actions, choices, self.lanes, self._setup, self._orders))
        if refused < 0:
            self._run()
        return refused

    def observation(self, i: int) -> Observation:
        """Return game `i` as an RL-Glue agent would see it now."""
        body = np.zeros(BODY_SIZE, np.uint8)
        return Observation.from_body(body[: _body(self.worlds[i : i + 1], body)].tobytes())

    def _run(self) -> None:
        shown = (self.cells, self.reals, self.final_cells, self.final_reals)
        self._threads.run(_advance, self.worlds, self.lanes, self._setup, self._orders, *shown)

    def _load(self) -> None:
        """Load the compiled rules, or compile them and say so."""
        with announce_compilation("Infinite Mario for Gymnasium"):
            none = np.zeros((0, 1), np.int64), np.zeros(1, np.int64)
            _order(*none, self.lanes[:0], self._setup, self._orders)
            self._run()
            # An observation is asked for by `render` alone, which may compile when it comes to that.


def _plain(value: Any) -> Any:
    """Return one of NumPy's numbers as Python's, and anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


@jit
def _begin(world: World, lane: Lane, setup: Setup) -> None:
    """Begin the next episode of a game, on the level that is its turn."""
    if setup.levels > 0:
        draw = splitmix(lane.key + np.uint64(lane.episode))
        number = setup.first_level + int(draw % np.uint64(setup.levels))
        world.level_seed = level_seed(number)
        world.level_type = number % TYPES if setup.level_type < 0 else setup.level_type
        difficulty = number // TYPES % DIFFICULTIES
        world.level_difficulty = difficulty if setup.level_difficulty < 0 else setup.level_difficulty
    lane.episode += 1
    lane.begun = True
    lane.over = False
    begin(world)
    ordinary_reward(world)  # of the first check-in: noted as paid, although the agent does not receive it
    lane.info[0] = 0
    lane.info[1] = 0
    lane.info[2] = world.level_seed
    lane.info[3] = world.level_type
    lane.info[4] = world.level_difficulty


@entry
def _order(
    actions: npt.NDArray[np.int64],
    choices: npt.NDArray[np.int64],
    lanes: Array,
    setups: Array,
    orders: npt.NDArray[np.int8],
) -> int:
    """Order a step of every game, or return why not; see `Games.step`."""
    setup: Setup = setups[0]
    for i in range(len(lanes)):
        lane: Lane = lanes[i]
        if not lane.begun or (lane.over and setup.mode == DISABLED):
            return i
        number = 0
        for j in range(len(choices)):
            if not 0 <= actions[i, j] < choices[j]:
                return len(lanes) + i
            number = number * choices[j] + actions[i, j]
        orders[i] = number
    return -1


@entry
def _advance(
    gate: Gate,
    worker: int,
    worlds: Worlds,
    lanes: Array,
    setups: Array,
    orders: npt.NDArray[np.int8],
    cells: Bytes,
    reals: Reals,
    final_cells: Bytes,
    final_reals: Reals,
    first: int,
    last: int,
) -> None:
    """Do as ordered in the games from `first` up to `last`, whenever it is their turn.

    One function for all that can happen to a game, because the rules are compiled into each that calls them.
    """
    setup: Setup = setups[0]
    while begin_turn(gate, worker):
        for i in range(first, last):
            if orders[i] == _LEAVE:
                continue
            world: World = worlds[i]
            lane: Lane = lanes[i]
            begins = orders[i] == _BEGIN or (lane.over and setup.mode == NEXT_STEP)
            if begins:
                lane.reward = 0.0
                lane.terminated = False
                lane.truncated = False
            else:
                _act(world, lane, setup, orders[i])
                if lane.over and setup.mode == SAME_STEP:
                    if not lane.terminated:
                        write_view(world, setup.view_number, cells[i], reals[i])
                    final_cells[i] = cells[i]
                    final_reals[i] = reals[i]
                    lane.final_info[:] = lane.info
                    begins = True
            if begins:
                _begin(world, lane, setup)
            # The observation of a terminal step is the one before it, as in the original.
            if begins or not lane.terminated:
                write_view(world, setup.view_number, cells[i], reals[i])
        if end_turn(gate, worker):
            return


@jit
def _act(world: World, lane: Lane, setup: Setup, action: int) -> None:
    was_dying = world.death_timer > 0
    lane.terminated = not act(world, action // 4 - 1, action // 2 % 2, action % 2)
    if lane.terminated:
        lane.reward = terminal_reward(world)
        lane.info[1] = world.win_timer > 0
        lane.info[0] = world.win_timer == 0 and not was_dying and world.steps >= world.max_trial_steps
    else:
        lane.reward = ordinary_reward(world)
    lane.truncated = world.steps >= setup.max_steps  # as Gymnasium has it, even if the episode ended as well
    lane.over = lane.terminated or lane.truncated


@entry
def _body(worlds: Worlds, body: Bytes) -> int:
    world: World = worlds[0]
    return encode(world, body)

"""Many games: episodes that end, are cut off and begin again, in one compiled call.

`Games` holds N games and their views. A game depends neither on the others nor on the threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from env_server.mario.game import ordinary_reward, terminal_reward
from env_server.mario.level_sets import TYPES, LevelSet, level_seed, splitmix
from env_server.mario.many.views import View, write_view
from env_server.mario.observation import BODY_SIZE, COLUMNS_SHOWN, encode
from env_server.mario.parameters import Parameters
from env_server.mario.sim.state import LEVEL, WORLD, LevelMap, Levels, World, Worlds
from env_server.mario.sim.step import act, begin
from glue.closing import Closing
from glue.compiled.jit import announce_compilation, entry, jit
from glue.compiled.memory import copy_bytes, prefetch, uncounted
from glue.compiled.records import Array, Flag, Int, Real, Word, layout
from glue.compiled.threads import Gate, Threads, begin_turn, claim, end_turn, nothing
from glue.errors import SimulatorError
from glue.types import Observation

NEXT_STEP: Final = 0
SAME_STEP: Final = 1
DISABLED: Final = 2

INFOS: Final = ("timeout", "goal", "level_seed", "level_type", "level_difficulty")
"""The fields of an info, in order: whether the step limit or the goal ended the episode, and the level."""
MAX_STEPS: Final = 2**31 - 1
"""Steps of an episode that is never cut off."""

# The orders that a call can give a game: an action, by its number, or one of these.
_BEGIN: Final = -1
_LEAVE: Final = -2

Bytes = npt.NDArray[np.uint8]
Reals = npt.NDArray[np.float32]


class Lane:
    """The state of a game besides its world."""

    key: Word  # with `episode`, chooses the level of each episode
    episode: Int  # number of episodes begun since the seed
    place: Int  # index of its record of `levels`
    begun: Flag
    over: Flag  # the episode has ended or was cut off
    reward: Real
    terminated: Flag
    truncated: Flag
    info: Annotated[npt.NDArray[np.int64], np.int64, 5]
    final_info: Annotated[npt.NDArray[np.int64], np.int64, 5]


class Setup:
    """The settings common to all games."""

    view_number: Int  # of `View`
    mode: Int
    max_steps: Int
    first_level: Int
    levels: Int  # 0: the task's own level
    shared: Flag  # whether all games share one record for each level, made in advance
    difficulties: Int
    level_type: Int  # -1: that of the level's number
    level_difficulty: Int
    copies: Annotated[npt.NDArray[np.int64], np.int64, 2]  # addresses of copies of the views, or 0


# Records whose fields are attributes in uncompiled code, too.
_LANE: Final = np.dtype((np.record, layout(Lane)))
_SETUP: Final = np.dtype((np.record, layout(Setup)))

_FAR: Final = 2**18
"""Bytes of views beyond which threads copy their own: one thread would fetch them from the other's cache."""


class Games(Closing):
    """N games, each with a task. Close them at the end, or use them in a `with` statement.

    Args:
        tasks: one for each game; on `levels`, without the level of a file.
        view: the view of each game.
        mode: NEXT_STEP, SAME_STEP or DISABLED: when a game that is over begins its next episode.
        threads: threads that step the games.
        max_steps: steps after which an episode is cut off.
        levels: levels of the episodes; None for those of the tasks.
        level_type, level_difficulty: of all episodes on `levels`; -1 for those of the level's number.
        finals: whether to keep the last views of episodes that ended in the same step.

    Attributes:
        copies: whether `shown` returns copies; False at first.
        cells, reals: the current views, shapes (N, bytes) and (N, reals) of the view.
        final_cells, final_reals: the last views of episodes that are over.
        lanes: shape (N,); see `Lane`.
        levels: the levels of the set if they are no more than the games, which share them; else each game's.
    """

    def __init__(
        self,
        tasks: Sequence[Parameters],
        view: View,
        mode: int,
        *,
        threads: int = 1,
        max_steps: int = MAX_STEPS,
        levels: LevelSet | None = None,
        level_type: int = -1,
        level_difficulty: int = -1,
        finals: bool = False,
    ) -> None:
        count = len(tasks)
        self.lanes: Array = np.zeros(count, _LANE)
        self._setup: Array = np.zeros(1, _SETUP)
        setup = self._setup
        setup["view_number"], setup["mode"], setup["max_steps"] = view.number, mode, max_steps
        if levels is not None:
            setup["first_level"], setup["levels"] = levels.numbers.start, len(levels.numbers)
            setup["difficulties"] = levels.difficulties
        setup["level_type"], setup["level_difficulty"] = level_type, level_difficulty
        self.worlds: Worlds = np.zeros(count, WORLD)
        shared = levels is not None and len(levels.numbers) <= count
        self.levels: Levels = np.zeros(len(levels.numbers) if levels is not None and shared else count, LEVEL)
        pictures = {picture: picture.levels() for task in tasks if (picture := task.level) is not None}
        for place, task in enumerate(tasks):
            if task.level is not None:
                self.levels[place : place + 1] = pictures[task.level]
        self.set_tasks(tasks)
        self.cells: Bytes = np.zeros((count, view.bytes), np.uint8)
        self.reals: Reals = np.zeros((count, view.reals), np.float32)
        kept = count if finals else 0
        self.final_cells: Bytes = np.zeros((kept, view.bytes), np.uint8)
        self.final_reals: Reals = np.zeros((kept, view.reals), np.float32)
        self.copies = False
        self._far = threads > 1 and self.cells.nbytes + self.reals.nbytes > _FAR
        self.lanes["place"] = np.arange(count) % len(self.levels)
        self._orders = np.full(count, _LEAVE, np.int8)
        self._threads = Threads(1, count)
        self._load()
        if shared:
            self._make_levels()
        self._threads = Threads(threads, count)

    def __len__(self) -> int:
        return len(self.lanes)

    def close(self) -> None:
        """End the threads."""
        self._threads.close()

    def set_tasks(self, tasks: Sequence[Parameters]) -> None:
        """Let each game play another task from its next episode on.

        Raises:
            SimulatorError: a task has a level of a file, which the game did not have from the start.
        """
        for i, task in enumerate(tasks):
            if task.level is not None and self.levels[i]["seed"] != task.level_seed:
                raise SimulatorError("the level of a file is fixed when games are made: make others")
        self._tasks = tasks
        for world, task in zip(self.worlds, tasks, strict=True):
            task.write_to(world)

    def seed(self, i: int, key: int) -> None:
        """Forget everything that earlier episodes of game `i` left behind; `key` chooses its levels."""
        self.worlds[i] = np.zeros((), WORLD)
        self._tasks[i].write_to(self.worlds[i])
        self.lanes[i] = np.zeros((), self.lanes.dtype)
        self.lanes["key"][i] = key
        self.lanes["place"][i] = i % len(self.levels)

    def reset(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin an episode in every game, or in those that `which`, shape (N,), chooses."""
        self._orders[:] = _BEGIN if which is None else np.where(which, _BEGIN, _LEAVE)
        self._run()

    def step(
        self,
        actions: npt.NDArray[np.int64],
        choices: npt.NDArray[np.int64],
        then: Callable[[], None] = nothing,
    ) -> int:
        """Carry out an action in every game.

        Args:
            actions: shape (N, K): direction 0 to 2, jump and run, or their number; see `choices`.
            choices: number of choices of each, shape (K,).
            then: reads the new views; see `Threads.run`.

        Returns:
            -1; or, with no game stepped, `i` if game `i` has no episode to step in, or `N + i` if it has no
            such action.
        """
        refused = int(_order(actions, choices, self.lanes, self._setup, self._orders))
        if refused < 0:
            self._run(then)
        return refused

    def shown(self) -> tuple[Bytes, Reals]:
        """Return the current views: `cells` and `reals`, or copies of them."""
        if not self.copies:
            return self.cells, self.reals
        return self._copied if self._far else (self.cells.copy(), self.reals.copy())

    def observation(self, i: int) -> Observation:
        """Return game `i` as an RL-Glue agent would see it now."""
        body = np.zeros(BODY_SIZE, np.uint8)
        place = self.lanes["place"][i]
        size = _body(self.worlds[i : i + 1], self.levels[place : place + 1], body)
        return Observation.from_body(body[:size].tobytes())

    def _run(self, then: Callable[[], None] = nothing, levels: Levels | None = None) -> None:
        shown = (self.cells, self.reals, self.final_cells, self.final_reals)
        levels = self.levels if levels is None else levels
        if self.copies and self._far:
            self._copied = np.empty_like(self.cells), np.empty_like(self.reals)
            self._setup["copies"] = [one.ctypes.data for one in self._copied]
        games = (self.worlds, levels, self.lanes, self._setup, self._orders)
        self._threads.run(_advance, *games, *shown, then=then)

    def _make_levels(self) -> None:
        """Make every level of the set, by beginning an episode on it in the first game."""
        setup = self._setup.copy()
        self._orders[0] = _BEGIN
        self._setup["levels"], self._setup["shared"] = 1, False
        for i in range(len(self.levels)):
            self._setup["first_level"] = setup["first_level"] + i
            self._run(levels=self.levels[i : i + 1])
        self._setup[:] = setup
        self._setup["shared"] = True
        self.seed(0, 0)
        self.cells[0] = 0
        self.reals[0] = 0

    def _load(self) -> None:
        """Load the compiled rules, or compile them and say so."""
        with announce_compilation("many games of Infinite Mario"):
            none = np.zeros((0, 1), np.int64), np.zeros(1, np.int64)
            _order(*none, self.lanes[:0], self._setup, self._orders)
            self._run()
            # Only `render` asks for an observation; the code for it may compile then.


@jit
def _begin(world: World, levels: Levels, lane: Lane, setup: Setup) -> None:
    """Begin the next episode of a game, on the level chosen for it."""
    if setup.levels > 0:
        chosen = int(splitmix(lane.key + np.uint64(lane.episode)) % np.uint64(setup.levels))
        number = setup.first_level + chosen
        if setup.shared:
            lane.place = chosen
        world.level_seed = level_seed(number)
        world.level_type = number % TYPES if setup.level_type < 0 else setup.level_type
        difficulty = number // TYPES % setup.difficulties
        world.level_difficulty = difficulty if setup.level_difficulty < 0 else setup.level_difficulty
    lane.episode += 1
    lane.begun = True
    lane.over = False
    begin(world, levels[lane.place])
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
    """Order a step of every game, or return the reason for refusing; see `Games.step`."""
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
    levels: Levels,
    lanes: Array,
    setups: Array,
    orders: npt.NDArray[np.int8],
    cells: Bytes,
    reals: Reals,
    final_cells: Bytes,
    final_reals: Reals,
) -> None:
    """Carry out the orders of the games that this thread claims, in every turn.

    One function does everything, because the rules are compiled into every function that calls them.
    """
    setup: Setup = setups[0]
    worlds, levels, lanes = uncounted(worlds), uncounted(levels), uncounted(lanes)
    cells, reals = uncounted(cells), uncounted(reals)
    final_cells, final_reals = uncounted(final_cells), uncounted(final_reals)
    while begin_turn(gate, worker):
        first, last = claim(gate, worker)
        while first < last:
            for i in range(first, last):
                _look_ahead(worlds, levels, lanes, i)
                if orders[i] == _LEAVE:
                    continue
                world: World = worlds[i]
                lane: Lane = lanes[i]
                level: LevelMap = levels[lane.place]
                begins = orders[i] == _BEGIN or (lane.over and setup.mode == NEXT_STEP)
                if begins:
                    lane.reward = 0.0
                    lane.terminated = False
                    lane.truncated = False
                else:
                    _act(world, level, lane, setup, orders[i])
                    if lane.over and setup.mode == SAME_STEP:
                        if len(final_cells) > 0:
                            if not lane.terminated:
                                write_view(world, level, setup.view_number, cells[i], reals[i])
                            final_cells[i] = cells[i]
                            final_reals[i] = reals[i]
                        lane.final_info[:] = lane.info
                        begins = True
                if begins:
                    _begin(world, levels, lane, setup)
                    level = levels[lane.place]
                # The observation of a terminal step is the previous one, as in the original.
                if begins or not lane.terminated:
                    write_view(world, level, setup.view_number, cells[i], reals[i])
            if setup.copies[0] != 0:
                _copy_rows(setup.copies[0], cells.ctypes.data, first, last, cells.shape[1])
                _copy_rows(setup.copies[1], reals.ctypes.data, first, last, 4 * reals.shape[1])
            first, last = claim(gate, worker)
        if end_turn(gate, worker):
            return


@jit
def _copy_rows(target: int, source: int, first: int, last: int, size: int) -> None:
    copy_bytes(target + first * size, source + first * size, (last - first) * size)


@jit
def _look_ahead(worlds: Worlds, levels: Levels, lanes: Array, i: int) -> None:
    """Ask for the memory that the two games after game `i` need: of many games, it is in no near cache."""
    if i + 2 < len(worlds):
        world: World = worlds[i + 2]
        prefetch(world.actors, 0, 3)
        prefetch(world.changed, -256, 5)  # the numbers before it
        prefetch(lanes[i + 2].info, -64, 3)
    if i + 1 < len(worlds) and lanes[i + 1].place < len(levels):
        world = worlds[i + 1]
        level: LevelMap = levels[lanes[i + 1].place]
        column = world.drawn_camera // 16
        prefetch(level.cells, -32, 1)  # the numbers before it
        prefetch(level.cells, 8 * column, 4)
        prefetch(world.changed, 2 * column, 2)
        prefetch(world.dead, 2 * (column + COLUMNS_SHOWN), 1)
        prefetch(level.spawning, 2 * (column + COLUMNS_SHOWN), 1)


@jit
def _act(world: World, level: LevelMap, lane: Lane, setup: Setup, action: int) -> None:
    was_dying = world.death_timer > 0
    lane.terminated = not act(world, level, action // 4 - 1, action // 2 % 2, action % 2)
    if lane.terminated:
        lane.reward = terminal_reward(world)
        lane.info[1] = world.win_timer > 0
        lane.info[0] = world.win_timer == 0 and not was_dying and world.steps >= world.max_trial_steps
    else:
        lane.reward = ordinary_reward(world)
    lane.truncated = world.steps >= setup.max_steps  # as in Gymnasium, even if the episode ended as well
    lane.over = lane.terminated or lane.truncated


@entry
def _body(worlds: Worlds, levels: Levels, body: Bytes) -> int:
    world: World = worlds[0]
    level: LevelMap = levels[0]
    return encode(world, level, body)

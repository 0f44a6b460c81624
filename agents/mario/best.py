"""The agent `best`: it returns to promising places, explores there, and continues as its best episode did.

Infinite Mario is deterministic, and every episode replays the same level, so any series of actions can
be repeated. An episode of this agent has four parts:

    settle   run left for four steps, to the edge of the world: the episode then begins in the same state,
             regardless of the buttons still pressed from the previous one
    return   repeat the actions that once led to a remembered place
    explore  hold random actions, each for a few steps
    resume   continue as the best episode did from the place nearest to Mario; again whenever Mario
             strays from its path

Until some episode has ended with a reward, it returns to cells near the farthest one and explores to
the end of the episode. From then on it returns to any step of the best episode, or to any cell, and
explores only briefly: the gain is kept if the resumed rest is as good as before.

In terms of Sutton and Barto this is Monte Carlo control with exploring starts in a deterministic task,
where one return is not a sample but the value itself, so a maximum replaces the average: the value of a
cell is the highest return with which it was reached, and that of the policy is the highest return of an
episode. Resuming means acting by that policy in unseen states, generalising from the nearest seen state.
An episode explores with probability epsilon * (1 - (n / N)**3), n being the number of episodes before it;
otherwise it repeats the best one.

The agent sees only observations and rewards. If the actions to a remembered place lead elsewhere, the
world has changed, and the agent starts over.

Sources: Mohan (2010), for the primitive actions; J. Asmuth (2009), the sample agent of the
RL-Competition, which repeats the last episode except for its end; Ecoffet et al. (2021), First return,
then explore, for the archive of cells.

The archive is the memory of one world: the ways to places, and the best episode. A place is a cell: a
column of tiles, a pair of rows, and Mario's kind (small, big, fiery). For every cell the archive keeps
the actions that led to it with the highest return. In a deterministic task they are the way back, and
their return is exactly the best known value of reaching the cell.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Self

import numpy as np
import numpy.typing as npt

from agents.mario.agent import ACTIONS, LEFT, NUM_ACTIONS, RIGHT, STAY, MarioAgent, Seed, action_number
from agents.mario.observation import glimpse
from glue.errors import SaveError
from glue.options import Option
from glue.saves import Arrays, Saved, generator_array, pack, unpack
from glue.types import Action, Observation

MAX_STEPS: Final = 4096
"""Maximum number of steps of an episode that are remembered."""
_MAX_CELLS: Final = 16384
_ROWS: Final = 2

Position = tuple[float, float]
"""Mario's x and y, in tiles."""


@dataclass(slots=True)
class Cell:
    """A way to a cell: its actions, their return, the place where they end, and the number of their uses."""

    actions: bytes
    value: float
    place: Position
    tries: int = 0


class Trajectory:
    """A whole episode.

    Args:
        actions: the numbers of its N actions.
        places: Mario's place before each of them, shape (N, 2), in tiles.
        episode_return: the sum of its rewards.
    """

    def __init__(self, actions: bytes, places: npt.NDArray[np.float64], episode_return: float) -> None:
        self.actions = actions
        self.places = places
        self.episode_return = episode_return

    def __len__(self) -> int:
        return len(self.actions)

    def place(self, step: int) -> Position:
        """Return Mario's place before the action of a step."""
        x, y = self.places[step].tolist()
        return x, y

    def nearest(self, place: Position) -> int:
        """Return the step whose place is nearest, by the sum of both distances."""
        return int(np.abs(self.places - place).sum(axis=1).argmin())


class Archive:
    """The cells of a world, the best episode in it, and whether any episode has ended with a reward."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int, int], Cell] = {}
        self.best: Trajectory | None = None
        self.finished = False

    def note(self, kind: int, place: Position, value: float, actions: bytearray) -> None:
        """Remember the way by which Mario, of this kind, reached a place, unless a better one is known."""
        x, y = place
        key = (math.floor(x), math.floor(y / _ROWS), kind)
        cell = self.cells.get(key)
        if cell is None:
            if len(self.cells) == _MAX_CELLS:
                return
        elif value <= cell.value:
            return
        self.cells[key] = Cell(bytes(actions), value, place)

    def arrays(self) -> Arrays:
        """Return everything as arrays for saving."""
        cells = list(self.cells.values())
        best = self.best or Trajectory(b"", np.empty((0, 2)), 0.0)
        return {
            "keys": np.array(list(self.cells), np.int64).reshape(-1),
            "values": np.array([cell.value for cell in cells]),
            "places": np.array([cell.place for cell in cells]).reshape(-1),
            "tries": np.array([cell.tries for cell in cells], np.int64),
            "lengths": np.array([len(cell.actions) for cell in cells], np.int64),
            "actions": np.frombuffer(b"".join(cell.actions for cell in cells), np.int8),
            "best_actions": np.frombuffer(best.actions, np.int8),
            "best_places": best.places.reshape(-1),
            "best_return": np.array([best.episode_return]),
            "finished": np.array([self.finished], np.int8),
        }

    @classmethod
    def of(cls, saved: Saved) -> Self:
        """Return the archive whose `arrays` were saved.

        Raises:
            SaveError: `saved` cannot come from `arrays`.
        """
        archive = cls()
        keys = _rows(saved, "keys", np.int64, 3).tolist()
        values = saved.array("values", np.float64).tolist()
        places = _rows(saved, "places", np.float64, 2).tolist()
        tries = saved.array("tries", np.int64, low=0).tolist()
        lengths = saved.array("lengths", np.int64, low=0, high=MAX_STEPS)
        actions = saved.array("actions", np.int8, low=0, high=NUM_ACTIONS - 1).tobytes()
        if not len(keys) == len(values) == len(places) == len(tries) == len(lengths) <= _MAX_CELLS:
            raise SaveError(f"saved {saved.player}: its cells must be {_MAX_CELLS} at most, each complete")
        if lengths.sum() != len(actions):
            raise SaveError(
                f"saved {saved.player}: {len(actions)} actions for {lengths.sum()} steps to cells"
            )
        ways = _split(actions, lengths.tolist())
        for key, way, value, place, used in zip(keys, ways, values, places, tries, strict=True):
            archive.cells[tuple(key)] = Cell(way, value, tuple(place), used)
        best = saved.array("best_actions", np.int8, low=0, high=NUM_ACTIONS - 1)
        best_places = _rows(saved, "best_places", np.float64, 2)
        if len(best) != len(best_places) or len(best) > MAX_STEPS:
            raise SaveError(f"saved {saved.player}: {len(best)} actions at {len(best_places)} places")
        best_return, finished = saved.array("best_return", np.float64), saved.array("finished", np.int8)
        if len(best_return) != 1 or len(finished) != 1:
            raise SaveError(f"saved {saved.player}: one best return and one flag for the finish are needed")
        if len(best):
            archive.best = Trajectory(best.tobytes(), best_places, float(best_return[0]))
        archive.finished = bool(finished[0])
        return archive


def _rows(saved: Saved, name: str, dtype: type[np.generic], width: int) -> npt.NDArray[Any]:
    """Return an array of rows of `width` numbers."""
    array = saved.array(name, dtype, low=-(2.0**62), high=2.0**62)
    if len(array) % width:
        raise SaveError(f"saved {saved.player}: {name!r} must be rows of {width} numbers, not {len(array)}")
    return array.reshape(-1, width)


def _split(actions: bytes, lengths: list[int]) -> Iterator[bytes]:
    start = 0
    for length in lengths:
        yield actions[start : start + length]
        start += length


_SETTLING: Final = 4
_RUN_LEFT: Final = action_number(LEFT, False, True)
_MAX_WORLDS: Final = 8
_TO_THE_END: Final = 1 << 62
_NOWHERE: Final = -1
_FADING: Final = 3

# Where to explore. Distances are in tiles.
_FRONTIER: Final = 0.8  # chance of the frontier while no episode has ended with a reward
_DEPTH: Final = 8.0  # mean distance of the cells from the farthest one, at the frontier
_STRAYED: Final = 1.0  # distance from a path, x plus y, beyond which Mario has strayed
_MAX_RESUMED: Final = 30  # maximum resumptions in an episode; without it Mario might go in circles

# How to explore: the chances of the three buttons.
_AHEAD: Final = 0.87  # right, at the frontier
_ANYWHERE: Final = 0.67  # right, around the best episode
_JUMP: Final = 0.5
_RUN: Final = 0.7


@dataclass(frozen=True, slots=True)
class _Plan:
    """The plan of an episode.

    actions  the actions that lead back to a place
    place    that place; None if there is no way to follow
    burst    number of steps to explore there, before the best episode is resumed
    ahead    probability of the right button meanwhile
    """

    actions: bytes = b""
    place: Position | None = None
    burst: int = 0
    ahead: float = _ANYWHERE


_WANDER: Final = _Plan(burst=_TO_THE_END, ahead=_AHEAD)
_REPEAT: Final = _Plan()


class BestAgent(MarioAgent):
    """Returns to remembered places, explores from there, resumes its best episode."""

    name = "best"

    def __init__(
        self,
        *,
        epsilon: Annotated[float, Option("chance that an episode explores, at first", low=0, high=1)] = 1.0,
        horizon: Annotated[
            int, Option("when it begins to repeat the best episode only", low=1, high=10**9, unit="episodes")
        ] = 4800,
        hold: Annotated[
            float, Option("mean time an action is held while exploring", low=1, high=100, unit="steps")
        ] = 4.5,
        burst: Annotated[
            float, Option("mean time it explores before resuming", low=0, high=1000, unit="steps")
        ] = 10.0,
        cells: Annotated[
            float, Option("chance to return to a cell, not to a step of the best episode", low=0, high=1)
        ] = 0.35,
        learning: Annotated[bool, Option("whether to learn; off: it repeats the best episode")] = True,
        seed: Seed = None,
    ) -> None:
        super().__init__(seed)
        self._epsilon = epsilon if learning else 0.0
        self._horizon = horizon
        self._hold = hold
        self._burst = burst
        self._cells = cells
        self._learning = learning
        self._reset()

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; the places of a truncated one (cut off) are remembered."""
        self._begin()
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Remember the place, and choose the next action."""
        self._return += reward
        return self._act(observation)

    def agent_end(self, reward: float) -> None:
        """Keep the episode if it is the best; a repetition of the best one replaces its return."""
        self._return += reward
        steps = len(self._actions)
        if not (self._learning and 0 < steps <= MAX_STEPS):
            return
        archive = self._archive
        archive.finished |= reward > 0
        best = archive.best
        if best is None or self._return > best.episode_return or self._plan is _REPEAT:
            archive.best = Trajectory(bytes(self._actions), np.array(self._places), self._return)

    def agent_message(self, message: str) -> str:
        """Answer `best`, the highest return of an episode, `cells`, the number known, and `epsilon`."""
        if message == "best":
            found = [archive.best.episode_return for archive in self._worlds.values() if archive.best]
            return repr(max(found)) if found else "none"
        if message == "cells":
            return str(sum(len(archive.cells) for archive in self._worlds.values()))
        if message == "epsilon":
            return repr(self._chance_to_explore())
        return f"agent {self.name} answers only the messages best, cells and epsilon"

    def agent_save(self) -> bytes:
        """Return the memory, the generator's state and the count of episodes."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "generator": generator_array(self._generator),
            "worlds": np.array(list(self._worlds), np.int64),
        }
        for i, archive in enumerate(self._worlds.values()):
            arrays |= {f"{i} {name}": array for name, array in archive.arrays().items()}
        return pack(Saved(self.name, {}, {"episodes": self._episodes}, arrays))

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned; this agent keeps its own options.

        Raises:
            SaveError: `data` is damaged, or of another agent.
        """
        saved = unpack(data, self.name, {})
        generator, episodes = saved.generator(), saved.number("episodes")
        worlds = saved.array("worlds", np.int64)
        if len(worlds) > _MAX_WORLDS:
            raise SaveError(f"saved {self.name}: at most {_MAX_WORLDS} worlds, not {len(worlds)}")
        archives = {}
        for i, digest in enumerate(worlds.tolist()):
            own = {name.removeprefix(f"{i} "): array for name, array in saved.arrays.items()}
            archives[digest] = Archive.of(replace(saved, arrays=own))
        self._remember(generator, episodes, archives)

    def _reset(self) -> None:
        self._remember(np.random.default_rng(self._seed), 0, {})

    def _remember(self, generator: np.random.Generator, episodes: int, worlds: dict[int, Archive]) -> None:
        """Set the state that outlives an episode.

        An archive is identified by the observation after settling; there is only one, unless Mario is
        too slow to reach the edge of the world in time.
        """
        self._generator = generator
        self._episodes = episodes
        self._worlds = worlds

    def _begin(self) -> None:
        self._settled = 0
        self._return = 0.0
        self._actions = bytearray()
        self._places: list[Position] = []
        self._held = self._hold_for = 0
        self._next = _NOWHERE
        self._resumed = 0
        self._plan = _WANDER

    def _chance_to_explore(self) -> float:
        past = min(1.0, self._episodes / self._horizon)
        return self._epsilon * (1.0 - past**_FADING)

    def _act(self, observation: Observation) -> Action:
        kind, place, sprites = glimpse(observation)
        if self._settled < _SETTLING:
            self._settled += 1
            return ACTIONS[_RUN_LEFT]
        if not self._actions:
            self._enter(zlib.crc32(sprites))
        elif self._learning and len(self._plan.actions) <= len(self._actions) < MAX_STEPS:
            self._archive.note(kind, place, self._return, self._actions)
        action = self._choose(place)
        self._actions.append(action)
        self._places.append(place)
        return ACTIONS[action]

    def _enter(self, digest: int) -> None:
        """Recall the world that begins with this digest, and plan the episode."""
        archive = self._worlds.get(digest, Archive())
        if self._learning:
            if digest not in self._worlds and len(self._worlds) == _MAX_WORLDS:
                del self._worlds[next(iter(self._worlds))]
            self._worlds[digest] = archive
        self._digest = digest
        self._archive = archive
        self._plan = self._make_plan()
        self._next = 0 if self._plan is _REPEAT else _NOWHERE
        self._episodes += self._learning

    def _begin_anew(self) -> None:
        """Forget everything, because the world has changed."""
        self._archive = Archive()
        self._remember(self._generator, 0, {self._digest: self._archive})
        self._plan = _WANDER

    def _make_plan(self) -> _Plan:
        best, cells = self._archive.best, self._archive.cells.values()
        draw = self._generator.random
        if best is None or not cells:
            return _WANDER
        if draw() >= self._chance_to_explore():
            return _REPEAT
        if not self._archive.finished and draw() < _FRONTIER:
            depth = max(cell.place[0] for cell in cells) - 1.0 - self._generator.exponential(_DEPTH)
            cell = self._pick((cell for cell in cells if cell.place[0] >= depth), 1.0)
            return _Plan(cell.actions, cell.place, _TO_THE_END, _AHEAD)
        burst = int(self._generator.geometric(1 / (1 + self._burst))) - 1
        if draw() < self._cells:
            cell = self._pick(cells, 0.5)
            return _Plan(cell.actions, cell.place, burst)
        step = int(draw() * len(best))
        return _Plan(best.actions[:step], best.place(step), burst)

    def _pick(self, cells: Iterable[Cell], power: float) -> Cell:
        """Draw a cell; less used cells are more likely."""
        candidates = list(cells)
        weights = np.cumsum([(1 + cell.tries) ** -power for cell in candidates])
        cell = candidates[int(np.searchsorted(weights, self._generator.random() * weights[-1], "right"))]
        cell.tries += self._learning
        return cell

    def _choose(self, place: Position) -> int:
        """Return to a place, explore or resume; return the number of an action."""
        plan, step = self._plan, len(self._actions)
        if step < len(plan.actions):
            return plan.actions[step]
        if step == len(plan.actions) and plan.place is not None and _apart(plan.place, place):
            self._begin_anew()  # the plan's chances to explore suit a new world too
        best = self._archive.best
        if best is None or step < len(plan.actions) + self._plan.burst:
            return self._explore()
        return self._resume(best, place)

    def _explore(self) -> int:
        """Hold a random action for a random time."""
        if self._hold_for == 0:
            draw = self._generator.random
            sideways = LEFT if draw() < 0.5 else STAY
            direction = RIGHT if draw() < self._plan.ahead else sideways
            self._held = action_number(direction, draw() < _JUMP, draw() < _RUN)
            self._hold_for = int(self._generator.geometric(1 / self._hold))
        self._hold_for -= 1
        return self._held

    def _resume(self, best: Trajectory, place: Position) -> int:
        """Continue as in the best episode; after its end, at random."""
        strayed = 0 <= self._next < len(best) and _apart(best.place(self._next), place)
        if strayed and self._plan is _REPEAT and self._learning:
            self._begin_anew()
            return self._explore()
        if self._next == _NOWHERE or (strayed and self._resumed < _MAX_RESUMED):
            self._next = best.nearest(place)
            self._resumed += 1
        if self._next >= len(best):
            return self._explore()
        self._next += 1
        return best.actions[self._next - 1]


def _apart(one: Position, other: Position) -> bool:
    return abs(one[0] - other[0]) + abs(one[1] - other[1]) > _STRAYED

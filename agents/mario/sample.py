"""The sample agent of the RL-Competition 2009: random actions, and a memory of the last episode.

It ignores rewards. An episode repeats all actions of the previous one except the last seven, then acts
at random; so it backs up from every death, and keeps a solution once found, except for its end.
Source: J. Asmuth (2009), the sample agent of the Infinite Mario package.
"""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np

from agents.mario.agent import ACTIONS, RIGHT, STAY, MarioAgent, action_number
from agents.mario.observation import BLANK, COIN, COLUMNS, MARIO, ROWS, SOLID, decode
from glue.compiled import java_random
from glue.compiled.jit import announce_compilation
from glue.options import Option
from glue.saves import Saved, pack, unpack
from glue.types import Action, Observation

_FORGOTTEN: Final = 7
_MARIOS: Final = (0, 10, 11)
_UNKNOWN: Final = 0
_FREE: Final = (BLANK, MARIO, _UNKNOWN)


class SampleAgent(MarioAgent):
    """The competition's sample agent, with the draws of the original."""

    name = "sample"

    def __init__(
        self,
        *,
        seed: Annotated[
            int | None, Option("seed of its java.util.Random; the experiment's if not given")
        ] = None,
    ) -> None:
        super().__init__(seed)

    def _reset(self) -> None:
        with announce_compilation("the agent sample"):
            java_random.draw_double(java_random.seeded(0))
        self._random = java_random.seeded(self._seed & java_random.MASK)
        self._last: list[int] = []
        self._this: list[int] = []
        self._hesitating = False

    def agent_start(self, observation: Observation) -> Action:
        """Begin to repeat the previous episode."""
        self._this = []
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Repeat, or act at random; the reward is ignored."""
        return self._act(observation)

    def agent_end(self, reward: float) -> None:
        """Remember the actions, except the last seven."""
        self._last = self._this[:-_FORGOTTEN]

    def agent_message(self, message: str) -> str:
        """Answer that no messages are understood."""
        return "agent sample answers no messages"

    def agent_save(self) -> bytes:
        """Return the memory and the generator's state."""
        numbers = {"random": int(self._random[0]), "hesitating": int(self._hesitating)}
        return pack(Saved(self.name, {}, numbers, {"last": np.array(self._last, np.int8)}))

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned.

        Raises:
            SaveError: `data` is damaged, or of another agent.
        """
        saved = unpack(data, self.name, {})
        last = saved.array("last", np.int8, low=0, high=len(ACTIONS) - 1)
        random, hesitating = saved.number("random", java_random.MASK), saved.number("hesitating", 1)
        self._last = last.tolist()
        self._random[0] = random
        self._hesitating = bool(hesitating)

    def _act(self, observation: Observation) -> Action:
        k = len(self._this)
        action = self._last[k] if k < len(self._last) else self._choose(observation)
        self._this.append(action)
        return ACTIONS[action]

    def _choose(self, observation: Observation) -> int:
        """Draw an action: to the right, or nowhere while hesitating; obstacles make a jump likelier."""
        neighbourhood = _Neighbourhood(observation)
        pit = neighbourhood.has_pit()
        stay_down, near = neighbourhood.monsters(0.0 if pit else neighbourhood.obstacles(0.95))
        if neighbourhood.speed_y > 0.1:
            stay_down *= 0.5
        self._hesitating = self._hesitates(near)
        jump = java_random.draw_double(self._random) > stay_down
        return action_number(STAY if self._hesitating else RIGHT, jump, pit or not near)

    def _hesitates(self, near: bool) -> bool:
        draw, random = java_random.draw_double, self._random
        if self._hesitating:
            return near and not (draw(random) > 0.8 or draw(random) > 0.9)
        return (near and draw(random) > 0.8) or draw(random) > 0.9


class _Neighbourhood:
    """The part of an observation that the sample agent considers."""

    def __init__(self, observation: Observation) -> None:
        seen = decode(observation)
        self._camera, self._kinds, self._doubles, self._chars = (
            seen.camera,
            seen.kinds,
            seen.doubles,
            seen.chars,
        )
        self._x, self._y, _, self.speed_y = self._doubles[:4]

    def obstacles(self, stay_down: float) -> float:
        """Return the chance not to jump, reduced by every coin and block up to six columns ahead."""
        for up in range(5):
            for right in range(7):
                seen = self._tile(self._x + right, int(self._y + up))
                if seen == COIN:
                    stay_down *= 0.7
                elif seen not in _FREE:
                    stay_down = stay_down * right / 7
        return stay_down

    def has_pit(self) -> bool:
        """Return whether one of the three columns from Mario's own on is empty from his height down."""
        return any(
            all(self._tile(self._x + right, height) in _FREE for height in range(min(int(self._y), ROWS) + 1))
            for right in range(3)
        )

    def monsters(self, stay_down: float) -> tuple[float, bool]:
        """Return the chance not to jump, reduced by every nearby monster, and whether there is one."""
        near = False
        for kind, x, y in zip(self._kinds, self._doubles[::4], self._doubles[1::4], strict=True):
            dx, dy = x - self._x, y - self._y
            if kind not in _MARIOS and -1 < dx < 10 and -4 < dy < 4:
                stay_down = stay_down * (dx + 2) / 12
                near = True
        return stay_down, near

    def _tile(self, x: float, height: int) -> int:
        """Return a tile as the original looked it up, one row too low.

        The original treats the column right of the view as part of the view, and finds the newline there.
        """
        column, row = int(x), ROWS - height
        if column < 0:
            return SOLID
        column -= self._camera
        if not (0 <= column <= COLUMNS and 0 <= row < ROWS):
            return _UNKNOWN
        return self._chars[row * (COLUMNS + 1) + column]

"""An environment that is drawn in the terminal as it is played."""

from __future__ import annotations

from glue.cli.screen import TerminalScreen
from glue.roles import Environment, Wrapper
from glue.types import Action, Observation, Step, step_of


class Rendered(Wrapper):
    """`environment`, with every observation drawn on `screen`; otherwise unchanged."""

    def __init__(self, environment: Environment, screen: TerminalScreen) -> None:
        self.__wrapped__: Environment = environment
        self._screen = screen
        self._step = 0
        self._return = 0.0

    def env_start(self) -> Observation:
        observation = self.__wrapped__.env_start()
        self._step, self._return = 0, 0.0
        self._screen.show(observation, 0.0, 0, 0.0)
        return observation

    def env_step(self, action: Action) -> Step:
        step = step_of(self.__wrapped__.env_step(action))
        self._step += 1
        self._return += step.reward
        self._screen.show(step.observation, step.reward, self._step, self._return)
        return step

    def env_cleanup(self) -> None:
        self.__wrapped__.env_cleanup()
        self._screen.close()

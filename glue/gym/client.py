"""Any RL-Glue environment as a `gymnasium.Env`, including one behind a hub, in any language.

At a hub, the program is the experiment of a session. It plays the agent's part itself, by RL_env_start and
RL_env_step; the agent that the session needs for its init is a stand-in, served from a thread.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Final

import gymnasium
from gymnasium.vector import SyncVectorEnv

import glue.client.experiment as remote
from glue.client.players import serve_agent
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import ConfigError, SimulatorError, TaskSpecError
from glue.gym.spaces import Codec, MaskCodec, SpaceLike, read_spaces
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION
from glue.roles import Agent, Environment
from glue.system import threads
from glue.taskspec import parse_task_spec
from glue.types import Action, BoolArray, Observation, arrays_of

_TAKEN: Final = {"action_mask", "episode"}
"""Names in an info that are not for extras: of the mask, and of Gymnasium's RecordEpisodeStatistics."""


def wrap(environment: Environment) -> GlueEnv:
    """Return an RL-Glue environment of this process as a `gymnasium.Env`.

    Raises:
        ConfigError: its task spec does not state its actions.
    """
    return GlueEnv(local(_StandIn(), environment))


def connect(hub: str = DEFAULT_HUB, session: str = DEFAULT_SESSION, *, wait: float | None = None) -> GlueEnv:
    """Return the environment of a session at a hub as a `gymnasium.Env`.

    The session must have no agent and no experiment. Waits until the environment has joined.

    Args:
        hub: address of the hub.
        session: name of the session.
        wait: seconds to wait for the hub to answer; None waits forever.

    Raises:
        HubUnreachable: no hub has answered in that time.
        ConfigError: the task spec does not state the actions, or the hub has a rate or a delay.
    """
    glue = remote.connect(hub, session, name="gymnasium", wait=wait)
    try:
        if glue.late_actions() is not None:
            raise ConfigError(
                "the hub has a rate or a delay, and a Gymnasium environment waits for its actions: "
                "start a hub without them for it"
            )
        stand_in = threads.Thread(
            target=serve_agent,
            args=(_StandIn(), hub, session),
            kwargs={"wait": wait},
            name="stand-in agent",
            daemon=True,
        )
        stand_in.start()
        return GlueEnv(glue)
    except BaseException:
        glue.close()  # otherwise nobody else could use the session
        raise


def connect_vec(
    hub: str, sessions: Sequence[str], *, wait: float | None = None, **options: Any
) -> SyncVectorEnv:
    """Return the environments of many sessions at a hub as one vector environment.

    Args:
        hub: address of the hub.
        sessions: names of the sessions; their environments have the same task spec.
        wait: as for `connect`.
        options: options of Gymnasium's SyncVectorEnv, such as `autoreset_mode`.
    """
    makers = [functools.partial(connect, hub, session, wait=wait) for session in sessions]
    return _VectorEnv(makers, **options)


class _VectorEnv(SyncVectorEnv):  # type: ignore[misc]
    """Gymnasium's, whose arrays of infos have the type of the first value: here none loses its fraction."""

    def _add_info(self, infos: dict[str, Any], info: dict[str, Any], number: int) -> dict[str, Any]:
        for name, value in info.items():
            if type(value) is float and name in infos and infos[name].dtype.kind == "i":
                infos[name] = infos[name].astype(float)
        return super()._add_info(infos, info, number)  # type: ignore[no-any-return]


class GlueEnv(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """The environment of an experiment, whose agent is never asked for an action.

    Its spaces are read from the task spec; see `glue.gym.spaces.read_spaces`. A reset with a seed is an
    RL_init with that seed, from which the environment's own seed is derived. An info has the extras of the
    observation and, in a task with masks, the `action_mask`; see `glue.gym.spaces`. An extra that is called
    `action_mask` or `episode` is there as `extra.action_mask` or `extra.episode`.

    Args:
        glue: the experiment; it is closed with the environment.

    Raises:
        ConfigError: the task spec does not state the actions.
    """

    def __init__(self, glue: Experiment) -> None:
        self._glue = glue
        self._task_spec = glue.rl_init()
        try:
            spec = parse_task_spec(self._task_spec)
        except TaskSpecError as error:
            raise ConfigError(f"the environment's task spec cannot be read: {error}") from None
        if not spec.actions.stated:
            raise ConfigError(f"the task spec does not say what actions are: {self._task_spec:.200}")
        self.observation_space: SpaceLike
        self.action_space: SpaceLike
        self.observation_space, self.action_space = read_spaces(spec)
        self._read: Callable[[Observation], Any] = arrays_of
        if spec.observations.stated:
            self._read = Codec(self.observation_space).unpack
        self._actions = Codec(self.action_space)
        self._masks = MaskCodec(self.action_space) if spec.masks else None
        self._shown = Observation()
        self._playing = False

    @property
    def task_spec(self) -> str:
        """The environment's task spec."""
        return self._task_spec

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        Raises:
            GlueError: see `Experiment`.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._glue.rl_cleanup()
            if self._glue.rl_init(seed) != self._task_spec:
                raise SimulatorError("the environment has another task spec now: make a new GlueEnv")
        self._shown = self._glue.rl_env_start()
        self._playing = True
        return self._read(self._shown), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out an action.

        Raises:
            SimulatorError: the action is not in the space, or no episode is under way.
            GlueError: see `Experiment`.
        """
        if not self._playing:
            raise SimulatorError("a step needs an episode: call reset first, and again after each end")
        if not self.action_space.contains(action):
            raise SimulatorError(f"{action!r:.80} is not in {self.action_space}")
        step = self._glue.rl_env_step(Action(*self._actions.pack(action)))
        self._playing = not step.terminal
        self._shown = step.observation
        terminated = step.terminal and not step.truncated
        return self._read(self._shown), step.reward, terminated, step.truncated, self._info()

    def action_masks(self) -> BoolArray:
        """Return which values of the next action are legal, those of its numbers concatenated, shape (bits,).

        sb3-contrib's MaskablePPO asks for it before each action.

        Raises:
            SimulatorError: the task has no masks.
        """
        if self._masks is None:
            raise SimulatorError("this environment has no masks: its task spec's EXTRA lacks the word masks")
        return self._masks.flat(self._shown)

    def close(self) -> None:
        """Clean up and leave the session."""
        self._glue.rl_cleanup()
        self._glue.close()

    def _info(self) -> dict[str, Any]:
        extras = self._shown.extras
        # Gymnasium's vector environments take arrays of one shape only, and any lists.
        info: dict[str, Any] = {
            f"extra.{name}" if name in _TAKEN else name: [*value] if isinstance(value, tuple) else value
            for name, value in extras.items()
        }
        if self._masks is not None:
            info["action_mask"] = self._masks.unpack(self._shown)
        return info


class _StandIn(Agent):
    """The agent of a session whose experiment acts itself. It is dismissed when the experiment leaves."""

    for_one_run = True

    def agent_start(self, observation: Observation) -> Action:
        raise SimulatorError("this agent stands in for an experiment that acts itself")

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.agent_start(observation)

    def agent_message(self, message: str) -> str:
        return "I stand in for an experiment that acts itself"

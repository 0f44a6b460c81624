"""The rules of the contract checks, and the error that names a broken one."""

from __future__ import annotations

from enum import StrEnum

from glue.conform.peers.rules import HubRule
from glue.errors import GlueError


class Rule(StrEnum):
    """Rules for agents and environments."""

    METHODS = "every method of the role is there"
    CALLS = "no call raises that an experiment may make"
    TASK_SPEC = "env_init returns a text, and one that begins with VERSION can be read"
    OBSERVATION = "env_start and env_step return an Observation"
    OBSERVATION_SPACE = "an observation is as the task spec says"
    STEP = "env_step returns a tuple of reward, observation, terminal"
    REWARD = "a reward is a finite number"
    REWARD_RANGE = "a reward is as an RL-Glue-3.0 task spec says"
    TERMINAL = "terminal is True or False"
    ACTION = "agent_start and agent_step return an Action"
    ACTION_SPACE = "an action is as the task spec says"
    MESSAGE = "a message is answered with a text"
    SEED = "equal seeds make equal episodes"
    REPEATABLE = "without seed, equal seeds of Python's and NumPy's global generators make equal episodes"
    AFRESH = "seed and init start afresh, whatever came before"
    SAVE = "save returns bytes, and what loads them goes on as what saved them"
    DAMAGE = "load refuses damaged data with an exception"


class ContractBroken(GlueError, AssertionError):
    """An agent, environment or hub breaks the rule `rule`."""

    def __init__(self, rule: Rule | HubRule, what: str) -> None:
        super().__init__(f"{rule}: {what}")
        self.rule = rule

"""The rules that the contract checks know, and the error that names the one that is broken."""

from __future__ import annotations

from enum import StrEnum

from glue.errors import GlueError

__all__ = ["ContractBroken", "HubRule", "Rule"]


class Rule(StrEnum):
    """What an agent or environment has to keep to."""

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
    AFRESH = "seed and init begin afresh, whatever was before"
    SAVE = "save returns bytes, and what loads them goes on as what saved them"
    DAMAGE = "load refuses what is damaged with a GlueError"


class HubRule(StrEnum):
    """What a hub has to keep to, from the simplest to the most intricate; see docs/protocol.md."""

    GREETING = "HELLO is answered with WELCOME and the same seq"
    HEARTBEAT = "each connection gets a HEARTBEAT every heartbeat, and a peer's own is answered"
    CALLS = "a request calls the players in RL-Glue's order and passes everything on unchanged"
    NUMBERS = "the calls of a session have growing numbers"
    COUNTERS = "return, steps and episodes are counted as RL-Glue counts them"
    CUTOFF = "RL_EPISODE ends at its limit of steps, without AGENT_END, and is not counted"
    OUTCOME = "RL_EPISODE's reply tells return and steps to an experiment with the capability outcome alone"
    LAST_ACTION = "RL_STEP executes the last action, also past the end of an episode"
    MESSAGES = "messages reach the players at any time, even before RL_INIT, and their answers come back"
    VERSION = "a peer that speaks no version of the hub's is refused with version"
    ROLE_TAKEN = "a second peer in a role is refused with role-taken, and the first stays"
    UNKNOWN_PEER = "a connection without a HELLO gets the error unknown-peer"
    SEED = "players with the capability seed are given numbers made from the seed, others are passed over"
    UNSUPPORTED = "save and load reach players with the capability save; for others the error is unsupported"
    SESSIONS = "one connection may take part in several sessions, and none disturbs another"
    BUSY = "a request while another is under way gets the error busy, and is not carried out"
    REPEATED = "what comes a second time changes nothing"
    NOT_ASKED = "what is not for a peer to send gets the error not-asked, and changes nothing"
    UNKNOWN_KIND = "an unknown kind gets the error unknown-kind, and changes nothing"
    EXCEPTION = "a player's exception ends the request with peer-failed, and the player stays"
    MALFORMED = "what is malformed gets the error malformed, costs its sender alone its place"
    RESUMED = "an instance that comes back over a new connection goes on where it was"
    WELCOME_LOST = "an instance counts as unknown until it has sent a request or an answer"
    GOODBYE = "GOODBYE gives up a role at once, and sends off the players that offered one-run"
    LOST = "a player that leaves in mid-episode makes it void: NOTICE lost, error peer-lost"
    SILENT = "a player whose connection ended is lost after `timeout`"
    REPLACED = "a new player is initialised before its first other call, and announced"


class ContractBroken(GlueError, AssertionError):
    """An agent, environment or hub breaks the rule `rule`."""

    def __init__(self, rule: Rule | HubRule, what: str) -> None:
        super().__init__(f"{rule}: {what}")
        self.rule = rule

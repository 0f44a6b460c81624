"""The rules by which a hub is judged."""

from __future__ import annotations

from enum import StrEnum


class HubRule(StrEnum):
    """Rules for hubs, in the order in which they are judged; see docs/protocol-reference.md."""

    GREETING = "HELLO is answered with WELCOME and the same seq"
    HEARTBEAT = "each connection gets a HEARTBEAT every heartbeat, and a peer's own is answered"
    CALLS = "a request calls the players in RL-Glue's order and passes everything on unchanged"
    NUMBERS = "the calls of a session have growing numbers"
    COUNTERS = "return, steps and episodes are counted as RL-Glue counts them"
    CUTOFF = "RL_EPISODE ends at its limit of steps, without AGENT_END, and is not counted"
    OUTCOME = "RL_EPISODE's reply tells return and steps only to an experiment with the capability outcome"
    LAST_ACTION = "RL_STEP executes the last action, also past the end of an episode"
    MESSAGES = "messages reach the players at any time, even before RL_INIT, and their answers come back"
    VERSION = "a peer that speaks no version of the hub's is refused with version"
    ROLE_TAKEN = "a second peer in a role is refused with role-taken, and the first stays"
    UNKNOWN_PEER = "a connection without a HELLO gets the error unknown-peer"
    SEED = "players with the capability seed are given numbers made from the seed, others are passed over"
    UNSUPPORTED = "save and load reach players with the capability save; for others the error is unsupported"
    SESSIONS = "one connection may take part in several sessions, and none disturbs another"
    BUSY = "a request while another is under way gets the error busy, and is not carried out"
    REPEATED = "a repeated message changes nothing"
    NOT_ASKED = "a message that a peer may not send gets the error not-asked, and changes nothing"
    UNKNOWN_KIND = "an unknown kind gets the error unknown-kind, and changes nothing"
    EXCEPTION = "a player's exception ends the request with peer-failed, and the player stays"
    MALFORMED = "a malformed message gets the error malformed, and costs only its sender its place"
    RESUMED = "an instance that returns over a new connection continues where it was"
    WELCOME_LOST = "an instance is unknown until it has sent a request or an answer"
    GOODBYE = "GOODBYE frees a role at once, and the experiment's ends players that offered one-run"
    LOST = "a player that leaves in mid-episode makes it void: NOTICE lost, error peer-lost"
    SILENT = "a player whose connection ended is lost after `timeout`"
    REPLACED = "a new player is initialised before its first other call, and announced"

"""Every message of the protocol: its sender, its contents and its answer.

A message is a kind, a session, a sequence number, some scalars and at most one body. `CALLS` is the
table of RL-Glue's calls and of the capabilities beyond them; `CONTROL` is the table of the messages that
set up and keep a connection. A reply has the kind and the sequence number of its request; only the direction
tells them apart. The codes below 64 are RL-Glue's own message ids.

Source of names, payloads and ids: RL-Glue 3.04, RL_network.h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple, final

PROTOCOL_VERSION: Final = 1

MAX_HEADER: Final = 4096
"""Maximum size of a header, in bytes. The longest legal header, that of a HELLO, is far smaller."""

MAX_BODY: Final = 16 * 2**20
"""Maximum size of a body, in bytes: room for RL-Glue's million ints, million doubles and million chars."""

MAX_FRAME: Final = 2 * MAX_BODY + MAX_HEADER
"""Maximum size of a frame from a hub, in bytes: of an observation and an action together, or of a header."""

MAX_NAME: Final = 255
"""Maximum length of a session or peer name, in characters."""

Type = type  # An alias, since `Scalar` has a field `type`.
Value = None | bool | int | float | str | bytes | tuple[int, ...] | tuple[str, ...]


OUTCOME: Final = "outcome"
"""Capability of an experiment that accepts the return and number of steps with the end of an episode."""

PACE: Final = "pace"
"""Capability of an agent that is told its time, and of an experiment that is told of late actions."""

MASK: Final = "mask"
"""Capability of a peer that sends or reads masks of the legal actions."""

EXTRAS: Final = "extras"
"""Capability of an environment that sends extras, and of an experiment or observer that reads them."""

BESIDE: Final = frozenset({MASK, EXTRAS})
"""The capabilities for what an observation carries beside its numbers; a hub that has them says so."""


class Role(StrEnum):
    """The three programs of RL-Glue, and observers of them."""

    AGENT = "agent"
    ENVIRONMENT = "environment"
    EXPERIMENT = "experiment"
    OBSERVER = "observer"


PLAYERS: Final = (Role.AGENT, Role.ENVIRONMENT)

THREE_ROLES: Final = (*PLAYERS, Role.EXPERIMENT)
"""The roles that make up a session."""


class Kind(IntEnum):
    """The kind of a message; its number on the wire.

    Numbers below 64 are RL-Glue's own calls; 64 to 79 are messages about connections and observers, 80 to 89
    further calls to players, and 90 to 99 further calls from experiments.
    """

    AGENT_INIT = 4
    AGENT_START = 5
    AGENT_STEP = 6
    AGENT_END = 7
    AGENT_CLEANUP = 8
    AGENT_MESSAGE = 10
    ENV_INIT = 11
    ENV_START = 12
    ENV_STEP = 13
    ENV_CLEANUP = 14
    ENV_MESSAGE = 19
    RL_INIT = 20
    RL_START = 21
    RL_STEP = 22
    RL_CLEANUP = 23
    RL_RETURN = 24
    RL_NUM_STEPS = 25
    RL_NUM_EPISODES = 26
    RL_EPISODE = 27
    RL_AGENT_MESSAGE = 33
    RL_ENV_MESSAGE = 34
    RL_ENV_START = 36
    RL_ENV_STEP = 37
    RL_AGENT_START = 38
    RL_AGENT_STEP = 39
    RL_AGENT_END = 40
    HELLO = 64
    WELCOME = 65
    REFUSE = 66
    HEARTBEAT = 67
    GOODBYE = 68
    ERROR = 69
    NOTICE = 70
    OBSERVE = 71
    OBSERVED_INIT = 72
    OBSERVED_START = 73
    OBSERVED_STEP = 74
    OBSERVED_MESSAGE = 75
    AGENT_SEED = 80
    AGENT_SAVE = 81
    AGENT_LOAD = 82
    ENV_SEED = 83
    ENV_SAVE = 84
    ENV_LOAD = 85
    AGENT_METRICS = 86
    RL_AGENT_SAVE = 90
    RL_AGENT_LOAD = 91
    RL_ENV_SAVE = 92
    RL_ENV_LOAD = 93
    RL_AGENT_METRICS = 94


class Body(StrEnum):
    """The content of the body frame of a message."""

    NONE = "nothing"
    OBSERVATION = "an observation"
    ACTION = "an action"
    OBSERVATION_ACTION = "an observation, then at once an action"
    TEXT = "a text in UTF-8"
    BLOB = "bytes"


class Scalar(NamedTuple):
    """One scalar of a header: its name and type; `items` is the type of the items of an array.

    A bool with `cuts` may also be `glue.types.CUT_OFF`.
    """

    name: str
    type: Type
    optional: bool = False
    items: Type | None = None
    cuts: bool = False


@dataclass(frozen=True, slots=True)
class Shape:
    """The contents of a message: scalars in the header, in this order, and a body.

    `more` are scalars that may follow, all or none, if the receiver has the capability for them.
    `plain` holds the types of the scalars if every value of these types is valid, so that one comparison
    checks them all; None if a scalar is optional or has a restricted range.
    """

    scalars: tuple[Scalar, ...] = ()
    body: Body = Body.NONE
    more: tuple[Scalar, ...] = ()
    plain: tuple[type, ...] | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        types = tuple(scalar.type for scalar in self.scalars)
        checked = any(s.optional or s.type in (int, tuple) for s in self.scalars)
        object.__setattr__(self, "plain", None if checked else types)


@dataclass(frozen=True, slots=True)
class Call:
    """A request and its reply. `callee` is the role that answers; None: the hub, asked by the experiment."""

    callee: Role | None
    request: Shape
    reply: Shape
    capability: str | None = None


@final
class Message(NamedTuple):
    """One message. `body` is bytes on the wire; elsewhere it has the form that the engine's host uses."""

    kind: Kind
    session: str
    seq: int
    scalars: tuple[Value, ...] = ()
    body: bytes = b""


class ErrorCode(StrEnum):
    """The first scalar of an ERROR or REFUSE, for programs; the second is for people."""

    MALFORMED = "malformed"
    UNKNOWN_PEER = "unknown-peer"
    UNKNOWN_KIND = "unknown-kind"
    NOT_ASKED = "not-asked"
    BUSY = "busy"
    UNSUPPORTED = "unsupported"
    EXCEPTION = "exception"
    PEER_LOST = "peer-lost"
    PEER_FAILED = "peer-failed"
    VERSION = "version"
    ROLE_TAKEN = "role-taken"
    FULL = "full"
    NOT_ADMITTED = "not-admitted"
    NO_SESSION = "no-session"


class Event(StrEnum):
    """An event of an agent or environment that a NOTICE reports to the experiment."""

    JOINED = "joined"
    LOST = "lost"
    RETURNED = "returned"
    SLOW = "slow"


_REWARD = Scalar("reward", float)
_TERMINAL = Scalar("terminal", bool, cuts=True)
_EMPTY = Shape()
_OBSERVATION = Shape(body=Body.OBSERVATION)
_ACTION = Shape(body=Body.ACTION)
_TEXT = Shape(body=Body.TEXT)
_BLOB = Shape(body=Body.BLOB)
_ENV_STEP_REPLY = Shape((_REWARD, _TERMINAL), Body.OBSERVATION)
_SEED = Shape((Scalar("seed", int),))
_RETURN = Scalar("return", float)
_NUM_STEPS = Scalar("num_steps", int)
_DEADLINE = Scalar("deadline", float)
_LATENCY = Scalar("latency", float)

_A, _E = Role.AGENT, Role.ENVIRONMENT

CALLS: Final[Mapping[Kind, Call]] = MappingProxyType(
    {
        Kind.ENV_INIT: Call(_E, _EMPTY, _TEXT),
        Kind.ENV_START: Call(_E, _EMPTY, _OBSERVATION),
        Kind.ENV_STEP: Call(_E, _ACTION, _ENV_STEP_REPLY),
        Kind.ENV_CLEANUP: Call(_E, _EMPTY, _EMPTY),
        Kind.ENV_MESSAGE: Call(_E, _TEXT, _TEXT),
        Kind.ENV_SEED: Call(_E, _SEED, _EMPTY, "seed"),
        Kind.ENV_SAVE: Call(_E, _EMPTY, _BLOB, "save"),
        Kind.ENV_LOAD: Call(_E, _BLOB, _EMPTY, "save"),
        Kind.AGENT_INIT: Call(_A, _TEXT, _EMPTY),
        Kind.AGENT_START: Call(_A, _OBSERVATION, _ACTION),
        Kind.AGENT_STEP: Call(_A, Shape((_REWARD,), Body.OBSERVATION, more=(_DEADLINE, _LATENCY)), _ACTION),
        Kind.AGENT_END: Call(_A, Shape((_REWARD,)), _EMPTY),
        Kind.AGENT_CLEANUP: Call(_A, _EMPTY, _EMPTY),
        Kind.AGENT_MESSAGE: Call(_A, _TEXT, _TEXT),
        Kind.AGENT_SEED: Call(_A, _SEED, _EMPTY, "seed"),
        Kind.AGENT_SAVE: Call(_A, _EMPTY, _BLOB, "save"),
        Kind.AGENT_LOAD: Call(_A, _BLOB, _EMPTY, "save"),
        Kind.AGENT_METRICS: Call(_A, _EMPTY, _OBSERVATION, "metrics"),
        Kind.RL_INIT: Call(None, Shape((Scalar("seed", int, optional=True),)), _TEXT),
        Kind.RL_START: Call(None, _EMPTY, Shape(body=Body.OBSERVATION_ACTION)),
        Kind.RL_STEP: Call(None, _EMPTY, Shape((_REWARD, _TERMINAL), Body.OBSERVATION_ACTION)),
        Kind.RL_EPISODE: Call(
            None, Shape((Scalar("max_steps", int),)), Shape((_TERMINAL,), more=(_RETURN, _NUM_STEPS))
        ),
        Kind.RL_RETURN: Call(None, _EMPTY, Shape((_RETURN,))),
        Kind.RL_NUM_STEPS: Call(None, _EMPTY, Shape((_NUM_STEPS,), more=(Scalar("late", int),))),
        Kind.RL_NUM_EPISODES: Call(None, _EMPTY, Shape((Scalar("num_episodes", int),))),
        Kind.RL_AGENT_MESSAGE: Call(None, _TEXT, _TEXT),
        Kind.RL_ENV_MESSAGE: Call(None, _TEXT, _TEXT),
        Kind.RL_CLEANUP: Call(None, _EMPTY, _EMPTY),
        Kind.RL_ENV_START: Call(None, _EMPTY, _OBSERVATION),
        Kind.RL_ENV_STEP: Call(None, _ACTION, _ENV_STEP_REPLY),
        Kind.RL_AGENT_START: Call(None, _OBSERVATION, _ACTION),
        Kind.RL_AGENT_STEP: Call(None, Shape((_REWARD,), Body.OBSERVATION), _ACTION),
        Kind.RL_AGENT_END: Call(None, Shape((_REWARD,)), _EMPTY),
        Kind.RL_AGENT_SAVE: Call(None, _EMPTY, _BLOB),
        Kind.RL_AGENT_LOAD: Call(None, _BLOB, _EMPTY),
        Kind.RL_ENV_SAVE: Call(None, _EMPTY, _BLOB),
        Kind.RL_ENV_LOAD: Call(None, _BLOB, _EMPTY),
        Kind.RL_AGENT_METRICS: Call(None, _EMPTY, _OBSERVATION),
    }
)

CALL_KINDS: Final = frozenset(CALLS)
"""The kinds of `CALLS`, in which a kind is found faster."""

CONTROL: Final[Mapping[Kind, Shape]] = MappingProxyType(
    {
        Kind.HELLO: Shape(
            (
                Scalar("versions", tuple, items=int),
                Scalar("role", str),
                Scalar("instance", bytes),
                Scalar("name", str),
                Scalar("codec", str),
                Scalar("capabilities", tuple, items=str),
            )
        ),
        Kind.WELCOME: Shape(
            (
                Scalar("version", int),
                Scalar("resumed", bool),
                Scalar("heartbeat", float),
                Scalar("timeout", float),
                Scalar("max_body", int),
            ),
            more=(Scalar("capabilities", tuple, items=str),),
        ),
        Kind.REFUSE: Shape((Scalar("code", str), Scalar("text", str))),
        Kind.HEARTBEAT: _EMPTY,
        Kind.GOODBYE: Shape((Scalar("reason", str),)),
        Kind.ERROR: Shape((Scalar("code", str), Scalar("text", str))),
        Kind.NOTICE: Shape((Scalar("event", str), Scalar("role", str), Scalar("name", str))),
    }
)

OBSERVING: Final[Mapping[Kind, Shape]] = MappingProxyType(
    {
        Kind.OBSERVE: Shape((Scalar("moments", int),)),
        Kind.OBSERVED_INIT: _TEXT,
        Kind.OBSERVED_START: Shape((Scalar("episode", int),), Body.OBSERVATION),
        Kind.OBSERVED_STEP: Shape(
            (Scalar("episode", int), _NUM_STEPS, _RETURN, _REWARD, _TERMINAL), Body.OBSERVATION_ACTION
        ),
        Kind.OBSERVED_MESSAGE: Shape((Scalar("message", str),), Body.TEXT),
    }
)
"""Messages of observers: OBSERVE, which they send, and the messages that they receive."""

"""Every exception of the project descends from `GlueError`.

A message says what was expected, what was received, from whom, and what to do about it. Commands print it
after `Error:`; peers receive a code and the text, never a traceback.
"""

from __future__ import annotations


class GlueError(Exception):
    """The base class: catch this to catch every error that the project raises on purpose.

    Args:
        message: the text, which speaks of settings by their names in Python.
        settings: names of the settings to change, such as `hub_key`; a command shows its options for them.
    """

    def __init__(self, message: object = "", *, settings: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.settings = settings


_MOST_LETTERS = 2000  # of an exception's text


def described(error: BaseException) -> str:
    """Return an exception of anyone's code as a text that can be shown, stored and sent.

    It may be too long to be any of these, have characters that cannot be encoded, or raise another one.
    """
    try:
        text = str(error)
    except Exception:
        text = "(its text cannot be shown)"
    if not isinstance(error, GlueError):
        text = f"{type(error).__name__}: {text}"
    if len(text) > _MOST_LETTERS:
        text = f"{text[:_MOST_LETTERS]}... ({len(text):,} characters)"
    return text.encode("utf-8", "replace").decode()


class LocalProtocolError(GlueError):
    """The caller broke the protocol: a call out of place, or a value that cannot be sent."""


class RemoteProtocolError(GlueError):
    """The peer broke the protocol: it sent something malformed or out of place."""


class TaskSpecError(GlueError):
    """A task spec does not parse; the message names the position and what was expected."""


class ConfigError(GlueError):
    """An option, a name or an address given by the user is wrong; the message says how to correct it."""


class Refused(GlueError):
    """The hub refused this peer; the message says why."""


class SaveError(GlueError):
    """A saved agent or environment is damaged, or was saved by another one; the message says which."""


class HubUnreachable(GlueError):
    """No hub has answered in the time allowed; the message gives the address."""


class PeerLost(GlueError):
    """An agent or environment was lost during an episode; that episode is void.

    Catch it and start the episode again: the hub waits for the peer, or for its replacement.
    """


class PeerFailed(GlueError):
    """An agent or environment raised an exception, or broke the protocol; the run cannot continue."""


class Unsupported(GlueError):
    """An agent or environment was asked for a capability that it does not offer, such as `save`."""


class HubClosed(GlueError):
    """The hub ended the session; the message gives its reason."""


class SimulatorError(GlueError):
    """A simulator was misused: a parameter or action out of range, a step before the start."""


class ExperimentError(GlueError):
    """A plan, a run directory or a store cannot be used as asked."""

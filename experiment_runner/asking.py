"""Asking the agent: the messages of `--ask`, and what is kept of the answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from glue.core.experiment import Experiment

__all__ = ["MAX_ANSWER", "Answer", "ask"]

MAX_ANSWER: Final = 10_000
"""Characters that are kept of an answer."""


class Answer(NamedTuple):
    """What the agent answered to a message."""

    message: str
    answer: str


def ask(glue: Experiment, messages: Sequence[str]) -> tuple[Answer, ...]:
    """Send each message to the agent; return what it answers, as text that can be stored.

    Raises:
        GlueError: the agent was lost, or has failed.
    """
    return tuple(Answer(message, _kept(glue.rl_agent_message(message))) for message in messages)


def _kept(answer: str) -> str:
    """Return the beginning of an answer, which may have been no Unicode when it was sent."""
    return answer[:MAX_ANSWER].encode("utf-8", "replace").decode()

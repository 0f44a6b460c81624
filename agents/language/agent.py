"""The base class of both language agents: a language model chooses their actions."""

from __future__ import annotations

import hashlib
import json
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from threading import Condition
from typing import Any, Final

from agents.language.game import Game
from glue.console import LOG
from glue.roles import Agent
from glue.types import Action, Observation


class LanguageAgent(Agent):
    """An agent whose actions a language model chooses.

    It answers two messages in JSON: `record` with its settings, the SHA-256 of its prompt, the counts of the
    episode and its newest raw answers, and `answers` with the raw answers of the newest choice.

    Args:
        options: of the agent.
    """

    agent_masks = True

    def __init__(self, options: Any) -> None:
        self.options = options
        self.game: Final = Game(options)
        self.changed: Final = Condition()
        """Guards the game, and is notified when it has changed."""

    @property
    @abstractmethod
    def how(self) -> str:
        """How to play by this agent, in words."""

    @abstractmethod
    def choose(self) -> None:
        """Ask the model, or wait for it a little; the game is guarded."""

    @property
    def prompt(self) -> str:
        """The text from which the model knows the game, as far as it is known, and how to play it."""
        return self.how if self.game.texts is None else f"{self.game.texts.rules}\n{self.how}"

    def agent_init(self, task_spec: str) -> None:
        with self.changed:
            self.game.task(task_spec)
            LOG.info("the prompt has the SHA-256 %s", self._digest())
            self.changed.notify_all()

    def agent_start(self, observation: Observation) -> Action:
        with self.changed:
            self.game.start(observation)
            return self._act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        with self.changed:
            self.game.step(reward, observation)
            return self._act()

    def agent_end(self, reward: float) -> None:
        with self.changed:
            self.game.end(reward)
            self.changed.notify_all()

    def agent_cleanup(self) -> None:
        with self.changed:
            self.game.close()
            self.changed.notify_all()

    def agent_message(self, message: str) -> str:
        with self.changed:
            record = {"settings": asdict(self.options), "prompt": self._digest(), **self.game.record()}
        newest = record.pop("newest")
        if message not in ("record", "answers"):
            return "a language model answers the messages record and answers"
        return json.dumps(record if message == "record" else newest, ensure_ascii=False)

    def agent_metrics(self) -> Mapping[str, float]:
        with self.changed:
            return {name: float(count) for name, count in asdict(self.game.counts).items()}

    def _act(self) -> Action:
        self.changed.notify_all()
        while (action := self.game.next_action()) is None:
            self.choose()
        return action

    def _digest(self) -> str:
        return hashlib.sha256(self.prompt.encode()).hexdigest()

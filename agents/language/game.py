"""A game as a language model plays it: its turns, its sequences of actions, what is illegal, and forfeits;
and the base class of the agents that play so.

The agent's role of a session is on one side (`start`, `step`, `end`, `next_action`), a model on the other
(`look`, `act`, `give_up`). Nothing here waits or knows which client asks, so a game survives its clients.

A *turn* is one choice of the model's. Turns are counted over all episodes, and each episode begins with
one of its own, so that none can be played in another episode. A client that repeats the last choice with
its turn gets the same answer, and nothing is done again; any turn but that and the current one is refused.

An episode that is forfeit is played to its end by standing still, as the passive agent of a competition
does: no call of RL-Glue lets an agent end an episode, and were the episode void, who gives up would get
another one in its place. Its actions are in every record like any others.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from enum import Enum, StrEnum
from threading import Condition
from typing import Annotated, Any, Final, NamedTuple

from agents.language.texts import IllegalChoice, Texts
from glue.console import LOG, printable
from glue.errors import ConfigError, GlueError
from glue.options import Option
from glue.roles import Agent
from glue.types import Action, Observation

_MOST_STILL: Final = 10_000
"""Steps after which the passive agent of a competition is cut off, too."""

_MOST_RAW: Final = 3000  # letters of an answer that are kept
_MOST_KEPT: Final = 8000  # letters of the answers of an episode that are kept


class NotNow(GlueError):
    """A choice out of turn; the message names the current one. Nothing was done, and nothing is counted."""


class GameOver(GlueError):
    """The session is over: there is nothing left to play."""


class Until(StrEnum):
    """When a sequence of actions stops early; the end of the episode stops every one."""

    END = "end"
    REWARD = "reward"
    CHANGE = "change"


UNTIL: Final = (
    "end: not at all; reward: after a reward that differs from that of its first action; change: once the "
    "observation differs from that before it"
)
"""The meanings of the values of `Until`."""


@dataclass(kw_only=True)
class GameOptions:
    """Options of all agents that are language models."""

    list_actions: Annotated[bool, Option("list the legal actions with every observation")] = False
    sequence: Annotated[int, Option("maximum number of actions of one choice", low=1, high=10_000)] = 20
    illegal: Annotated[int, Option("illegal choices in a row that forfeit an episode", low=1)] = 5
    seconds: Annotated[
        float, Option("time for an episode's choices, 0 for any", low=0, high=10**9, unit="s")
    ] = 0.0
    steps: Annotated[int, Option("the experiment's step limit, which the model is told", low=0)] = 0


@dataclass
class Counts:
    """Counts of an episode."""

    choices: int = 0
    illegal: int = 0
    repeated: int = 0
    forfeits: int = 0
    tokens_in: int = 0
    tokens_out: int = 0
    seconds: float = 0.0


class Answer(NamedTuple):
    """The answer to a choice or a look.

    Args:
        text: for the model.
        data: the same as values.
        error: whether the choice was illegal.
        image: what is seen, as PNG.
    """

    text: str
    data: Mapping[str, Any]
    error: bool = False
    image: bytes | None = None


class Phase(Enum):
    """Whose turn it is; the values are for people."""

    WAITING = "the experiment has not begun an episode yet"
    CHOOSING = "the model is to choose"
    PLAYING = "the last choice is still being played"
    OVER = "the episode is over, and the experiment has not begun another one yet"
    CLOSED = "the game is over: the session has ended"


@dataclass
class _Episode:
    number: int = 0
    seen: Observation = field(default_factory=Observation)
    steps: int = 0
    reward: float = 0.0  # of the last choice
    total: float = 0.0
    illegal: int = 0  # in a row
    forfeit: str = ""  # why it is
    still: int = 0  # steps since then
    counts: Counts = field(default_factory=Counts)
    raw: list[dict[str, Any]] = field(default_factory=list)
    newest: int = 0  # where the raw answers of the newest choice begin


class Game:
    """The games of a session, or of several in turn: turns are counted over all of them.

    Args:
        options: of the agent.
        clock: returns the time in seconds.
    """

    def __init__(self, options: GameOptions, clock: Callable[[], float] = time.monotonic) -> None:
        self.options: GameOptions = options
        """Those of the agent that plays."""
        self._clock = clock
        self.texts: Texts | None = None
        self.turn: int = 0
        self.phase: Phase = Phase.WAITING
        self._episode = _Episode()
        self._told = False  # the rules
        self._call: tuple[int, object] | None = None  # the last turn and choice
        self._answer: Answer | None = None  # to it; None while it is being played
        self._plan: deque[Action] = deque()
        self._until = ""
        self._began = Observation()  # what was seen before the plan
        self._first: float | None = None  # reward of its first action
        self._asked = 0.0

    # The agent's side.

    def task(self, task_spec: str) -> None:
        """Begin a task; raise as `Texts`."""
        self._go(Phase.WAITING)
        self.texts = Texts(task_spec, self.options.sequence, self.options.list_actions)
        self._told = False

    def start(self, observation: Observation) -> None:
        """Begin an episode; an unfinished one was cut off by the experiment."""
        self._go(Phase.OVER)
        self._episode = _Episode(self._episode.number + 1, observation)
        self.turn += 1
        self._next()

    def step(self, reward: float, observation: Observation) -> None:
        """Take the result of the last action."""
        self._episode.seen = observation
        self._count(reward)
        if not self._episode.forfeit and (self._is_last or self._stops(reward) or not self._goes_on()):
            self._next()

    def end(self, reward: float) -> None:
        """Take the last reward of an episode."""
        self._count(reward)
        self._go(Phase.OVER)

    def rest(self) -> None:
        """End a task; another one may follow, in this session or in the next."""
        self._go(Phase.WAITING)

    def renew(self, options: GameOptions) -> None:
        """Wait for another session, with other options; the last one may have ended at any point."""
        self.rest()
        self.options = options
        self._episode = _Episode()

    def close(self) -> None:
        """End the last session: nothing will be asked any more."""
        self._go(Phase.CLOSED)

    def next_action(self) -> Action | None:
        """Return the next action, or None if the model has to choose first.

        Raises:
            GlueError: an episode that is forfeit does not end.
        """
        assert self.texts is not None
        if self.phase is Phase.PLAYING:
            return self._plan.popleft()
        if self.phase is Phase.CHOOSING:
            if self.time_left > 0:
                return None
            self._forfeit("its time is used up")
        self._episode.still += 1
        if self._episode.still > _MOST_STILL:
            raise GlueError(f"a forfeit episode did not end in {_MOST_STILL} steps: give it a step limit")
        return self.texts.still_at(self._episode.seen)

    @property
    def counts(self) -> Counts:
        """The counts of this episode."""
        return self._episode.counts

    @property
    def time_left(self) -> float:
        """Seconds that are left for the choices of this episode; infinite if they are not limited."""
        running = self._clock() - self._asked if self.phase is Phase.CHOOSING else 0.0
        return max(0.0, (self.options.seconds or math.inf) - self.counts.seconds - running)

    def record(self) -> dict[str, Any]:
        """Return the counts of the episode, its raw answers, and those of the newest choice."""
        now = self._episode
        answers = {"answers": now.raw, "newest": now.raw[now.newest :]}
        return {"episode": now.number, "counts": asdict(now.counts), **answers}

    # The model's side.

    def look(self, image: bool = False) -> Answer:
        """Return the view of the game, perhaps with an image; the first time with the rules.

        Raises:
            GameOver: the session is over.
            ConfigError: the library that draws images is missing.
        """
        if self.phase is Phase.CLOSED:
            raise GameOver(self.phase.value)
        answer = self.view()
        if self.texts is None:
            return answer
        rules = "" if self._told else f"{self.texts.rules}\n\n"
        self._told = True
        picture = self.texts.image(self._episode.seen) if image else None
        return answer._replace(text=rules + answer.text, image=picture)

    def view(self) -> Answer:
        """Return the present observation and the state of the episode."""
        now, options = self._episode, self.options
        left = max(0, options.steps - 1 - now.steps) if options.steps else None
        seconds = round(self.time_left, 3) if options.seconds else None
        over = now.number > 0 and self.phase not in (Phase.CHOOSING, Phase.PLAYING)
        data: dict[str, Any] = {"turn": self.turn, "episode": now.number, "reward": now.reward}
        data |= {"return": now.total, "steps": now.steps, "steps_left": left, "over": over}
        data |= {"forfeit": bool(now.forfeit), "time_left": seconds}
        text = f"Reward {now.reward:g}, return {now.total:g} after {now.steps} steps"
        text += f", {left} steps left" if left is not None else ""
        text += f", {seconds:g} s left" if seconds is not None else ""
        if now.forfeit:
            text = f"The episode is forfeit: {now.forfeit}. {text}."
        elif self.phase is not Phase.CHOOSING or self.texts is None:
            text = f"{self.phase.value.capitalize()}. {text}."
        else:
            text = f"Turn {self.turn}. {text}.\n{self.texts.seen(now.seen)}"
            if options.list_actions:
                data["legal"] = self.texts.legal_at(now.seen)
                text += f"\nLegal actions: {', '.join(data['legal']) or self.texts.form}"
        return Answer(text, data)

    def act(self, turn: int, actions: object, until: str = Until.END) -> None:
        """Take a choice, whose answer is `answer`; see `Texts.actions` for its actions.

        Raises:
            NotNow: it is out of turn.
            GameOver: the session is over.
        """
        if not self._accept(turn, (actions, until)):
            return
        assert self.texts is not None
        try:
            if until not in [*Until]:
                raise IllegalChoice(f"until is one of {', '.join(Until)}")
            self._plan = deque(self.texts.actions(actions, self._episode.seen))
        except IllegalChoice as error:
            self._refuse(str(error))
        else:
            self._episode.illegal = 0
            self._until, self._began, self._first = until, self._episode.seen, None
            self.phase = Phase.PLAYING

    def give_up(self, turn: int) -> None:
        """Forfeit the episode; raise as `act`."""
        if self._accept(turn, None):
            self._forfeit("you have given up")
            self._answer = self.view()

    def answer(self, turn: int) -> Answer | None:
        """Return the answer to the last choice if that was its turn; None while it is being played."""
        return self._answer if self._call is not None and self._call[0] == turn else None

    def note(self, raw: str, tokens_in: int = 0, tokens_out: int = 0) -> None:
        """Keep a raw answer of the model's, and count the tokens that it read and wrote."""
        now, raw = self._episode, printable(raw)
        now.counts.tokens_in += tokens_in
        now.counts.tokens_out += tokens_out
        kept = raw if len(raw) <= _MOST_RAW else f"{raw[:_MOST_RAW]}... ({len(raw)} letters)"
        now.raw.append({"turn": self.turn, "answer": kept})
        while len(json.dumps(now.raw, ensure_ascii=False)) > _MOST_KEPT:
            del now.raw[0]
            now.newest = max(0, now.newest - 1)

    def _accept(self, turn: int, choice: object) -> bool:
        """Return whether a choice is to be carried out; not if it repeats the last one."""
        if (turn, choice) == self._call:
            self.counts.repeated += 1
            return False
        if self.phase is Phase.CLOSED:
            raise GameOver(self.phase.value)
        if turn != self.turn or self.phase is not Phase.CHOOSING:
            why = "another turn is to be played" if turn != self.turn else self.phase.value
            raise NotNow(f"{why}; the current turn is {self.turn}, as look shows")
        self._call, self._answer = (turn, choice), None
        self.counts.choices += 1
        self.counts.seconds += self._clock() - self._asked
        self._asked = self._clock()
        self._episode.reward = 0.0
        self.turn += 1
        return True

    def _refuse(self, why: str) -> None:
        self.counts.illegal += 1
        self._episode.illegal += 1
        left = self.options.illegal - self._episode.illegal
        if left <= 0:
            self._forfeit(f"{self.options.illegal} illegal choices in a row, the last because {why}")
        answer = self.view()
        text = f"Illegal: {why}. Nothing was done, and the current turn is {self.turn}. "
        text += f"After {left} more in a row the episode is forfeit."
        self._answer = answer._replace(text=text if left > 0 else answer.text, error=True)

    def _forfeit(self, why: str) -> None:
        self.counts.forfeits += 1
        if self.phase is Phase.CHOOSING:
            self.counts.seconds += self._clock() - self._asked
        self._episode.forfeit = why
        self.phase = Phase.OVER

    @property
    def _is_last(self) -> bool:
        """Whether the experiment ends the episode now, if its limit is the one that was told."""
        return self._episode.steps == self.options.steps - 1

    def _next(self) -> None:
        """Ask for the next choice, unless the experiment does not take it any more."""
        self._go(Phase.OVER if self._is_last else Phase.CHOOSING)

    def _count(self, reward: float) -> None:
        self._episode.steps += 1
        self._episode.total += reward
        self._episode.reward += reward

    def _goes_on(self) -> bool:
        """Return whether the plan has a next action, which is legal now."""
        assert self.texts is not None
        return bool(self._plan) and self.texts.allows(self._plan[0], self._episode.seen)

    def _stops(self, reward: float) -> bool:
        """Return whether the plan stops early, after an action with this reward."""
        self._first = reward if self._first is None else self._first
        changed = self._until == Until.CHANGE and self._episode.seen.body != self._began.body
        return changed or (self._until == Until.REWARD and reward != self._first)

    def _go(self, phase: Phase) -> None:
        """Go to another phase; if a choice was being played, it has its answer now."""
        played, self.phase = self.phase is Phase.PLAYING, phase
        if phase is Phase.CHOOSING:
            self._asked = self._clock()
            self._episode.newest = len(self._episode.raw)
        if played:
            self._plan.clear()
            self._answer = self.view()


class LanguageAgent(Agent):
    """An agent whose actions a language model chooses.

    It answers two messages in JSON: `record` with its settings, the SHA-256 of its prompt, the counts of the
    episode and its newest raw answers, and `answers` with the raw answers of the newest choice.

    Args:
        options: of the agent.
        former: an agent whose sessions are over, and whose game goes on; None for a game of its own.
    """

    agent_masks = True

    def __init__(self, options: Any, former: LanguageAgent | None = None) -> None:
        self.options = options
        self.game: Final[Game] = Game(options) if former is None else former.game
        self.changed: Final[Condition] = Condition() if former is None else former.changed
        """Guards the game, and is notified when it has changed."""
        with self.changed:
            self.game.renew(options)
            self.changed.notify_all()

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
        with self._guarded():
            self.game.task(task_spec)
            LOG.info("the prompt has the SHA-256 %s", self._digest())
            self.changed.notify_all()

    def agent_start(self, observation: Observation) -> Action:
        with self._guarded():
            self.game.start(observation)
            return self._act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        with self._guarded():
            self.game.step(reward, observation)
            return self._act()

    def agent_end(self, reward: float) -> None:
        with self._guarded():
            self.game.end(reward)
            self.changed.notify_all()

    def agent_cleanup(self) -> None:
        with self._guarded():
            self.game.rest()
            self.changed.notify_all()

    def agent_message(self, message: str) -> str:
        with self._guarded():
            record = {"settings": asdict(self.options), "prompt": self._digest(), **self.game.record()}
        newest = record.pop("newest")
        if message not in ("record", "answers"):
            return "a language model answers the messages record and answers"
        return json.dumps(record if message == "record" else newest, ensure_ascii=False)

    def agent_metrics(self) -> Mapping[str, float]:
        with self._guarded():
            return {name: float(count) for name, count in asdict(self.game.counts).items()}

    def _act(self) -> Action:
        self.changed.notify_all()
        while (action := self.game.next_action()) is None:
            self.choose()
            self._check()
        return action

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Guard the game; raise as `_check`."""
        with self.changed:
            self._check()
            yield

    def _check(self) -> None:
        """Raise ConfigError if the game is another agent's now, which this one would disturb."""
        if self.game.options is not self.options:
            raise ConfigError("one server serves one session: give others a port", settings=("port",))

    def _digest(self) -> str:
        return hashlib.sha256(self.prompt.encode()).hexdigest()

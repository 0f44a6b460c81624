"""The kit as the hub of an agent or environment: the mirror of docs/clients.md, or any other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import Any, Final

import numpy as np

from glue.batches import Ragged, pack_actions, read_batch_task_spec
from glue.client.bodies import READ, write
from glue.conform.clients.harness import Exchange, Harness
from glue.conform.clients.mirror import MirrorAgent, MirrorEnvironment
from glue.conform.rules import PLAYERS, Broken, described
from glue.engine.calls import role_calls
from glue.errors import GlueError
from glue.taskspec import parse_task_spec
from glue.types import Action, Observation
from glue.wire.codec import FROM_HUB, encode
from glue.wire.messages import CALLS, Kind, Message, Role, Value

_KINDS: Final = {
    role: {kind.name.partition("_")[2]: kind for kind, call in CALLS.items() if call.callee is role}
    for role in PLAYERS
}

SPEC: Final = "a task for a mirror, größer als nötig".encode()
"""The mirror's task: not a task spec, so that any answer is legal."""

TASK: Final = (
    b"VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 20) "
    b"ACTIONS INTS (0 1) REWARDS (-1.0 1.0)"
)
"""The task of any other agent: one int, which the kit shows as 0."""

SHOWN: Final = Observation([0], chars=b"ab")
"""An observation that even a client that confuses numbers understands: every number is zero."""


class PlayerHarness(Harness):
    """The kit as the hub of an agent or environment.

    The expected answers are those of our own mirror, `glue.testing.mirror`. Any other player is only given
    calls that are legal in its task, and may give any answer to them.
    """

    seq: int = 0

    _action = Action().body

    @property
    def kinds(self) -> dict[str, Kind]:
        """The calls to the client by their names without its role: AGENT_STEP is `STEP`."""
        return _KINDS[self.role]

    def begin(self) -> None:
        model: Any = MirrorAgent() if self.role is Role.AGENT else MirrorEnvironment()
        self._handlers = role_calls(self.role, model)
        self.seq = 0
        self._plot: Iterator[tuple[str, tuple[Value, ...], bytes]] = cycle(self._episode())

    def _episode(self) -> list[tuple[str, tuple[Value, ...], bytes]]:
        if self.role is Role.AGENT:
            spec, shown = (SPEC, SHOWN.body) if self.mirror else (TASK, Observation([0]).body)
            return [
                ("INIT", (), spec),
                ("START", (), shown),
                ("STEP", (0.0,), shown),
                ("MESSAGE", (), b"how are you?"),
                ("STEP", (0.0,), shown),
                ("END", (0.0,), b""),
                ("START", (), shown),
                ("CLEANUP", (), b""),
            ]
        return [
            ("INIT", (), b""),
            ("START", (), b""),
            ("STEP", (), SHOWN.body),
            ("MESSAGE", (), b"how are you?"),
            ("STEP", (), Observation([0], chars=b"c").body),
            ("START", (), b""),
            ("CLEANUP", (), b""),
        ]

    def exchanges(self) -> int:
        return len(self._episode())

    def prepare(self) -> Exchange:
        name, scalars, body = next(self._plot)
        if name == "STEP" and self.role is Role.ENVIRONMENT and not self.mirror:
            body = self._action
        return self.call(name, *scalars, body=body)

    def with_body(self) -> Exchange:
        name = "START" if self.role is Role.AGENT else "STEP"
        while (exchange := self.prepare()).expected.kind is not self.kinds[name]:
            self.run(exchange)
        return exchange

    def call(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Exchange:
        """Return a call, by default with the next number, and the expected answer."""
        self.seq = self.seq + 1 if seq is None else seq
        kind = self.kinds[name]
        asked = Message(kind, self.session, self.seq, scalars, body)
        answer = Message(kind, self.session, self.seq)
        if self.mirror:
            values, result = self._handlers[kind](scalars, READ[CALLS[kind].request.body](body))
            answer = answer._replace(scalars=values, body=write(result))
        return Exchange(encode(asked, FROM_HUB), answer)

    def ask(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Sequence[bytes]:
        """Call, and expect the answer; return its frames."""
        return self.run(self.call(name, *scalars, body=body, seq=seq))

    def step(self, shown: Observation | Action, reward: float = 0.0) -> Exchange:
        """Return a step that shows `shown` to the mirror; other players get a message, legal at any time."""
        if not self.mirror:
            return self.call("MESSAGE", body=shown.chars)
        scalars = (reward,) if self.role is Role.AGENT else ()
        return self.call("STEP", *scalars, body=shown.body)

    def steps(self, *all_shown: Observation | Action) -> None:
        """Carry out a step with each of `all_shown`."""
        for each in all_shown:
            self.run(self.step(each))

    def settle(self) -> None:
        pass

    def resume(self) -> None:
        pass

    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        again = self.run(exchange)
        if list(again) != list(frames):
            raise Broken("the same bytes as the first time", described(self.decoded(again)), again)

    def took(self, message: Message) -> None:
        """Keep a legal action for an environment that is not the mirror."""
        if message.kind is not Kind.ENV_INIT or self.mirror:
            return
        generator = np.random.default_rng(0)
        try:
            if "batch" in self.capabilities:
                games, task_spec = read_batch_task_spec(message.body.decode())
                actions = parse_task_spec(task_spec).actions
                chosen = [Action(*actions.sample(generator)) for _ in range(games)]
                self._action = pack_actions(Ragged.of(chosen)).body
            else:
                self._action = Action(*parse_task_spec(message.body.decode()).actions.sample(generator)).body
        except (GlueError, UnicodeDecodeError):
            pass  # Without legal actions in its task spec, the empty action is as good as any.

"""Scenes of the capability `batch`: one message carries the observations or actions of many games."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from glue.batches import (
    Batch,
    Ragged,
    batch_task_spec,
    pack_actions,
    pack_batch,
    read_batch_task_spec,
    unpack_actions,
    unpack_batch,
)
from glue.conform.hub.comparing import described
from glue.conform.hub.player import TASK, PlayerHarness
from glue.conform.hub.rules import Broken, NotJudged, Requirement, Rules, Tier
from glue.errors import GlueError, TaskSpecError
from glue.taskspec import parse_task_spec
from glue.types import CUT_OFF, Action, Observation
from glue.wire.messages import Message, Role

RULES: Final = Rules()

_GAMES: Final = 3

_STEPS: Final = 60
"""Number of steps in which the environment's batch is checked."""


@RULES.add(
    Tier.COMPLETE, "batches", name="batch", roles=(Role.AGENT,), level=Requirement.MAY, capability="batch"
)
def acting(kit: PlayerHarness) -> None:
    """An agent is shown a batch, and answers with an action for each of its games."""
    kit.fresh()
    kit.ask("INIT", body=batch_task_spec(_GAMES, TASK.decode()).encode())
    for step, terminals in enumerate(([0, 0, 0], [0, 1, 2], [2, 2, 2], [1, 0, 1], [0, 0, 0])):
        values = [Observation([0])] * (_GAMES + terminals.count(CUT_OFF))
        rewards = np.zeros(_GAMES) if step == 0 else np.array([0.5, -0.25, 1.0])
        body = pack_batch(Batch(rewards, np.array(terminals, np.int32), Ragged.of(values))).body
        name, scalars = ("STEP", (float(rewards.sum()),)) if step else ("START", ())
        answer = _answer(kit, name, *scalars, body=body)
        try:
            unpack_actions(Action.from_body(answer.body), _GAMES)
        except GlueError as error:
            raise Broken(f"the actions of {_GAMES} games: {error}", described(answer)) from None
    kit.drop()  # The client's numbers are not those of the kit's own model.


@RULES.add(
    Tier.COMPLETE,
    "batches",
    name="batch",
    roles=(Role.ENVIRONMENT,),
    level=Requirement.MAY,
    capability="batch",
)
def playing(kit: PlayerHarness) -> None:
    """An environment shows each of its games: rewards, terminals, and last observations of those cut off."""
    kit.fresh()
    text = _answer(kit, "INIT").body.decode()
    try:
        games, inner = read_batch_task_spec(text)
    except GlueError as error:
        raise Broken(f"the task spec of a batch: {error}", repr(text)) from None
    generator = np.random.default_rng(0)
    _checked(_answer(kit, "START"), games, start=True)
    try:
        actions = parse_task_spec(inner).actions
    except TaskSpecError as error:
        raise NotJudged(f"its task spec does not tell the legal actions: {error}") from None
    for _ in range(_STEPS):
        chosen = [Action(*actions.sample(generator)) for _ in range(games)]
        _checked(_answer(kit, "STEP", body=pack_actions(Ragged.of(chosen)).body), games)
    kit.drop()


def _answer(kit: PlayerHarness, name: str, *scalars: float, body: bytes = b"") -> Message:
    """Call a player whose answer is not the mirror's; return the answer."""
    kit.seq += 1
    kind = kit.kinds[name]
    kit.send(kind, *scalars, seq=kit.seq, body=body)
    got, frames = kit.next(f"{kind.name} {kit.seq}")
    if got[:3] != (kind, kit.session, kit.seq):
        raise Broken(f"{kind.name} {kit.seq}", described(got), frames)
    return got


def _checked(answer: Message, games: int, start: bool = False) -> None:
    """Check the batch in the answer to ENV_START or ENV_STEP."""
    try:
        rewards, terminals, _ = unpack_batch(Observation.from_body(answer.body))
    except GlueError as error:
        raise Broken(f"a batch of {games} games: {error}", described(answer)) from None
    wrong = _mistake(rewards.tolist(), terminals.tolist(), answer, games, start)
    if wrong:
        raise Broken(wrong, described(answer))


def _mistake(
    rewards: Sequence[float], terminals: Sequence[int], answer: Message, games: int, start: bool
) -> str:
    if len(rewards) != games or len(terminals) != games:
        return f"rewards and terminals of {games} games"
    if start:
        return "rewards and terminals of 0 at the start" if any(rewards) or any(terminals) else ""
    reward, terminal = answer.scalars
    if terminal is not False:
        return "the terminal false: games of a batch end by themselves"
    if not math.isclose(float(str(reward)), math.fsum(rewards), rel_tol=1e-9, abs_tol=1e-9):
        return f"as reward {math.fsum(rewards)!r}, the sum of the games' rewards"
    return ""

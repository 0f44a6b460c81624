"""Read recordings, episode by episode, without trusting them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glue.files import open_regular
from glue.trajectory import limits, records
from glue.trajectory.steps import ActionSteps, Block, Steps
from glue.trajectory.unpacked import Torn, TrajectoryError, Unpacked
from glue.types import Observation

# The closing quote may be missing: a text that never ends is scanned once, not once per quote inside it.
_TEXT_IN_JSON: Final = re.compile(r'"(?:[^"\\]|\\.)*+"?', re.DOTALL)


class TrajectoryReader:
    """Iterable over the episodes of a file.

    Nothing is trusted: sizes are checked against `glue.trajectory.limits` before allocating memory for them,
    and at most one episode is held at a time. Each iteration reads the file from its beginning.

    Attributes:
        torn: whether the file ends in the middle, as a writer that was killed leaves it; known once
            the last episode has been read. An incomplete episode is left out.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message says where.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        self.torn: bool = False

    def __iter__(self) -> Iterator[records.Episode]:
        self.torn = False
        try:
            with open_regular(self.path) as file:
                unpacked = Unpacked(file, str(self.path))
                while unpacked.next_member(records.MAGIC):
                    yield from _episodes(unpacked)
        except Torn:
            self.torn = True
        except OSError as error:
            raise TrajectoryError(f"cannot read {self.path}: {error.strerror}") from None


def _episodes(unpacked: Unpacked) -> Iterator[records.Episode]:
    """Yield the episodes of one gzip member."""
    run: records.Run | None = None
    messages: list[str] = []
    answers: list[records.Answer] = []
    while not unpacked.at_end():
        if not messages and not answers:
            begin = unpacked.offset
        kind = unpacked.take(1)
        if kind == records.RUN:
            run = _run_from_json(unpacked)
            messages.clear()
            answers.clear()
        elif kind == records.MESSAGE and run is not None:
            messages.append(unpacked.text(limits.MAX_TEXT))
            _check_size(unpacked, begin, len(messages))
        elif kind == records.ANSWER and run is not None:
            answers.append(_answer(unpacked, 0))
            _check_size(unpacked, begin, len(answers))
        elif kind in (records.START, records.BEGIN) and run is not None:
            read = _episode if kind == records.START else _actions_only
            yield read(unpacked, run, tuple(messages), answers, begin)
            messages.clear()
            answers = []
        else:
            raise unpacked.malformed(f"a record {kind!r} where none of that kind can stand")


def _episode(
    unpacked: Unpacked, run: records.Run, messages: tuple[str, ...], answers: list[records.Answer], begin: int
) -> records.Episode:
    """Read an episode from its first observation; `begin` is the offset of its first record."""
    start = Observation.from_body(unpacked.body(limits.MAX_BODY))
    steps = Steps()
    while (kind := unpacked.take(1)) in (records.STEP, records.TERMINAL_STEP, records.ANSWER):
        if kind == records.ANSWER:
            answers.append(_answer(unpacked, len(steps) + 1))
            _check_size(unpacked, begin, len(answers))
            continue
        reward = unpacked.take(records.REWARD.size)
        action, observation = unpacked.action(limits.MAX_BODY), unpacked.body(limits.MAX_BODY)
        steps.append(reward, action, observation, kind == records.TERMINAL_STEP)
        _check_size(unpacked, begin, len(steps))
        if kind == records.TERMINAL_STEP:
            break
    ending = records.Ending.TERMINAL if kind == records.TERMINAL_STEP else records.ENDINGS.get(kind)
    if ending is None or kind == records.TERMINAL_END or (answers and answers[-1].step > len(steps)):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    return records.Episode(run, messages, start, steps, ending, tuple(answers))


def _actions_only(
    unpacked: Unpacked, run: records.Run, messages: tuple[str, ...], answers: list[records.Answer], begin: int
) -> records.Episode:
    """Read an episode without observations; `begin` is the offset of its first record."""
    steps = ActionSteps()
    while (kind := unpacked.take(1)) == records.BLOCK:
        steps.append(_block(unpacked, begin + limits.MAX_EPISODE))
        _check_size(unpacked, begin, 0)
    if kind not in records.ENDINGS or (kind == records.TERMINAL_END and not steps):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    steps.end(kind == records.TERMINAL_END)
    return records.Episode(run, messages, None, steps, records.ENDINGS[kind], tuple(answers))


def _block(unpacked: Unpacked, end: int) -> Block:
    """Read a block of steps, whose actions may not pass the offset `end`."""
    steps, k, m = records.COUNTS.unpack(unpacked.take(records.COUNTS.size))
    if not (1 <= steps <= limits.MAX_BLOCK and 1 <= k <= steps and 1 <= m <= steps):
        raise unpacked.malformed(f"a block of {steps} steps with {k} actions and {m} rewards")
    actions = []
    for _ in range(k):
        actions.append(unpacked.action(limits.MAX_BODY))
        if unpacked.offset > end:
            raise unpacked.malformed(f"an episode of more than {limits.MAX_EPISODE} bytes")

    def column(dtype: str, count: int) -> npt.NDArray[Any]:
        return np.frombuffer(unpacked.take(count * np.dtype(dtype).itemsize), dtype)

    rewards = column("<f8", m)
    choices, paid = column(records.width(k), steps), column(records.width(m), steps)
    if choices.max() >= k or paid.max() >= m:
        raise unpacked.malformed("a step with an action or reward that its block does not have")
    return Block(tuple(actions), choices, rewards[paid])


def _answer(unpacked: Unpacked, step: int) -> records.Answer:
    return records.Answer(step, unpacked.text(limits.MAX_TEXT), unpacked.text(limits.MAX_TEXT))


def _check_size(unpacked: Unpacked, begin: int, count: int) -> None:
    if count > limits.MAX_STEPS or unpacked.offset - begin > limits.MAX_EPISODE:
        raise unpacked.malformed(
            f"an episode of more than {limits.MAX_STEPS} steps, messages or answers, or of more than "
            f"{limits.MAX_EPISODE} bytes"
        )


def _run_from_json(unpacked: Unpacked) -> records.Run:
    text = unpacked.text(limits.MAX_TEXT)
    # 16 MiB of "[]," would become half a gigabyte of lists; a run has few values, some of them long texts.
    if len(_TEXT_IN_JSON.sub("", text)) > limits.MAX_RUN_SYNTAX:
        raise unpacked.malformed(
            f"a run whose JSON has more than {limits.MAX_RUN_SYNTAX} characters outside its texts"
        )
    try:
        fields: Any = json.loads(text)
        run = records.Run(
            environment=fields["environment"],
            options=fields["options"],
            task_spec=fields["task_spec"],
            seed=fields["seed"],
            state=bytes.fromhex(fields["state"]),
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise unpacked.malformed(f"a run that is not the JSON it should be ({error!r})") from None
    if not (
        isinstance(run.environment, str)
        and isinstance(run.options, dict)
        and all(map(records.is_plain, run.options.values()))
        and isinstance(run.task_spec, str)
        and (run.seed is None or (type(run.seed) is int and 0 <= run.seed < 2**63))
    ):
        raise unpacked.malformed("a run with a field of the wrong type")
    return run

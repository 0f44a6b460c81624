"""Read recordings, episode by episode, without trusting them."""

from __future__ import annotations

import json
import os
import re
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glue.files import open_regular
from glue.trajectory import limits
from glue.trajectory.records import (
    ANSWER,
    BEGIN,
    BLOCK,
    COUNTS,
    ENDINGS,
    LATE,
    LATE_BLOCK,
    MAGIC,
    MESSAGE,
    REWARD,
    RUN,
    START,
    STEP,
    TERMINAL_END,
    TERMINAL_STEP,
    Answer,
    Ending,
    Episode,
    Run,
    is_plain,
    width,
)
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

    def __iter__(self) -> Iterator[Episode]:
        self.torn = False
        try:
            with open_regular(self.path) as file:
                unpacked = Unpacked(file, str(self.path))
                while unpacked.next_member(MAGIC):
                    yield from _episodes(unpacked)
        except Torn:
            self.torn = True
        except OSError as error:
            raise TrajectoryError(f"cannot read {self.path}: {error.strerror}") from None


def _episodes(unpacked: Unpacked) -> Iterator[Episode]:
    """Yield the episodes of one gzip member."""
    run: Run | None = None
    messages: list[str] = []
    answers: list[Answer] = []
    while not unpacked.at_end():
        if not messages and not answers:
            begin = unpacked.offset
        kind = unpacked.take(1)
        if kind == RUN:
            run = _run_from_json(unpacked)
            messages.clear()
            answers.clear()
        elif kind == MESSAGE and run is not None:
            messages.append(unpacked.text(limits.MAX_TEXT))
            _check_size(unpacked, begin, len(messages))
        elif kind == ANSWER and run is not None:
            answers.append(_answer(unpacked, 0))
            _check_size(unpacked, begin, len(answers))
        elif kind in (START, BEGIN) and run is not None:
            read = _episode if kind == START else _actions_only
            yield read(unpacked, run, tuple(messages), answers, begin)
            messages.clear()
            answers = []
        else:
            raise unpacked.malformed(f"a record {kind!r} where none of that kind can stand")


def _episode(
    unpacked: Unpacked, run: Run, messages: tuple[str, ...], answers: list[Answer], begin: int
) -> Episode:
    """Read an episode from its first observation; `begin` is the offset of its first record."""
    start = Observation.from_body(unpacked.body(limits.MAX_BODY))
    steps, late = Steps(), array("I")
    while (kind := unpacked.take(1)) in (STEP, TERMINAL_STEP, ANSWER, LATE):
        if kind == ANSWER:
            answers.append(_answer(unpacked, len(steps) + 1))
            _check_size(unpacked, begin, len(answers))
            continue
        if kind == LATE:
            late.append(len(steps) + 1)
            if (kind := unpacked.take(1)) not in (STEP, TERMINAL_STEP):
                raise unpacked.malformed(f"a record {kind!r} where a step is to follow")
        reward = unpacked.take(REWARD.size)
        action, observation = unpacked.action(limits.MAX_BODY), unpacked.body(limits.MAX_BODY)
        steps.append(reward, action, observation, kind == TERMINAL_STEP)
        _check_size(unpacked, begin, len(steps))
        if kind == TERMINAL_STEP:
            break
    ending = Ending.TERMINAL if kind == TERMINAL_STEP else ENDINGS.get(kind)
    if ending is None or kind == TERMINAL_END or (answers and answers[-1].step > len(steps)):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    return Episode(run, messages, start, steps, ending, tuple(answers), late or ())


def _actions_only(
    unpacked: Unpacked, run: Run, messages: tuple[str, ...], answers: list[Answer], begin: int
) -> Episode:
    """Read an episode without observations; `begin` is the offset of its first record."""
    steps, late = ActionSteps(), array("I")
    while (kind := unpacked.take(1)) in (BLOCK, LATE_BLOCK):
        before = len(steps)
        steps.append(_block(unpacked, begin + limits.MAX_EPISODE))
        if kind == LATE_BLOCK:
            count = len(steps) - before
            bits = np.frombuffer(unpacked.take((count + 7) // 8), np.uint8)
            places = np.flatnonzero(np.unpackbits(bits, count=count, bitorder="little"))
            late.frombytes((places + before + 1).astype(np.uintc).tobytes())
        _check_size(unpacked, begin, 0)
    if kind not in ENDINGS or (kind == TERMINAL_END and not steps):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    steps.end(kind == TERMINAL_END)
    return Episode(run, messages, None, steps, ENDINGS[kind], tuple(answers), late or ())


def _block(unpacked: Unpacked, end: int) -> Block:
    """Read a block of steps, whose actions may not pass the offset `end`."""
    steps, k, m = COUNTS.unpack(unpacked.take(COUNTS.size))
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
    choices, paid = column(width(k), steps), column(width(m), steps)
    if choices.max() >= k or paid.max() >= m:
        raise unpacked.malformed("a step with an action or reward that its block does not have")
    return Block(tuple(actions), choices, rewards[paid])


def _answer(unpacked: Unpacked, step: int) -> Answer:
    return Answer(step, unpacked.text(limits.MAX_TEXT), unpacked.text(limits.MAX_TEXT))


def _check_size(unpacked: Unpacked, begin: int, count: int) -> None:
    if count > limits.MAX_STEPS or unpacked.offset - begin > limits.MAX_EPISODE:
        raise unpacked.malformed(
            f"an episode of more than {limits.MAX_STEPS} steps, messages or answers, or of more than "
            f"{limits.MAX_EPISODE} bytes"
        )


def _run_from_json(unpacked: Unpacked) -> Run:
    text = unpacked.text(limits.MAX_TEXT)
    # 16 MiB of "[]," would become half a gigabyte of lists; a run has few values, some of them long texts.
    if len(_TEXT_IN_JSON.sub("", text)) > limits.MAX_RUN_SYNTAX:
        raise unpacked.malformed(
            f"a run whose JSON has more than {limits.MAX_RUN_SYNTAX} characters outside its texts"
        )
    try:
        fields: Any = json.loads(text)
        run = Run(
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
        and all(map(is_plain, run.options.values()))
        and isinstance(run.task_spec, str)
        and (run.seed is None or (type(run.seed) is int and 0 <= run.seed < 2**63))
    ):
        raise unpacked.malformed("a run with a field of the wrong type")
    return run

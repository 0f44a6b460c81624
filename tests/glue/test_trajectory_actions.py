"""Actions-only recordings: written episodes are read back, they are small, and damage is found."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glue.errors import LocalProtocolError
from glue.trajectory import (
    MAGIC,
    ActionSteps,
    ActionWriter,
    Ending,
    Episode,
    Run,
    TrajectoryError,
    TrajectoryReader,
    Transition,
    limits,
)
from glue.trajectory.records import run_record
from glue.types import Action

RUN = Run("corridor", {"length": 21}, "VERSION RL-Glue-3.0 ...", 7)
NOTHING = Action().body
Steps = list[tuple[Action, float]]


def written(path: Path, episodes: list[tuple[Steps, Ending]]) -> Path:
    pieces: list[bytes] = []
    writer = ActionWriter(pieces.append)
    writer.run(RUN)
    for steps, ending in episodes:
        writer.start()
        for action, reward in steps:
            writer.step(action.body, reward)
        writer.end(ending)
    writer.close()
    path.write_bytes(b"".join(pieces))
    return path


def blocks(episode: Episode) -> list[tuple[bytes, bytes]]:
    """Return the body of the action and the bits of the reward of each step."""
    assert isinstance(episode.steps, ActionSteps)
    return [
        (block.actions[choice], struct.pack("<d", reward))
        for block in episode.steps.blocks
        for choice, reward in zip(block.choices.tolist(), block.rewards.tolist(), strict=True)
    ]


ACTIONS = st.builds(Action, st.lists(st.integers(-3, 3), max_size=2), st.lists(st.floats(), max_size=1))
EPISODES = st.lists(
    st.tuples(
        st.lists(st.tuples(ACTIONS, st.floats()), min_size=1, max_size=30), st.sampled_from(list(Ending))
    ),
    max_size=5,
)


@settings(max_examples=50, deadline=None)
@given(recorded=EPISODES)
def test_round_trip(recorded: list[tuple[Steps, Ending]], tmp_path_factory: pytest.TempPathFactory) -> None:
    read = list(TrajectoryReader(written(tmp_path_factory.getbasetemp() / "a.traj", recorded)))
    assert [(episode.run, episode.start, episode.ending) for episode in read] == [
        (RUN, None, ending) for _, ending in recorded
    ]
    for episode, (steps, ending) in zip(read, recorded, strict=True):
        assert blocks(episode) == [(action.body, struct.pack("<d", reward)) for action, reward in steps]
        assert [(step.action, step.observation, step.terminal) for step in episode.steps] == [
            (action, None, ending is Ending.TERMINAL and at == len(steps))
            for at, (action, _) in enumerate(steps, 1)
        ]


@pytest.mark.stage("attacks")
def test_a_long_episode_has_several_blocks(tmp_path: Path) -> None:
    steps: Steps = [(Action([i]), float(i)) for i in range(2 * limits.MAX_BLOCK + 5)]
    long, short = TrajectoryReader(
        written(tmp_path / "a", [(steps, Ending.TERMINAL), (steps[:3], Ending.CUTOFF)])
    )
    assert isinstance(long.steps, ActionSteps)
    assert [len(block.choices) for block in long.steps.blocks] == [limits.MAX_BLOCK, limits.MAX_BLOCK, 5]
    at = limits.MAX_BLOCK
    assert long.steps[at - 1 : at + 1] == tuple(Transition(*steps[i], None, False) for i in (at - 1, at))
    assert long.steps[-1] == Transition(*steps[-1], None, True)
    assert (len(short.steps), short.episode_return) == (3, 3.0)


def test_a_block_ends_before_its_actions_take_much_memory(tmp_path: Path) -> None:
    steps: Steps = [(Action(chars=bytes([i]) * 2**22), 0.0) for i in range(5)]
    [episode] = TrajectoryReader(written(tmp_path / "a", [(steps, Ending.CUTOFF)]))
    assert isinstance(episode.steps, ActionSteps)
    assert [len(block.choices) for block in episode.steps.blocks] == [2, 2, 1]
    assert [step.action for step in episode.steps] == [action for action, _ in steps]


def test_a_step_takes_less_than_four_bytes_even_in_short_episodes_at_random(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    legal = [Action(ints=[d, j, r]) for d in (-1, 0, 1) for j in (0, 1) for r in (0, 1)]
    episodes: list[tuple[Steps, Ending]] = []
    for _ in range(200):
        paid, total, steps = 0.0, 0.0, []
        for n in range(int(rng.integers(10, 40))):
            total = -0.01 * n + float(rng.integers(0, 2))  # like Mario's rewards, whose last bits differ
            steps.append((legal[rng.integers(len(legal))], total - paid))
            paid = total
        episodes.append((steps, Ending.TERMINAL))
    size = written(tmp_path / "a", episodes).stat().st_size
    assert size < 4 * sum(len(steps) for steps, _ in episodes)


def test_a_writer_used_out_of_order_or_over_a_limit_refuses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What it has written until then can be read, with the same limit."""
    pieces: list[bytes] = []
    writer = ActionWriter(pieces.append)
    with pytest.raises(LocalProtocolError):
        writer.start()
    writer.run(RUN)
    with pytest.raises(LocalProtocolError):
        writer.step(NOTHING, 0.0)
    writer.start()
    monkeypatch.setattr(limits, "MAX_BLOCK", 2)
    monkeypatch.setattr(limits, "MAX_EPISODE", 2**20)
    for step in range(104):
        writer.step(Action([step], chars=b"x" * 10_000).body, step)
    with pytest.raises(LocalProtocolError, match="episode of more than 1048576 bytes"):
        writer.step(Action([104], chars=b"x" * 10_000).body, 0.0)
    writer.start()
    writer.step(NOTHING, 0.0)
    writer.close()
    (tmp_path / "a").write_bytes(b"".join(pieces))
    assert [len(episode.steps) for episode in TrajectoryReader(tmp_path / "a")] == [104, 1]


def block(n: int, k: int, m: int, *fields: bytes) -> bytes:
    return b"P" + struct.pack("<III", n, k, m) + b"".join(fields)


ONE = block(1, 1, 1, NOTHING, bytes(8), b"\0", b"\0")
BROKEN = {
    "before run": b"BC",
    "block outside": run_record(RUN) + ONE,
    "whole step inside": run_record(RUN) + b"BS" + bytes(8) + NOTHING * 2 + b"C",
    "block in a whole episode": run_record(RUN) + b"O" + NOTHING + ONE + b"C",
    "its end in a whole episode": run_record(RUN) + b"O" + NOTHING + b"E",
    "terminal without a step": run_record(RUN) + b"BE",
    "more steps than a block may have": run_record(RUN) + b"B" + block(2**32 - 1, 1, 1),
    "more actions than steps": run_record(RUN) + b"B" + block(1, 2, 1, NOTHING * 2, bytes(8), b"\0\0"),
    "more rewards than steps": run_record(RUN) + b"B" + block(1, 1, 2, NOTHING, bytes(16), b"\0\0"),
    "no steps": run_record(RUN) + b"B" + block(0, 0, 0) + b"C",
    "huge action": run_record(RUN) + b"B" + block(1, 1, 1, struct.pack("<4I", 2**32 - 1, 0, 0, 0)),
    "unknown action": run_record(RUN) + b"B" + block(1, 1, 1, NOTHING, bytes(8), b"\1", b"\0") + b"C",
    "unknown reward": run_record(RUN) + b"B" + block(1, 1, 1, NOTHING, bytes(8), b"\0", b"\1") + b"C",
    "half a block": run_record(RUN) + b"B" + ONE[:-1],
    "no end": run_record(RUN) + b"B" + ONE,
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_malformed_file_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(gzip.compress(MAGIC + BROKEN[name]))
    with pytest.raises(TrajectoryError):
        list(TrajectoryReader(tmp_path / "a"))


def test_an_episode_of_too_many_bytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a", [([(Action(chars=b"x" * 100), 0.0)] * 3, Ending.CUTOFF)])
    monkeypatch.setattr(limits, "MAX_EPISODE", 100)
    with pytest.raises(TrajectoryError):
        list(TrajectoryReader(path))

"""The format of a record: what is written is read, it is small, and damage is found."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiment_runner.competition.records.record import (
    MAX_STEPS,
    End,
    PartWriter,
    RecordError,
    RecordFile,
    digest,
    header,
    read_parts,
)
from glue.types import Action

TRIAL = "alice/walk/0"
Steps = list[tuple[bytes, float]]


def written(path: Path, episodes: list[tuple[Steps, End]]) -> Path:
    frames: list[bytes] = [header(TRIAL)]
    writer = PartWriter(frames.append)
    for steps, end in episodes:
        for action, reward in steps:
            writer.step(action, reward)
        writer.end(end)
    writer.flush()
    path.write_bytes(b"".join(frames))
    return path


def read(path: Path) -> list[tuple[Steps, End]]:
    """Return the episodes, their parts joined."""
    episodes: list[tuple[Steps, End]] = []
    steps: Steps = []
    for part in read_parts(path, TRIAL):
        actions = [part.actions[choice] for choice in part.choices.tolist()]
        steps += zip(actions, part.rewards.tolist(), strict=True)
        if part.end is not End.GOES_ON:
            episodes.append((steps, part.end))
            steps = []
    assert not steps
    return episodes


def bits(episodes: list[tuple[Steps, End]]) -> object:
    return [
        ([(action, struct.pack("<d", reward)) for action, reward in steps], end) for steps, end in episodes
    ]


STEPS = st.lists(st.tuples(st.binary(max_size=20), st.floats()), max_size=30)
EPISODES = st.lists(st.tuples(STEPS, st.sampled_from([End.TERMINAL, End.CUT_OFF, End.FORFEIT])), max_size=5)


@settings(max_examples=50, deadline=None)
@given(episodes=EPISODES)
def test_what_is_written_is_read(
    episodes: list[tuple[Steps, End]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "record"
    assert bits(read(written(path, episodes))) == bits(episodes)


def test_a_long_episode_and_many_different_actions_are_split(tmp_path: Path) -> None:
    steps = [(i.to_bytes(4, "little"), float(i)) for i in range(2 * MAX_STEPS + 5)]
    path = written(tmp_path / "record", [(steps, End.TERMINAL), (steps[:3], End.CUT_OFF)])
    assert read(path) == [(steps, End.TERMINAL), (steps[:3], End.CUT_OFF)]
    assert max(len(part.choices) for part in read_parts(path, TRIAL)) == MAX_STEPS


def test_a_step_takes_less_than_four_bytes_even_in_short_episodes_at_random(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    legal = [Action(ints=[d, j, r]).body for d in (-1, 0, 1) for j in (0, 1) for r in (0, 1)]
    episodes: list[tuple[Steps, End]] = []
    for _ in range(200):
        paid, total, steps = 0.0, 0.0, []
        for n in range(int(rng.integers(10, 40))):
            total = -0.01 * n + float(rng.integers(0, 2))  # as Mario's, whose last bits differ
            steps.append((legal[rng.integers(len(legal))], total - paid))
            paid = total
        episodes.append((steps, End.TERMINAL))
    size = written(tmp_path / "record", episodes).stat().st_size
    assert size < 4 * sum(len(steps) for steps, _ in episodes)


def test_every_change_of_a_byte_is_found(tmp_path: Path) -> None:
    path = written(tmp_path / "record", [([(b"a", 1.0), (b"b", 2.0)], End.TERMINAL)])
    whole = path.read_bytes()
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(RecordError):
            list(read_parts(path, TRIAL))


def test_every_end_but_the_right_one_is_found(tmp_path: Path) -> None:
    path = written(tmp_path / "record", [([(b"a", 1.0)], End.TERMINAL)])
    whole = path.read_bytes()
    for size in range(len(header(TRIAL)) + 1, len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(RecordError, match="middle of a frame"):
            list(read_parts(path, TRIAL))


def frame(content: bytes) -> bytes:
    packed = zlib.compress(content)
    return struct.pack("<II", len(packed), zlib.crc32(packed)) + packed


@pytest.mark.parametrize(
    "content",
    [
        b"",
        struct.pack("<IIII", 2**32 - 1, 1, 1, 1),  # more parts than a frame may have
        struct.pack("<IIII", 1, 2**32 - 1, 1, 1),  # more steps
        struct.pack("<IIII", 1, 1, 1, 1) + struct.pack("<I", 9),  # lengths that do not add up
        struct.pack("<IIIIIBI", 1, 1, 1, 1, 1, 1, 2**31),  # an action longer than the frame
        struct.pack("<IIIIIBIdBB", 1, 1, 1, 1, 1, 1, 0, 1.0, 7, 0),  # an action that is not there
        struct.pack("<IIIIIBIdBBB", 1, 1, 1, 1, 1, 1, 0, 1.0, 0, 0, 0),  # a byte too many
        struct.pack("<IIIIIBIdBB", 1, 1, 1, 1, 1, 9, 0, 1.0, 0, 0),  # no such end
        b"\0" * (2**26 + 1),  # a bomb
    ],
)
def test_a_frame_that_nobody_writes_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "record"
    path.write_bytes(header(TRIAL) + frame(content))
    with pytest.raises(RecordError, match="holds no steps"):
        list(read_parts(path, TRIAL))


def test_a_length_without_its_bytes_allocates_nothing(tmp_path: Path) -> None:
    path = tmp_path / "record"
    path.write_bytes(header(TRIAL) + struct.pack("<II", 2**32 - 1, 0))
    with pytest.raises(RecordError):
        list(read_parts(path, TRIAL))


def test_the_record_of_another_trial_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "record", [])
    with pytest.raises(RecordError, match="bob"):
        list(read_parts(path, "bob/walk/0"))


def test_a_file_knows_its_digest(tmp_path: Path) -> None:
    with RecordFile(tmp_path / "deep" / "record", TRIAL) as file:
        writer = PartWriter(file.append)
        writer.step(b"a", 0.5)
        writer.end(End.TERMINAL)
        writer.flush()
        assert file.finish() == digest(tmp_path / "deep" / "record")

"""Trajectories, whole and of actions only: episodes are read back unchanged, and no broken file does harm."""

from __future__ import annotations

import gzip
import json
import math
import resource
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
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
    TrajectoryWriter,
    Transition,
    limits,
)
from glue.trajectory.comparison import Outcomes, compare
from glue.types import Action, Observation
from tests.memory import taking_less_than
from tests.pages import DOCS, blocks

RUN = Run("corridor", {"length": 21, "slip": 0.25, "walls": True, "name": "a"}, "VERSION RL-Glue-3.0 ...", 7)


def observation(number: int) -> Observation:
    return Observation(ints=[number, -number], doubles=[number / 3, -0.0], chars=b"  M  \n" * 3)


def record(path: Path, episodes: int = 3, steps: int = 4) -> None:
    with TrajectoryWriter(path) as recording:
        recording.run(RUN)
        for episode in range(episodes):
            recording.start(observation(episode))
            for step in range(steps):
                recording.step(Action([step]), step / 7, observation(step), step == steps - 1)


def read(path: Path) -> list[Episode]:
    return list(TrajectoryReader(path))


def write_stream(path: Path, *records: bytes) -> Path:
    path.write_bytes(gzip.compress(MAGIC + b"".join(records)))
    return path


def text_record(kind: bytes, text: str) -> bytes:
    return kind + struct.pack("<I", len(text.encode())) + text.encode()


def run_record(**changes: object) -> bytes:
    fields: dict[str, object] = {
        "environment": "corridor",
        "options": {},
        "task_spec": "",
        "seed": None,
        "state": "",
    }
    return text_record(b"R", json.dumps(fields | changes))


def test_what_stands_beside_and_between_is_read_back(tmp_path: Path) -> None:
    """What random recordings leave out: masks and extras, signs of zeros, messages within an episode."""
    full = Observation([1], mask=[True, False], extras={"coins": 3, "way": [0.5]})
    with TrajectoryWriter(tmp_path / "a") as recording:
        recording.run(RUN)
        recording.start(full)
        recording.message("to the next episode")
        recording.step(Action(), -0.0, full, terminal=True)
        recording.start(observation(1))
        recording.message("to an episode of this run")
        recording.run(RUN)
        recording.start(observation(2))
    first, second, third = read(tmp_path / "a")
    assert (first.messages, first.start, first.steps[0].observation) == ((), full, full)
    assert str(first.steps[0].reward) == "-0.0"
    assert (second.messages, second.ending) == (("to the next episode",), Ending.CUTOFF)
    assert (third.messages, third.ending) == ((), Ending.VOID)


bodies = st.tuples(
    st.lists(st.integers(-(2**31), 2**31 - 1), max_size=5),
    st.lists(st.floats(), max_size=5),
    st.binary(max_size=20),
)
steps = st.lists(st.tuples(bodies, st.floats(allow_nan=False), bodies), max_size=6)
plain = st.one_of(st.integers(), st.booleans(), st.text(), st.floats(allow_nan=False, allow_infinity=False))
runs = st.builds(
    Run,
    st.text(),
    st.dictionaries(st.text(), plain, max_size=3),
    st.text(),
    st.none() | st.integers(0, 2**63 - 1),
    st.binary(max_size=20),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    recorded=st.lists(
        st.tuples(runs, st.lists(st.text(), max_size=2), bodies, steps, st.sampled_from(Ending)), max_size=4
    )
)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, recorded: list[tuple]) -> None:  # type: ignore[type-arg]
    path = tmp_path_factory.mktemp("round") / "a.traj"
    expected = []
    with TrajectoryWriter(path) as recording:
        for run, messages, start, path_taken, ending in recorded:
            if ending is Ending.TERMINAL and not path_taken:
                ending = Ending.CUTOFF
            last = len(path_taken) - 1
            taken = tuple(
                Transition(
                    Action(*action), reward, Observation(*seen), ending is Ending.TERMINAL and i == last
                )
                for i, (action, reward, seen) in enumerate(path_taken)
            )
            expected.append(Episode(run, tuple(messages), Observation(*start), taken, ending))
            recording.run(run)
            for message in messages:
                recording.message(message)
            recording.start(Observation(*start))
            for action, reward, observed, terminal in taken:
                assert observed is not None
                recording.step(action, reward, observed, terminal)
            if ending is Ending.VOID:
                recording.void()
            else:
                recording.cutoff()
    assert read(path) == expected


def test_an_answer_belongs_to_the_moment_that_is_noted_next(tmp_path: Path) -> None:
    with TrajectoryWriter(tmp_path / "a") as recording:
        with pytest.raises(LocalProtocolError, match="no run"):
            recording.answer("values", "1")
        recording.run(RUN)
        for episode in range(2):
            recording.message("level 3")
            recording.answer("values", f"{episode}")
            recording.answer("", "ä\n" * 1000)
            recording.start(observation(0))
            recording.step(Action(), 1.0, observation(1), False)
            recording.answer("values", "<script>")
            recording.step(Action(), 1.0, observation(2), True)
        recording.answer("values", "of a moment that does not come")
    first, second = read(tmp_path / "a")
    assert first.messages == second.messages == ("level 3",)
    assert first.answers == ((0, "values", "0"), (0, "", "ä\n" * 1000), (2, "values", "<script>"))
    assert second.answers == ((0, "values", "1"), *first.answers[1:])
    assert len(second.steps) == 2


def test_answers_of_an_episode_are_limited_for_writer_and_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with TrajectoryWriter(tmp_path / "a") as recording:
        recording.run(RUN)
        for number in range(4):
            recording.answer("values", "")
            if number == 0:
                recording.start(observation(0))
            elif number == 2:
                recording.step(Action(), 1.0, observation(1), False)
        monkeypatch.setattr(limits, "MAX_STEPS", 4)
        with pytest.raises(LocalProtocolError, match="more than 4 answers"):
            recording.answer("values", "")
        recording.step(Action(), 1.0, observation(1), True)
    assert len(read(tmp_path / "a")[0].answers) == 4
    monkeypatch.setattr(limits, "MAX_STEPS", 3)
    with pytest.raises(TrajectoryError, match="more than 3 steps, blocks, messages or answers"):
        read(tmp_path / "a")


def test_episode_return_adds_in_order() -> None:
    rewards = [1e16, 1.0, -1e16]
    taken = tuple(Transition(Action(), reward, Observation(), False) for reward in rewards)
    assert Episode(RUN, (), Observation(), taken, Ending.CUTOFF).episode_return == 0.0


def test_file_cut_anywhere_gives_the_whole_episodes_before(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    record(whole)
    expected = read(whole)
    data = whole.read_bytes()
    counts: list[int] = []
    for size in range(len(data)):
        cut = tmp_path / "cut"
        cut.write_bytes(data[:size])
        reader = TrajectoryReader(cut)
        try:
            episodes = list(reader)
        except TrajectoryError:
            assert not counts, "only a file cut before its first record is no recording"
            continue
        assert episodes == expected[: len(episodes)]
        assert reader.torn
        counts.append(len(episodes))
    assert counts == sorted(counts)
    assert set(counts) == {0, 1, 2, 3}


def test_episodes_that_ended_are_on_disk_while_the_writer_is_at_work(tmp_path: Path) -> None:
    path = tmp_path / "a.traj"
    with TrajectoryWriter(path) as recording:
        recording.run(RUN)
        for episode in range(3):
            recording.start(observation(episode))
            recording.step(Action(), 0.5, observation(episode), episode != 1)
            recording.cutoff()
            reader = TrajectoryReader(path)
            assert len(list(reader)) == episode + 1
            assert reader.torn
        recording.start(observation(3))
        recording.step(Action(), 0.5, observation(3), False)
        assert len(read(path)) == 3


def test_joined_files_are_one_recording(tmp_path: Path) -> None:
    record(tmp_path / "a", episodes=2)
    record(tmp_path / "b", episodes=1)
    (tmp_path / "ab").write_bytes((tmp_path / "a").read_bytes() + (tmp_path / "b").read_bytes())
    reader = TrajectoryReader(tmp_path / "ab")
    assert list(reader) == read(tmp_path / "a") + read(tmp_path / "b")
    assert not reader.torn


def test_repeating_observations_take_little_room(tmp_path: Path) -> None:
    record(tmp_path / "a", episodes=20, steps=100)
    raw = 20 * 100 * (len(observation(1).body) + len(Action([1]).body) + 9)
    assert (tmp_path / "a").stat().st_size < raw / 10


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"precious")
    with pytest.raises(TrajectoryError, match="exists already"):
        TrajectoryWriter(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"precious"


def test_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match=r"cannot write .*nowhere"):
        TrajectoryWriter(tmp_path / "nowhere" / "a")
    with pytest.raises(TrajectoryError, match=r"cannot read .*nowhere"):
        read(tmp_path / "nowhere")


def test_full_disk_is_one_clear_error_and_leaves_what_was_stored(tmp_path: Path) -> None:
    path = tmp_path / "a.traj"
    noise = np.random.default_rng(1)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    recording = TrajectoryWriter(path)
    recording.run(RUN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        for _ in range(6):
            recording.start(Observation(chars=noise.bytes(3_000)))
            recording.step(Action(), 0.0, observation(1), True)
        recording.start(Observation(chars=noise.bytes(3_000)))
        with pytest.raises(TrajectoryError, match=r"cannot write .*a\.traj: File too large"):
            recording.step(Action(), 0.0, observation(1), True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    recording.close()
    with pytest.raises(LocalProtocolError, match="closed"):
        recording.run(RUN)
    assert len(read(path)) == 6


def test_writer_used_out_of_order_says_what_is_missing(tmp_path: Path) -> None:
    with TrajectoryWriter(tmp_path / "a") as recording:
        with pytest.raises(LocalProtocolError, match="no run is open"):
            recording.start(observation(1))
        with pytest.raises(LocalProtocolError, match="no run is open"):
            recording.message("hello")
        recording.run(RUN)
        with pytest.raises(LocalProtocolError, match="no episode is open"):
            recording.step(Action(), 0.0, observation(1), False)
        recording.start(observation(1))
        recording.step(Action(), 0.0, observation(2), True)
        with pytest.raises(LocalProtocolError, match="no episode is open"):
            recording.step(Action(), 0.0, observation(1), False)
    assert len(read(tmp_path / "a")) == 1


@pytest.mark.parametrize("value", [None, [1], float("nan"), float("inf")])
def test_option_that_is_not_plain_is_refused(tmp_path: Path, value: object) -> None:
    with (
        TrajectoryWriter(tmp_path / "a") as recording,
        pytest.raises(LocalProtocolError, match="option length cannot be recorded"),
    ):
        recording.run(Run("corridor", {"length": value}, ""))  # type: ignore[dict-item]


def test_message_that_is_not_unicode_is_refused(tmp_path: Path) -> None:
    with TrajectoryWriter(tmp_path / "a") as recording:
        recording.run(RUN)
        with pytest.raises(LocalProtocolError, match="not Unicode"):
            recording.message("\ud800")


def test_limits_hold_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_STEPS", 2)
    monkeypatch.setattr(limits, "MAX_BODY", 100)
    monkeypatch.setattr(limits, "MAX_TEXT", 300)
    monkeypatch.setattr(limits, "MAX_EPISODE", 300)
    with TrajectoryWriter(tmp_path / "a") as recording:
        recording.run(RUN)
        with pytest.raises(LocalProtocolError, match="100 are allowed"):
            recording.start(Observation(chars=b"x" * 100))
        recording.start(Observation())
        recording.step(Action(), 0.0, Observation(), False)
        recording.step(Action(), 0.0, Observation(), False)
        with pytest.raises(LocalProtocolError, match="more than 2 steps"):
            recording.step(Action(), 0.0, Observation(), False)
        recording.start(Observation())
        recording.step(Action(), 0.0, Observation(chars=b"x" * 80), False)
        with pytest.raises(LocalProtocolError, match="more than 300 bytes"):
            recording.step(Action([1] * 20), 0.0, Observation(chars=b"x" * 84), False)
        recording.message("one")
        with pytest.raises(LocalProtocolError, match="300 are allowed"):
            recording.message("x" * 301)
        recording.message("two")
        with pytest.raises(LocalProtocolError, match="more than 2 messages"):
            recording.message("three")
    first, second = read(tmp_path / "a")
    assert (len(first.steps), first.ending) == (2, Ending.CUTOFF)
    assert (len(second.steps), second.ending) == (1, Ending.VOID)


EMPTY = Observation().body
ANSWER = text_record(b"A", "values") + text_record(b"", "3")
BROKEN = {
    "start before run": (b"O" + EMPTY, "a record b'O' where"),
    "message before run": (text_record(b"M", "hello"), "a record b'M' where"),
    "answer before run": (ANSWER, "a record b'A' where"),
    "answer without a step": (run_record() + b"O" + EMPTY + ANSWER + b"C", "b'C' inside an episode"),
    "half an answer": (run_record() + text_record(b"A", "values"), "ends inside a record"),
    "step outside": (run_record() + b"S" + b"\0" * 40, "a record b'S' where"),
    "unknown kind": (run_record() + b"?", "a record b'[?]' where"),
    "unknown kind inside": (run_record() + b"O" + EMPTY + b"?", "b'[?]' inside an episode"),
    "run inside": (run_record() + b"O" + EMPTY + run_record(), "b'R' inside an episode"),
    **{
        f"mark before {after!r}": (
            run_record() + b"O" + EMPTY + b"L" + after + bytes(60),
            "step is to follow",
        )
        for after in (b"C", b"V", b"L")
    },
    "mark at the end": (run_record() + b"O" + EMPTY + b"L", "ends inside a record"),
    "ends in a record": (run_record() + b"O" + EMPTY[:-1], "ends inside a record"),
    "ends in an episode": (run_record() + b"O" + EMPTY, "ends inside a record"),
    "cut mask": (run_record() + b"O" + struct.pack("<4I", 0, 0, 0, 1), "ends inside a record"),
    "action with a mask": (
        run_record() + b"O" + EMPTY + b"S" + bytes(8) + Observation(mask=[True]).body + EMPTY,
        "an action with a mask or extras",
    ),
    "huge body": (run_record() + b"O" + struct.pack("<4I", 2**32 - 1, 2**32 - 1, 0, 0), "bytes; 16777216"),
    "huge text": (b"R" + struct.pack("<I", 2**32 - 1), "a text of 4294967295 bytes"),
    "not UTF-8": (b"R" + struct.pack("<I", 1) + b"\xff", "not UTF-8"),
    "not JSON": (text_record(b"R", "{"), "not the JSON"),
    "deep JSON": (text_record(b"R", "[" * 50_000), "not the JSON"),
    "JSON of another kind": (text_record(b"R", "[1]"), "not the JSON"),
    "missing field": (text_record(b"R", "{}"), "not the JSON"),
    "endless number": (text_record(b"R", "1" * 10_000), "not the JSON"),
    "seed": (run_record(seed=-1), "wrong type"),
    "seed of a float": (run_record(seed=1.0), "wrong type"),
    "options": (run_record(options=[]), "wrong type"),
    "option": (run_record(options={"a": None}), "wrong type"),
    "infinite option": (run_record(options={"a": float("inf")}), "wrong type"),
    "environment": (run_record(environment=3), "wrong type"),
    "task spec": (run_record(task_spec=None), "wrong type"),
    "state": (run_record(state="xy"), "not the JSON"),
}


def block(n: int, k: int, m: int, *fields: bytes) -> bytes:
    return b"P" + struct.pack("<III", n, k, m) + b"".join(fields)


ONE = block(1, 1, 1, EMPTY, bytes(8), b"\0", b"\0")
BROKEN_ACTIONS = {
    "before run": b"BC",
    "block outside": run_record() + ONE,
    "whole step inside": run_record() + b"BS" + bytes(8) + EMPTY * 2 + b"C",
    "block in a whole episode": run_record() + b"O" + EMPTY + ONE + b"C",
    "its end in a whole episode": run_record() + b"O" + EMPTY + b"E",
    "terminal without a step": run_record() + b"BE",
    "more steps than a block may have": run_record() + b"B" + block(2**32 - 1, 1, 1),
    "more actions than steps": run_record() + b"B" + block(1, 2, 1, EMPTY * 2, bytes(8), b"\0\0"),
    "more rewards than steps": run_record() + b"B" + block(1, 1, 2, EMPTY, bytes(16), b"\0\0"),
    "no steps": run_record() + b"B" + block(0, 0, 0) + b"C",
    "huge action": run_record() + b"B" + block(1, 1, 1, struct.pack("<4I", 2**32 - 1, 0, 0, 0)),
    "unknown action": run_record() + b"B" + block(1, 1, 1, EMPTY, bytes(8), b"\1", b"\0") + b"C",
    "unknown reward": run_record() + b"B" + block(1, 1, 1, EMPTY, bytes(8), b"\0", b"\1") + b"C",
    "half a block": run_record() + b"B" + ONE[:-1],
    "no end": run_record() + b"B" + ONE,
}
BROKEN |= {f"actions: {name}": (data, "before byte") for name, data in BROKEN_ACTIONS.items()}


def test_an_episode_of_too_many_blocks_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_STEPS", 3)
    for count in (3, 4):
        write_stream(tmp_path / f"{count}", run_record(), b"B", ONE * count, b"C")
    (episode,) = read(tmp_path / "3")
    assert len(episode.steps) == 3
    with pytest.raises(TrajectoryError, match="more than 3 steps, blocks"):
        read(tmp_path / "4")


def test_message_belongs_to_its_run(tmp_path: Path) -> None:
    episode = b"O" + EMPTY + b"C"
    message = text_record(b"M", "level 3")
    path = write_stream(tmp_path / "a", run_record() + message + run_record() + episode + message + episode)
    assert [taken.messages for taken in read(path)] == [(), ("level 3",)]


@pytest.mark.parametrize("name", BROKEN)
def test_malformed_file_is_one_clear_error(tmp_path: Path, name: str) -> None:
    data, message = BROKEN[name]
    with pytest.raises(TrajectoryError, match=message) as caught:
        read(write_stream(tmp_path / "a.traj", data))
    assert str(tmp_path / "a.traj") in str(caught.value)
    assert "before byte" in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"\x1f\x8b", b"not gzip at all", gzip.compress(b"GLUETRJ2", mtime=0)])
def test_other_files_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(TrajectoryError, match="cannot be read as a recording"):
        read(tmp_path / "a")


def test_damage_is_noticed_by_the_checksum(tmp_path: Path) -> None:
    record(tmp_path / "a")
    data = bytearray((tmp_path / "a").read_bytes())
    data[-6] ^= 1
    (tmp_path / "a").write_bytes(bytes(data))
    with pytest.raises(TrajectoryError, match="incorrect data check"):
        read(tmp_path / "a")


def test_declared_sizes_and_bombs_take_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_EPISODE", 2**20)
    pack = zlib.compressobj(wbits=31)
    step = b"S" + b"\0" * 8 + EMPTY * 2
    packed = pack.compress(MAGIC + run_record() + b"O" + EMPTY)
    for _ in range(64):
        packed += pack.compress(step * 2**14)
    (tmp_path / "bomb").write_bytes(packed + pack.flush())
    claim = run_record() + b"O" + struct.pack("<4I", 0, 0, limits.MAX_BODY - 16, 0)
    write_stream(tmp_path / "claim", claim, b"only this")
    write_stream(tmp_path / "messages", run_record(), text_record(b"M", "x" * 2**18) * 5)
    for name, why in (
        ("bomb", "an episode of more than"),
        ("claim", "ends inside a record"),
        ("messages", "messages or answers"),
    ):
        with taking_less_than(32 * 2**20), pytest.raises(TrajectoryError, match=why):
            read(tmp_path / name)


def test_programs_of_the_documentation_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    manual = DOCS / "trajectories.md"
    programs = [body for _, _, body in blocks(manual.read_text("utf-8"), "python") if "corridor.traj" in body]
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for program in programs:
        exec(compile(program, str(manual), "exec"), names)
    written(tmp_path / "actions.traj", [([(Action([n]), n / 2) for n in (1, 2, 1)], Ending.TERMINAL)])
    *_, (_, steps), _ = records = list(names["read"]("actions.traj"))
    assert "".join(letter for letter, _ in records) == "GRBPE"
    assert steps == [(number / 2, ((), (number,), b"")) for number in (1, 2, 1)]
    assert capsys.readouterr().out == "corridor 2 9.0 terminal\ncorridor 0 0.0 cutoff\nGROSTOC\n"


@pytest.mark.stage("attacks")
def test_small_steps_take_little_more_memory_than_their_bytes(tmp_path: Path) -> None:
    step = b"S" + b"\0" * 8 + EMPTY * 2
    write_stream(tmp_path / "many", run_record(), b"O" + EMPTY, step * 50_000, b"V")
    with taking_less_than(100 * 50_000):
        (episode,) = read(tmp_path / "many")
        assert episode.episode_return == 0.0
        assert len(episode.steps) == 50_000


@pytest.mark.parametrize("text", ["[" + "[]," * 10**6 + "[]]", '"' + '\\"' * 10**6], ids=["lists", "quotes"])
def test_run_of_much_json_is_refused_before_it_is_parsed(tmp_path: Path, text: str) -> None:
    write_stream(tmp_path / "run", text_record(b"R", text))
    with taking_less_than(8 * len(text)), pytest.raises(TrajectoryError, match="JSON"):
        read(tmp_path / "run")


def test_long_texts_of_a_run_are_read_back(tmp_path: Path) -> None:
    run = Run("corridor", {"name": 'a "b" \\ [],' * 20_000}, "VERSION {}," * 20_000, 7, bytes(300_000))
    with TrajectoryWriter(tmp_path / "run") as recording:
        recording.run(run)
        recording.start(observation(1))
    assert read(tmp_path / "run")[0].run == run


# Actions only

Steps = list[tuple[Action, float]]


@contextmanager
def writing(path: Path) -> Iterator[ActionWriter]:
    """Write a recording of a run's actions."""
    with path.open("wb") as file:
        writer = ActionWriter(file.write)
        writer.run(RUN)
        yield writer
        writer.close()


def written(path: Path, episodes: list[tuple[Steps, Ending]]) -> Path:
    with writing(path) as writer:
        for steps, ending in episodes:
            writer.start()
            for action, reward in steps:
                writer.step(action.body, reward)
            writer.end(ending)
    return path


def bits(episode: Episode) -> list[tuple[bytes, bytes]]:
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
def test_round_trip_of_actions(
    recorded: list[tuple[Steps, Ending]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    found = read(written(tmp_path_factory.getbasetemp() / "a.traj", recorded))
    assert [(episode.run, episode.start, episode.ending) for episode in found] == [
        (RUN, None, ending) for _, ending in recorded
    ]
    for episode, (steps, ending) in zip(found, recorded, strict=True):
        assert bits(episode) == [(action.body, struct.pack("<d", reward)) for action, reward in steps]
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


def test_a_writer_of_actions_over_a_limit_refuses(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What it has written until then can be read, with the same limit."""
    monkeypatch.setattr(limits, "MAX_BLOCK", 2)
    monkeypatch.setattr(limits, "MAX_EPISODE", 2**20)
    with writing(tmp_path / "a") as writer:
        writer.start()
        for step in range(104):
            writer.step(Action([step], chars=b"x" * 10_000).body, step)
        with pytest.raises(LocalProtocolError, match="episode of more than 1048576 bytes"):
            writer.step(Action([104], chars=b"x" * 10_000).body, 0.0)
        writer.start()
        writer.step(EMPTY, 0.0)
    assert [len(episode.steps) for episode in TrajectoryReader(tmp_path / "a")] == [104, 1]


def test_an_episode_of_too_many_bytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a", [([(Action(chars=b"x" * 100), 0.0)] * 3, Ending.CUTOFF)])
    monkeypatch.setattr(limits, "MAX_EPISODE", 100)
    with pytest.raises(TrajectoryError):
        list(TrajectoryReader(path))


LATE: list[list[int]] = [[], [1], [4], [2, 3], [1, 2, 3, 4]]


@pytest.mark.parametrize("late", LATE, ids=str)
def test_late_steps_are_marked(tmp_path: Path, late: list[int]) -> None:
    with TrajectoryWriter(tmp_path / "late.traj") as recording:
        recording.run(RUN)
        recording.start(observation(0))
        for step in range(1, 5):
            recording.step(Action([step]), 0.5, observation(step), step == 4, late=step in late)
    record(tmp_path / "none.traj", 1)

    marked, none = read(tmp_path / "late.traj")[0], read(tmp_path / "none.traj")[0]
    assert (list(marked.late), none.late) == (late, ())
    assert [step for step in range(6) if marked.is_late(step)] == late
    sizes = [len(gzip.decompress((tmp_path / f"{name}.traj").read_bytes())) for name in ("late", "none")]
    assert sizes[0] == sizes[1] + len(late)


@pytest.mark.parametrize("late", [*LATE, [70_000, 70_003]], ids=str)
def test_late_steps_are_marked_without_observations(tmp_path: Path, late: list[int]) -> None:
    with writing(tmp_path / "late.traj") as writer:
        for marks in (late, []):
            writer.start()
            for step in range(1, 70_010 if late and late[0] > 4 else 5):  # also in a later block
                writer.step(Action([step % 3]).body, 0.5, late=step in marks)
            writer.end(Ending.CUTOFF)

    marked, none = read(tmp_path / "late.traj")
    assert (list(marked.late), none.late) == (late, ())
    assert marked.steps == none.steps


# The comparison that replays of all recordings share

RECORDED = Outcomes(np.array([1.0, 0.0, math.nan]), True)


@pytest.mark.parametrize(
    ("rewards", "terminal", "step"),
    [
        ([1.0, 0.0, math.nan], True, None),
        ([1.0, -0.0, math.nan], True, 1),
        ([1.0, 0.0, 2.0], True, 2),
        ([1.0, 0.0, math.nan], False, 2),
        ([1.0, 0.0], True, 1),
        ([], False, -1),
    ],
)
def test_the_first_step_that_differs_is_found(rewards: list[float], terminal: bool, step: int | None) -> None:
    found = compare(RECORDED, Outcomes(np.array(rewards, np.float64), terminal))
    assert (found and found[0]) == step


@pytest.mark.parametrize("terminal", [False, True])
def test_an_end_that_the_recording_leaves_open_is_not_compared(terminal: bool) -> None:
    assert compare(RECORDED._replace(terminal=None), RECORDED._replace(terminal=terminal)) is None

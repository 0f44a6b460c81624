"""Replaying recordings: ours of any environment, and those of the original Infinite Mario."""

from __future__ import annotations

import gzip
import json
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from env_server.mario.environment import InfiniteMario
from env_server.mario.pictures import digest_of
from env_server.replay.episodes import (
    Difference,
    Digest,
    GoldenEpisode,
    GoldenReader,
    Moment,
    NotInstalled,
    RecordedRun,
    build_environment,
    digest,
    open_recording,
    recorded_moments,
    replayed_moments,
)
from env_server.toys import MinesEnvironment
from glue import Action, ConfigError, Environment, Observation
from glue.extras import Extra
from glue.options import Value
from glue.trajectory import ActionWriter, Run, TrajectoryError, TrajectoryReader, TrajectoryWriter
from tests import forked
from tests.memory import taking_less_than
from tests.proof import size
from tests.terminal import run_in_terminal

GOLDEN = Path(__file__).parents[2] / "golden" / "mario"


def golden_lines(name: str, episodes: int = 3) -> list[dict[str, Any]]:
    """Return the lines of the first episodes, or levels, of a recording of the original."""
    lines = []
    with gzip.open(GOLDEN / name, "rt", encoding="ascii") as file:
        for text in file:
            lines.append(json.loads(text))
            episodes -= lines[-1]["kind"] in ("end", "level")
            if not episodes:
                break
    return lines


def write_golden(path: Path, lines: list[dict[str, Any]]) -> Path:
    path.write_bytes(gzip.compress("".join(json.dumps(line) + "\n" for line in lines).encode()))
    return path


def as_hashes(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the lines as in a recording with obs = hash."""
    hashed = [{key: value for key, value in line.items() if key not in ("i", "d", "c")} for line in lines]
    return [line | {"obs": "hash"} if line["kind"] == "run" else line for line in hashed]


def exhaust(reader: GoldenReader) -> None:
    for part in reader:
        if isinstance(part, GoldenEpisode):
            list(part.steps)


def build(run: RecordedRun) -> Environment:
    return cast(Environment, InfiniteMario(**cast(Any, run.options)))


def replay(path: Path) -> list[Moment]:
    return list(replayed_moments(open_recording(path), build_environment))


def write_run(path: Path, run: Run, seen: Observation | None = None) -> Path:
    """Record a run that has only begun."""
    with TrajectoryWriter(path) as recording:
        recording.run(run)
        recording.start(seen or Observation([0]))
    return path


def record(
    path: Path, environment: Any, name: str, options: Mapping[str, Value], seed: int, steps: int
) -> None:
    """Record two episodes of random actions, each of at most `steps`; of Mario, on two levels."""
    is_mario = isinstance(environment, InfiniteMario)
    generator = np.random.default_rng(seed)
    seeded = hasattr(environment, "env_seed")
    if seeded:
        environment.env_seed(seed)
    with TrajectoryWriter(path) as recording:
        recording.run(Run(name, options, environment.env_init(), seed if seeded else None))
        for episode in range(2):
            recording.start(environment.env_start())
            for _ in range(steps):
                number = int(generator.integers(4))
                action = Action([1, number % 2, number // 2] if is_mario else [number])
                reward, observation, terminal, *_ = environment.env_step(action)
                recording.step(action, reward, observation, terminal)
                if terminal:
                    break
            if episode == 0 and is_mario:
                recording.message("level level_seed=7")
                environment.env_message("level level_seed=7")
    environment.env_cleanup()


def test_recording_of_hashes_replays(tmp_path: Path) -> None:
    lines = golden_lines("variants.jsonl.gz")
    path = write_golden(tmp_path / "a.jsonl.gz", as_hashes(lines))
    first = next(iter(GoldenReader(path)))
    assert isinstance(first, GoldenEpisode)
    assert isinstance(first.start, Digest)
    assert replay(path) == replay(write_golden(tmp_path / "b.jsonl.gz", lines))


def test_run_that_begins_with_keys_held_replays(tmp_path: Path) -> None:
    lines = golden_lines("variants.jsonl.gz")
    run = lines[0]
    second = next(i for i, line in enumerate(lines) if line["kind"] == "start" and line["episode"] == 1)
    assert lines[second]["keys"] == [0, 1, 0, 0]
    path = write_golden(tmp_path / "a.jsonl.gz", [run, *lines[second:]])
    assert replay(path)[0].observation.doubles[0] > 2  # he took a step to the right


def test_keys_that_the_last_episode_did_not_leave_are_told(tmp_path: Path) -> None:
    lines = golden_lines("variants.jsonl.gz")
    second = next(line for line in lines if line["kind"] == "start" and line["episode"] == 1)
    second["keys"] = [0, 1, 1, 0]  # one more, which leaves the observation the same
    with pytest.raises(
        Difference, match=r"episode 2, start: the keys held: expected \[0, 1, 1, 0\], got \[0, 1, 0, 0\]"
    ):
        replay(write_golden(tmp_path / "a.jsonl.gz", lines))


def moved(field: str, index: int, value: Any) -> Callable[[dict[str, Any]], None]:
    """Return a change of one number or char of a step."""

    def change(step: dict[str, Any]) -> None:
        step[field] = [*step[field][:index], value, *step[field][index + 1 :]]
        step["c"] = "".join(step["c"])

    return change


@pytest.mark.parametrize(
    ("change", "message", "hashed"),
    [
        (lambda step: step.update(r=5.0), r"the reward: expected 5\.0, got ", True),
        (lambda step: step.update(end=1), "terminal: expected True, got False", True),
        (lambda step: step.update(a=[2, 0, 0]), "the environment refused: direction must be from -1", True),
        (moved("i", 0, 3), "the observation: expected hash [0-9a-f]+, got hash ", True),
        (moved("i", 0, 3), r"int 0 \(the camera's column\): expected 3, got 0", False),
        (moved("i", 1, 10), r"int 1 \(kind of sprite 0\): expected 10, got 0", False),
        (moved("i", 4, 1), r"int 4 \(winged of sprite 1\): expected 1, got 0", False),
        (moved("d", 2, 0.5), r"double 2 \(horizontal speed of sprite 0\): expected 0\.5, got ", False),
        (moved("d", 7, 0.0), r"double 7 \(vertical speed of sprite 1\): expected 0\.0, got -0\.0", False),
        (moved("c", 23, "b"), r"char 23 \(row 1, column 1\): expected b'b', got b' '", False),
        (
            lambda step: step.update(i=step["i"][:-2], d=step["d"][:-4]),
            "the observation: expected 3 ints, 4 doubles, 352 chars, got 5 ints, 8 doubles",
            False,
        ),
    ],
)
def test_first_difference_is_told_and_names_the_number(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str, hashed: bool
) -> None:
    lines = golden_lines("episodes.jsonl.gz", 1)
    step = lines[2]
    change(step)
    seen = Observation(step["i"], step["d"], step["c"].encode())
    step["h"] = digest(seen, step["r"], step["end"] == 1).hex()
    path = write_golden(tmp_path / "a.jsonl.gz", as_hashes(lines) if hashed else lines)
    with pytest.raises(Difference, match=f"run dev-0001, episode 1, step 1: {message}"):
        replay(path)


GOOD_RUN = golden_lines("variants.jsonl.gz")[0] | {"id": "a", "obs": "hash"}
START = {"kind": "start", "episode": 0, "keys": [0, 0, 0, 0], "h": "0" * 16}
STEP = {"kind": "step", "a": [1, 0, 0], "r": 0.5, "end": 0, "h": "0" * 16}
LEVEL = golden_lines("levels.jsonl.gz", 1)[0]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([START], "line 1: a line 'start' cannot stand here"),
        ([GOOD_RUN, STEP], "line 2: a line 'step' cannot"),
        ([GOOD_RUN, START, GOOD_RUN], "line 3: a line 'run' cannot"),
        ([{"kind": "what"}], "line 1: a line 'what' cannot"),
        ([{}], "line 1: field 'kind' must be str"),
        ([[1]], "line 1 is not a JSON object"),
        ([GOOD_RUN, START, STEP], "ends in the middle of an episode of a"),
        ([GOOD_RUN | {"id": "\x1b[2J"}], "line 1: field 'id' must be a name"),
        ([GOOD_RUN | {"params": {"a": "b"}}], "line 1: parameter 'a' must be a number"),
        ([GOOD_RUN | {"alpha": "1"}], "line 1: field 'alpha' must be float or int"),
        ([GOOD_RUN | {"level_seed": 1.5}], "line 1: field 'level_seed' must be int"),
        ([GOOD_RUN, START | {"keys": [0, 1]}], r"line 2: field 'keys' must be 4 times 0 or 1, not \[0, 1\]"),
        ([GOOD_RUN, START | {"keys": None}], "line 2: field 'keys' must be list"),
        ([GOOD_RUN, START | {"h": "xyz"}], "line 2: field 'h' must be 16 hexadecimal digits"),
        ([GOOD_RUN, START | {"i": [0], "d": [], "c": ""}], "line 2: its hash is not that of"),
        ([GOOD_RUN, START | {"i": [2**31], "d": [], "c": ""}], "line 2: ints must be"),
        ([GOOD_RUN, START | {"i": [True], "d": [], "c": ""}], "line 2: field 'i' must be a list of int"),
        ([GOOD_RUN, START | {"i": [], "d": [10**400], "c": ""}], "line 2: "),
        ([GOOD_RUN, START | {"i": [], "d": [], "c": "\u2603"}], "line 2: "),
        ([GOOD_RUN, START, STEP | {"a": [2**40]}], "line 3: ints must be"),
        ([GOOD_RUN, START, STEP | {"end": 2}], "line 3: field 'end' must be 0 or 1"),
        ([GOOD_RUN, START, STEP | {"r": None}], "line 3: field 'r' must be float or int"),
        ([GOOD_RUN, START, LEVEL], "line 3: a line 'level' cannot stand here"),
        ([LEVEL | {"width": "370"}], "line 1: field 'width' must be int"),
        ([LEVEL | {"rows": [0]}], "line 1: field 'rows' must be a list of str"),
        ([LEVEL | {"sprites": [[1, 2, 3]]}], "line 1: field 'sprites' must be a list of .column, row"),
        ([LEVEL | {"sprites": [[1, 2, "a", 0]]}], "line 1: field 'sprites' must be a list of"),
        ([LEVEL | {"level_seed": None}], "line 1: field 'level_seed' must be int"),
    ],
)
def test_malformed_recording_of_the_original_is_told_by_its_line(
    tmp_path: Path, lines: list[Any], message: str
) -> None:
    with pytest.raises(TrajectoryError, match=message):
        exhaust(GoldenReader(write_golden(tmp_path / "a.jsonl.gz", lines)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"plain text", "not a gzip file"),
        (gzip.compress(b"{\n", mtime=0), "line 1 is not JSON"),
        (gzip.compress(b"[" * 100_000, mtime=0), "line 1 is not JSON"),
        (gzip.compress(b'{"kind": ' + b"1" * 10_000 + b"}", mtime=0), "line 1 is not JSON"),
        (gzip.compress(b" " * (2**20 + 1), mtime=0), "line 1 has more than 1048576 bytes"),
        (gzip.compress(b'{"kind": "tick"}\n' * 9, mtime=0)[:-9], "is damaged after line"),
    ],
)
def test_other_files_are_refused_as_recordings_of_the_original(
    tmp_path: Path, data: bytes, message: str
) -> None:
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(TrajectoryError, match=message):
        exhaust(GoldenReader(tmp_path / "a"))
    with pytest.raises(TrajectoryError, match=r"cannot read .*nowhere: No such file"):
        exhaust(GoldenReader(tmp_path / "nowhere"))


@pytest.mark.proof
@settings(deadline=None, max_examples=size(25, 200))
@given(seed=st.integers(0, 2**32), packed=st.booleans())
def test_damaged_recording_of_the_original_raises_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, seed: int, packed: bool
) -> None:
    path = tmp_path_factory.mktemp("damage") / "a"
    text = "".join(json.dumps(line) + "\n" for line in golden_lines("variants.jsonl.gz", 1)).encode()
    data = bytearray(gzip.compress(text) if packed else text)
    data[seed % len(data)] ^= 1 << seed % 8
    path.write_bytes(data if packed else gzip.compress(data))
    try:
        exhaust(GoldenReader(path))
    except TrajectoryError:
        return


def test_our_recordings_replay(tmp_path: Path) -> None:
    mario = tmp_path / "mario.traj"
    record(mario, InfiniteMario(level_difficulty=2), "", {"level_difficulty": 2}, seed=4, steps=60)
    moments = list(replayed_moments(open_recording(mario), build))
    assert moments[-1].episode == 2
    assert moments == list(recorded_moments(open_recording(mario)))


def test_a_recording_without_extras_replays_with_them(tmp_path: Path) -> None:
    class Talking(MinesEnvironment):
        extras: ClassVar[dict[str, Extra]] = {"coins": 3}

        def env_start(self) -> Observation:
            return Observation(super().env_start().ints, extras=self.extras)

    seen = MinesEnvironment()
    run = Run("mines", {}, seen.env_init())
    for name, beside in (("older", None), ("newer", Talking.extras), ("other", {"coins": 4})):
        write_run(tmp_path / name, run, Observation(seen.env_start().ints, extras=beside))

    def replayed(name: str) -> list[Moment]:
        return list(replayed_moments(open_recording(tmp_path / name), lambda run: Talking()))

    assert len(replayed("older")) == len(replayed("newer")) == 1
    with pytest.raises(Difference, match=r"beside the observation: .*'coins': 4.*'coins': 3"):
        replayed("other")


@pytest.mark.parametrize("name", ["", "evil.py:Evil", "os:stat_result", "gymnasium:CartPole-v1"])
def test_recording_can_only_name_installed_environments(tmp_path: Path, name: str) -> None:
    with pytest.raises(NotInstalled) as refused:
        replay(write_run(tmp_path / "a", Run(name, {}, "")))
    assert refused.value.name == name


def test_a_recording_does_not_choose_which_file_is_read(tmp_path: Path) -> None:
    level = tmp_path / "level.txt"
    level.write_text("X" * 20)
    with pytest.raises(ConfigError, match="a file as level, but not its SHA-256"):
        build_environment(Run("mario", {"level": str(level)}, ""))
    build_environment(Run("mario", {"level": str(level), "level_digest": digest_of(level)}, ""))


@pytest.mark.parametrize(
    ("options", "kind", "why"),
    [
        ({}, Difference, "the task spec: expected 'VERSION of another time', got 'VERSION RL"),
        ({"length": 3}, ConfigError, "length"),
    ],
)
def test_other_task_spec_is_a_difference_and_an_option_that_there_is_not_is_refused(
    tmp_path: Path, options: dict[str, Value], kind: type[Exception], why: str
) -> None:
    with pytest.raises(kind, match=why):
        replay(write_run(tmp_path / "a", Run("mines", options, "VERSION of another time")))


def test_environments_are_cleaned_up_at_the_end_and_at_a_difference(tmp_path: Path) -> None:
    class Counted(InfiniteMario):
        open_now = 0

        def env_init(self) -> str:
            Counted.open_now += 1
            return super().env_init()

        def env_cleanup(self) -> None:
            Counted.open_now -= 1
            super().env_cleanup()

    lines = golden_lines("variants.jsonl.gz", 9)
    lines[-2] |= {"r": 7.0}
    path = write_golden(tmp_path / "a", as_hashes(lines))
    with pytest.raises(Difference):
        list(replayed_moments(open_recording(path), lambda run: Counted(**cast(Any, run.options))))
    assert Counted.open_now == 0


def test_hashes_alone_cannot_be_shown(tmp_path: Path) -> None:
    path = write_golden(tmp_path / "a", as_hashes(golden_lines("variants.jsonl.gz", 1)))
    with pytest.raises(ConfigError, match="only a hash was recorded"):
        list(recorded_moments(open_recording(path)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"level_seed": 122}, "goal: "),
        ({"width": 371}, "width: expected 371, got 370"),
        ({"yExit": 12}, r"goal: expected \(317, 12\), got \(317, 11\)"),
        ({"rows": ["00" * 370] * 15}, "tile in column 111, row 3: expected '00', got '10'"),
        ({"rows": []}, "tile in column 0, row 0: expected None, got '00'"),
        ({"sprites": [[15, 11, 2, 0]]}, "spawn point 1: expected None, got Spawn"),
        ({"sprites": []}, r"spawn point 0: expected None, got Spawn\(column=15, row=11, kind=2, winged=F"),
    ],
)
def test_level_that_differs_is_told_by_what_differs(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = write_golden(tmp_path / "a", [LEVEL, LEVEL | change])
    task = "level_seed=12. level_type=0 level_difficulty=0 level_width=320"
    with pytest.raises(Difference, match=f"^{task}: the level's {message}"):
        replay(path)


def test_level_out_of_bounds_is_refused_with_the_bound(tmp_path: Path) -> None:
    path = write_golden(tmp_path / "a", [LEVEL | {"level_width": 10**9}])
    with pytest.raises(ConfigError, match="level_width must be from 0 to 2000 tiles"):
        replay(path)


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run glue-replay in a process of its own."""
    return forked.run("glue-replay", *map(str, arguments), cwd=Path())


def test_command_compares_and_counts(tmp_path: Path) -> None:
    hashed = write_golden(tmp_path / "h.jsonl.gz", as_hashes(golden_lines("episodes.jsonl.gz", 1)))
    variants, ticks, levels = (GOLDEN / f"{name}.jsonl.gz" for name in ("variants", "ticks", "levels"))
    done = command("--check", variants, ticks, hashed, levels)
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        f"{variants}: 6 runs, 18 episodes, 697 steps: no difference\n"
        f"{ticks}: 5 runs, 8 episodes, 1333 steps: no difference\n"
        f"{hashed}: 1 run, 1 episode, 212 steps: no difference\n"
        f"{levels}: 120 levels: no difference\n"
    )


def test_command_fails_on_a_difference_in_one_line(tmp_path: Path) -> None:
    lines = as_hashes(golden_lines("episodes.jsonl.gz", 1))
    lines[5]["r"] = 1.0
    path = write_golden(tmp_path / "a.jsonl.gz", lines)
    done = command(path)
    assert done.returncode == 1
    where = f"Error: {path}: run dev-0001, episode 1, step 4: the reward"
    assert done.stderr.endswith(
        f"{where}: expected 1.0, got -0.009999999999999998 (before it, 1 run, 1 episode, 3 steps agree)\n"
    )
    assert done.stdout == ""


def test_command_says_what_is_wrong_with_its_arguments(tmp_path: Path) -> None:
    record(tmp_path / "a", MinesEnvironment(), "mines", {}, seed=1, steps=3)
    cases: list[tuple[list[object], int, str]] = [
        (["--gif", "x.gif", "--check", tmp_path / "a"], 2, "show a part of one FILE"),
        ([tmp_path / "a", "--env-option", "seed=1"], 2, "--env-option needs --env"),
        ([tmp_path / "a", "--env", "mine"], 2, "did you mean mines?"),
        ([tmp_path / "a", "--env", "mines", "--env-option", "sed=1"], 2, "did you mean seed?"),
        ([tmp_path / "a", "--env", "skeleton"], 1, "the task spec: expected"),
        ([tmp_path / "a", "--png", tmp_path / "x.png"], 1, "an observation of Infinite Mario has"),
        ([tmp_path / "a", "--png", tmp_path / "x.png", "--episode", "9"], 2, "no episode 9"),
        ([write_golden(tmp_path / "run", [GOOD_RUN])], 1, "holds no whole episode"),
    ]
    for arguments, code, message in cases:
        done = command(*arguments)
        assert (done.returncode, message in done.stderr) == (code, True), (arguments, done.stderr)
        assert "Traceback" not in done.stderr


def test_command_tells_of_a_recording_that_was_not_closed(tmp_path: Path) -> None:
    record(tmp_path / "whole", MinesEnvironment(), "mines", {}, seed=1, steps=3)
    (tmp_path / "torn").write_bytes((tmp_path / "whole").read_bytes()[:-12])
    done = command(tmp_path / "torn")
    assert done.returncode == 0
    assert "was not closed" in done.stderr
    assert ": no difference" in done.stdout


def test_command_writes_pictures(tmp_path: Path) -> None:
    gif, mp4, png = (tmp_path / f"a.{kind}" for kind in ("gif", "mp4", "png"))
    files = ("--gif", gif, "--mp4", mp4, "--png", png)
    done = command(GOLDEN / "variants.jsonl.gz", "--episode", 2, "--steps", 3, 8, *files)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-3:] == [f"wrote {gif}", f"wrote {mp4}", f"wrote {png}"]
    assert b"ftyp" in mp4.read_bytes()[:12]
    with Image.open(gif) as image:
        assert getattr(image, "n_frames", 1) > 5
    with Image.open(png) as image:
        assert image.size == (640, 480)


def test_command_draws_in_a_terminal_at_its_speed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_golden(tmp_path / "a", golden_lines("variants.jsonl.gz", 2))
    monkeypatch.setenv("NO_COLOR", "1")
    part = ("--episode", "2", "--steps", "2", "4", "--speed", "50")
    status, drawn = run_in_terminal("glue-replay", str(path), *part, cwd=tmp_path)
    assert status == 0, drawn
    assert [step for step in range(8) if f"run var-alpha0, episode 2, step {step}" in drawn] in (
        [2, 4],
        [2, 3, 4],
    )
    assert "::::" in drawn
    assert "\x1b[?25h" in drawn
    assert "2 episodes, 45 steps: no difference" in drawn


class Mine(MinesEnvironment):
    """An environment of a user's own."""


def test_command_compares_with_the_environment_it_is_told_to(tmp_path: Path) -> None:
    own = f"{__file__}:Mine"
    record(tmp_path / "a", MinesEnvironment(random_start=True), own, {"random_start": True}, seed=3, steps=9)
    assert f"if you trust it, add --env {own}" in command(tmp_path / "a").stderr
    assert command(tmp_path / "a", "--env", own).returncode == 0
    done = command(tmp_path / "a", "--env", own, "--env-option", "random_start=no")
    assert "start: int 0: expected" in done.stderr
    record(tmp_path / "b", MinesEnvironment(), "", {}, seed=3, steps=9)
    assert "name it with --env" in command(tmp_path / "b").stderr


def test_long_episode_of_the_original_takes_no_memory(tmp_path: Path) -> None:
    run, start = golden_lines("variants.jsonl.gz", 1)[:2]
    step = {"kind": "step", "a": [0, 0, 0], "r": 0, "end": 0, "h": "0123456789abcdef"}
    path = write_golden(tmp_path / "long", [*as_hashes([run, start]), *[step] * 8_000, {"kind": "end"}])
    with taking_less_than(2**20):
        (episode,) = (part for part in GoldenReader(path) if isinstance(part, GoldenEpisode))
    assert episode.run.name == run["id"]


def test_actions_only_recording_replays_and_shows_the_environments_observations(tmp_path: Path) -> None:
    record(tmp_path / "whole", InfiniteMario(level_seed=7), "mario", {"level_seed": 7}, 3, 30)
    whole = list(TrajectoryReader(tmp_path / "whole"))

    def written(reward: float) -> Path:
        with (tmp_path / "actions").open("wb") as file:
            writer = ActionWriter(file.write)
            writer.run(whole[0].run)
            writer.start()
            for step in whole[0].steps:
                writer.step(step.action.body, step.reward + reward)
            writer.end(whole[0].ending)
            writer.close()
        return tmp_path / "actions"

    shown = [moment.observation for moment in replay(written(0.0))]
    assert shown == [whole[0].start, *(step.observation for step in whole[0].steps)]
    with pytest.raises(ConfigError):
        next(recorded_moments(open_recording(tmp_path / "actions")))
    with pytest.raises(Difference, match="step 1: the reward"):
        replay(written(1.0))


def test_a_folder_is_not_a_recording(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="is a directory"):
        open_recording(tmp_path)

"""Recorded episodes, as the page's server sends them; the files are assumed to be hostile."""

from __future__ import annotations

import io
import json
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from env_server.render.drawing import sprite, tile
from glue.trajectory import Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation, body_size
from tests.experiment_runner.view.pages import Inside
from tests.experiment_runner.view.test_stream import make_run

SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (2 0 9) DOUBLES (-1 POSINF) "
    "CHARCOUNT 3 ACTIONS INTS (0 1) REWARDS (0 1) EXTRA <script>alert(1)</script>"
)
SEEN = Observation([1, 2], [float("nan")], b"\x00<b")


def record(path: Path, *episodes: int, reward: float = 0.5) -> None:
    """Record episodes of the given numbers of steps; the last is cut off, the others are terminal."""
    with TrajectoryWriter(path) as writer:
        writer.run(Run("strange", {}, SPEC))
        for number, steps in enumerate(episodes, 1):
            writer.start(SEEN)
            for step in range(1, steps + 1):
                seen = Observation([step, number], [step / 3], b"abc")
                writer.step(Action([step % 2]), reward, seen, step == steps and number < len(episodes))
            writer.cutoff()


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inside, Path, str]:
    directory = tmp_path_factory.mktemp("runs") / "a"
    make_run(directory).close()
    page = Inside(directory.parent)
    return page, directory, page.run_id("a")


@pytest.fixture
def folder(shown: tuple[Inside, Path, str]) -> Iterator[Path]:
    yield shown[1]
    for path in shown[1].iterdir():
        if path.suffix in (".traj", ".txt"):
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


def listed(shown: tuple[Inside, Path, str]) -> list[dict[str, Any]]:
    page, _, run_id = shown
    found: list[dict[str, Any]] = page.ask(f"/api/recordings/{run_id}").json()
    return found


def test_recordings_are_listed_with_the_length_return_and_end_of_each_episode(
    shown: tuple[Inside, Path, str], folder: Path
) -> None:
    assert listed(shown) == []
    record(folder / "run.traj", 3, 2)
    (found,) = listed(shown)
    assert found == {
        "id": "",
        "name": "run.traj",
        "episodes": [[3, 1.5, "terminal"], [2, 1.0, "cutoff"]],
        "more": False,
        "error": None,
    }


def test_an_episode_is_sent_byte_for_byte(shown: tuple[Inside, Path, str], folder: Path) -> None:
    page, _, run_id = shown
    record(folder / "run.traj", 1, 4)
    answer = page.ask(f"/api/episodes/{run_id}/2")
    assert answer.status == 200
    (size,) = struct.unpack_from("<I", answer.body)
    about, body = json.loads(answer.body[4 : 4 + size]), answer.body[4 + size :]
    assert (about["episode"], about["steps"], about["ending"]) == (2, 4, "cutoff")
    assert about["spec"]["extra"] == "<script>alert(1)</script>"
    assert about["spec"]["observation"] == {
        "ints": [[2, "0 to 9"]],
        "doubles": [[1, "-1 to no limit"]],
        "chars": 3,
    }
    _, episode = TrajectoryReader(folder / "run.traj")
    expected = [(0.0, Action(), episode.start)]
    expected += [(step.reward, step.action, step.observation) for step in episode.steps]
    for reward, action, seen in expected:
        assert struct.unpack_from("<d", body) == (reward,)
        middle = 8 + body_size(body, 8)
        end = middle + body_size(body, middle)
        assert Action.from_body(body[8:middle]) == action
        assert Observation.from_body(body[middle:end]) == seen
        body = body[end:]
    assert body == b""


def test_several_recordings_are_told_apart_and_the_first_has_the_short_names(
    shown: tuple[Inside, Path, str], folder: Path
) -> None:
    page, _, run_id = shown
    record(folder / "a.traj", 1)
    record(folder / "b.traj", 2)
    first, second = listed(shown)
    assert (first["id"], first["name"], second["name"]) == ("", "a.traj", "b.traj")
    assert b'"a.traj"' in page.ask(f"/api/episodes/{run_id}/1").body
    assert b'"b.traj"' in page.ask(f"/api/episodes/{run_id}/{second['id']}-1").body


@pytest.mark.parametrize(
    "episode",
    ["0", "3", "-1", "x", "1e9", "999999999", "00000000-1", "run.traj", "..%2frun.traj", "%00", "%D9%A1"],
)
def test_there_are_no_other_episodes(shown: tuple[Inside, Path, str], folder: Path, episode: str) -> None:
    page, _, run_id = shown
    record(folder / "run.traj", 1, 1)
    answer = page.ask(f"/api/episodes/{run_id}/{episode}")
    assert answer.status == 404
    assert page.ask("/api/episodes/0/1").status == page.ask("/api/recordings/0").status == 404


def test_damaged_files_give_one_error_and_harm_no_other(
    shown: tuple[Inside, Path, str], folder: Path
) -> None:
    page, _, run_id = shown
    record(folder / "good.traj", 2)
    whole = (folder / "good.traj").read_bytes()
    (folder / "bad.traj").write_bytes(whole[:40] + b"\xff" * 40)
    (folder / "empty.traj").write_bytes(b"")
    (folder / "torn.traj").write_bytes(whole[:-20])
    found = {one["name"]: one for one in listed(shown)}
    assert found["good.traj"]["episodes"] == [[2, 1.0, "cutoff"]]
    assert "bad.traj cannot be read as a recording" in found["bad.traj"]["error"]
    assert "empty.traj cannot be read as a recording" in found["empty.traj"]["error"]
    assert (found["torn.traj"]["error"], found["torn.traj"]["episodes"]) == (None, [])  # it is being written
    answer = page.ask(f"/api/episodes/{run_id}/1")  # of bad.traj, the first
    assert answer.status == 422
    assert "bad.traj" in answer.json()["error"]


def test_links_folders_and_pipes_are_no_recordings(shown: tuple[Inside, Path, str], folder: Path) -> None:
    record(folder / "elsewhere.txt", 1)
    (folder / "link.traj").symlink_to(folder / "elsewhere.txt")
    (folder / "folder.traj").mkdir()
    os.mkfifo(folder / "pipe.traj")  # opening it would wait forever
    assert listed(shown) == []


def test_a_return_that_json_has_not_is_sent_as_a_word(shown: tuple[Inside, Path, str], folder: Path) -> None:
    record(folder / "a.traj", 1, reward=float("nan"))
    record(folder / "b.traj", 1, reward=float("-inf"))
    assert [one["episodes"][0][1] for one in listed(shown)] == ["NaN", "-Infinity"]


def test_an_episode_that_is_too_long_is_refused_with_what_shows_it(
    shown: tuple[Inside, Path, str], folder: Path
) -> None:
    page, _, run_id = shown
    record(folder / "long.traj", 100_001)
    answer = page.ask(f"/api/episodes/{run_id}/1")
    assert answer.status == 422
    assert "100000 steps" in answer.json()["error"]
    assert "glue-replay" in answer.json()["error"]


def test_the_sheet_holds_every_sprite_where_it_is_said_to_be(shown: tuple[Inside, Path, str]) -> None:
    page = shown[0]
    answer = page.ask("/drawings/mario/sheet.png")
    assert answer.headers["content-type"] == "image/png"
    sheet = np.asarray(Image.open(io.BytesIO(answer.body)))
    assert sheet.shape[2] == 4
    artwork = page.ask("/drawings/mario/artwork.json").json()
    for name, drawn in (("tile flag", tile("flag")), ("sprite 3 left winged", sprite(3, True, True))):
        left, top, width, height = artwork["places"][name]
        part = sheet[top : top + height, left : left + width]
        assert part.shape[:2] == drawn.shape
        assert ((part[..., 3] == 0) == (drawn == 255)).all()
    assert page.ask("/drawings/toys/map.json").json()[0].startswith("S")
    assert page.ask("/drawings/mario/nothing").status == page.ask("/drawings/..%2f/mario.js").status == 404


def test_a_recording_may_be_made_in_the_folder_of_its_run(tmp_path: Path) -> None:
    from tests.forked import run

    command = "glue-experiment --env skeleton --agent skeleton --episodes 2 --in-process --out a"
    assert run(*command.split(), "--record", "a/run.traj", cwd=tmp_path).returncode == 0
    assert len(list(TrajectoryReader(tmp_path / "a/run.traj"))) == 2

"""Recorded episodes, as the page's server sends them; the files are assumed to be hostile."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from env_server.render.artwork import TILES
from env_server.render.drawing import drawn, sprite
from experiment_runner.view import episodes
from glue.trajectory import Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation
from tests.experiment_runner.view.pages import Answer, Inside, unpacked
from tests.experiment_runner.view.test_stream import make_run
from tests.forked import run

SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (2 0 9) DOUBLES (-1 POSINF) "
    "CHARCOUNT 3 ACTIONS INTS (0 1) REWARDS (0 1) EXTRA <script>alert(1)</script>"
)
SEEN = Observation([1, 2], [float("nan")], b"\x00<b")


def record(path: Path, *lengths: int, reward: float = 0.5) -> None:
    """Record episodes of the given numbers of steps; the last is cut off, the others are terminal."""
    with TrajectoryWriter(path) as writer:
        writer.run(Run("strange", {}, SPEC))
        for number, steps in enumerate(lengths, 1):
            writer.start(SEEN)
            for step in range(1, steps + 1):
                seen = Observation([step, number], [step / 3], b"abc")
                writer.step(Action([step % 2]), reward, seen, step == steps and number < len(lengths))
            writer.cutoff()


class Shown(NamedTuple):
    """A run on a page: its folder, and what the page answers about its recordings."""

    page: Inside
    folder: Path
    id: str

    def listed(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.page.ask(f"/api/recordings/{self.id}").json()
        return found

    def episode(self, name: object) -> Answer:
        return self.page.ask(f"/api/episodes/{self.id}/{name}")


@pytest.fixture
def shown(tmp_path: Path) -> Shown:
    make_run(tmp_path / "a").close()
    page = Inside(tmp_path)
    return Shown(page, tmp_path / "a", page.run_id("a"))


def test_recordings_are_listed_with_the_length_return_and_end_of_each_episode(shown: Shown) -> None:
    assert shown.listed() == []
    record(shown.folder / "run.traj", 3, 2)
    (found,) = shown.listed()
    assert found == {
        "id": "",
        "name": "run.traj",
        "episodes": [[3, 1.5, "terminal"], [2, 1.0, "cutoff"]],
        "more": False,
        "error": None,
    }


def test_an_episode_is_sent_byte_for_byte(shown: Shown) -> None:
    record(shown.folder / "run.traj", 1, 4)
    answer = shown.episode(2)
    assert answer.status == 200
    about, steps = unpacked(answer.body)
    assert (about["episode"], about["steps"], about["ending"]) == (2, 4, "cutoff")
    assert about["spec"]["extra"] == "<script>alert(1)</script>"
    assert about["spec"]["observation"] == {
        "ints": [[2, "0 to 9"]],
        "doubles": [[1, "-1 to no limit"]],
        "chars": 3,
    }
    _, episode = TrajectoryReader(shown.folder / "run.traj")
    expected = [(step.reward, step.action, step.observation) for step in episode.steps]
    assert steps == [(0.0, Action(), episode.start), *expected]


def test_several_recordings_are_told_apart_and_the_first_has_the_short_names(shown: Shown) -> None:
    record(shown.folder / "a.traj", 1)
    record(shown.folder / "b.traj", 2)
    first, second = shown.listed()
    assert (first["id"], first["name"], second["name"]) == ("", "a.traj", "b.traj")
    assert b'"a.traj"' in shown.episode(1).body
    assert b'"b.traj"' in shown.episode(f"{second['id']}-1").body


@pytest.mark.parametrize(
    "episode",
    ["0", "3", "-1", "x", "1e9", "999999999", "00000000-1", "run.traj", "..%2frun.traj", "%00", "%D9%A1"],
)
def test_there_are_no_other_episodes(shown: Shown, episode: str) -> None:
    record(shown.folder / "run.traj", 1, 1)
    answer = shown.episode(episode)
    assert answer.status == 404
    assert shown.page.ask("/api/episodes/0/1").status == shown.page.ask("/api/recordings/0").status == 404


def test_damaged_files_give_one_error_and_harm_no_other(shown: Shown) -> None:
    record(shown.folder / "good.traj", 2)
    whole = (shown.folder / "good.traj").read_bytes()
    (shown.folder / "bad.traj").write_bytes(whole[:40] + b"\xff" * 40)
    (shown.folder / "empty.traj").write_bytes(b"")
    (shown.folder / "torn.traj").write_bytes(whole[:-20])
    found = {one["name"]: one for one in shown.listed()}
    assert found["good.traj"]["episodes"] == [[2, 1.0, "cutoff"]]
    assert "bad.traj cannot be read as a recording" in found["bad.traj"]["error"]
    assert "empty.traj cannot be read as a recording" in found["empty.traj"]["error"]
    assert (found["torn.traj"]["error"], found["torn.traj"]["episodes"]) == (None, [])  # it is being written
    answer = shown.episode(1)  # of bad.traj, the first
    assert answer.status == 422
    assert "bad.traj" in answer.json()["error"]


def test_links_folders_and_pipes_are_no_recordings(shown: Shown) -> None:
    record(shown.folder / "elsewhere.txt", 1)
    (shown.folder / "link.traj").symlink_to(shown.folder / "elsewhere.txt")
    (shown.folder / "folder.traj").mkdir()
    os.mkfifo(shown.folder / "pipe.traj")  # opening it would wait forever
    assert shown.listed() == []


def test_a_return_that_json_has_not_is_sent_as_a_word(shown: Shown) -> None:
    record(shown.folder / "a.traj", 1, reward=float("nan"))
    record(shown.folder / "b.traj", 1, reward=float("-inf"))
    assert [one["episodes"][0][1] for one in shown.listed()] == ["NaN", "-Infinity"]


def test_an_episode_that_is_too_long_is_refused_with_what_shows_it(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(episodes, "_MOST_SENT_STEPS", 100)
    record(shown.folder / "long.traj", 101)
    answer = shown.episode(1)
    assert answer.status == 422
    assert "101 steps: the page shows at most 100 steps" in answer.json()["error"]
    assert "glue-replay" in answer.json()["error"]


def test_the_sheet_holds_every_sprite_where_it_is_said_to_be(shown: Shown) -> None:
    page = shown.page
    answer = page.ask("/drawings/mario/sheet.png")
    assert answer.headers["content-type"] == "image/png"
    sheet = np.asarray(Image.open(io.BytesIO(answer.body)))
    assert sheet.shape[2] == 4
    artwork = page.ask("/drawings/mario/artwork.json").json()
    pictures = {"tile flag": drawn(TILES["flag"]), "sprite 3 left winged": sprite(3, True, True)}
    for name, picture in pictures.items():
        left, top, width, height = artwork["places"][name]
        part = sheet[top : top + height, left : left + width]
        assert part.shape[:2] == picture.shape
        assert ((part[..., 3] == 0) == (picture == 255)).all()
    assert page.ask("/drawings/toys/map.json").json()[0].startswith("S")
    assert page.ask("/drawings/mario/nothing").status == page.ask("/drawings/..%2f/mario.js").status == 404


def test_a_recording_may_be_made_in_the_folder_of_its_run(tmp_path: Path) -> None:
    command = "glue-experiment --env skeleton --agent skeleton --episodes 2 --in-process --out a"
    assert run(*command.split(), "--record", "a/run.traj", cwd=tmp_path).returncode == 0
    assert len(list(TrajectoryReader(tmp_path / "a/run.traj"))) == 2

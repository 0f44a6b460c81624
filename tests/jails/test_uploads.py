"""Images that entrants of a season upload, and what their containers use, in the real engine."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.containers import Containers
from experiment_runner.competition.launching import name_of_run
from experiment_runner.competition.season.images import MODULE
from glue.errors import ConfigError


def uploaded(path: Path, most: int = 2**30) -> dict[str, str]:
    """Return what becomes of an upload to a season in the same folder."""
    command = [sys.executable, "-P", "-m", MODULE, str(most), str(path.parent)]
    with path.open("rb") as file:
        done = subprocess.run(command, stdin=file, capture_output=True, text=True, timeout=600, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


def test_an_upload_takes_over_no_name_and_keeps_its_id(
    engine: Any, image: Callable[..., str], tmp_path: Path
) -> None:
    hostile = image("RUN echo hostile > /who", "CMD id")
    ours = image("RUN echo ours > /who", "CMD id")
    hostile_id, our_id = engine.images.get(hostile).id, engine.images.get(ours).id
    engine.images.get(hostile).tag(*ours.split(":"))  # for the moment of saving, it has our name
    saved = tmp_path / "hostile.tar"
    subprocess.run(["docker", "save", "--output", str(saved), ours], check=True, timeout=60)
    engine.images.get(our_id).tag(*ours.split(":"))
    engine.images.remove(hostile, force=True)
    name = f"glue-season/{name_of_run(tmp_path)}:{hostile_id.rpartition(':')[2][:12]}"
    try:
        assert uploaded(saved) == {"id": hostile_id}
        assert engine.images.get(ours).id == our_id
        tags = engine.images.get(hostile_id).tags
        assert tags == [name]
    finally:
        engine.images.get(hostile_id).tag(*hostile.split(":"))
        engine.images.remove(name)


def test_an_upload_that_would_be_too_large_never_reaches_the_engine(
    engine: Any, image: Callable[..., str], tmp_path: Path
) -> None:
    saved = tmp_path / "image.tar"
    subprocess.run(["docker", "save", "--output", str(saved), image("CMD id")], check=True, timeout=60)
    before = len(engine.images.list(all=True))
    assert "too large" in uploaded(saved, 2**20)["error"]
    assert len(engine.images.list(all=True)) == before


def test_an_image_is_judged_by_what_the_engine_has_read(
    engine: Any, image: Callable[..., str], tmp_path: Path
) -> None:
    saved = tmp_path / "image.tar"
    tag = image("VOLUME /data", "CMD id")
    subprocess.run(["docker", "save", "--output", str(saved), tag], check=True, timeout=60)
    with saved.open("rb") as file, pytest.raises(ConfigError, match="VOLUME"):
        Containers().load(file, "glue-season/test")
    Containers().tidy("glue-season/test", (), datetime.now(UTC) + timedelta(hours=1))
    assert not engine.images.list(name="glue-season/test")


def test_images_with_which_nobody_plays_leave_the_engine(engine: Any, image: Callable[..., str]) -> None:
    made = [engine.images.get(image(f"RUN echo {name} > /who", "CMD id")) for name in ("played", "unused")]
    for number, one in enumerate(made):
        one.tag("glue-season/test", f"{number}")

    def left() -> list[str]:
        found = (tag for one in engine.images.list(name="glue-season/test") for tag in one.tags)
        return sorted(tag for tag in found if tag.startswith("glue-season/test:"))

    played, now = {made[0].id}, datetime.now(UTC)
    Containers().tidy("glue-season/test", played, now - timedelta(hours=1))
    assert left() == ["glue-season/test:0", "glue-season/test:1"]  # they may be about to play
    Containers().tidy("glue-season/test", played, now + timedelta(hours=1))
    assert left() == ["glue-season/test:0"]
    assert len(engine.images.get(made[1].id).tags) == 1  # the name that is not the season's
    Containers().tidy("glue-season/test", (), now + timedelta(hours=1))
    assert not left()

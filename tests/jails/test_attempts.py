"""An image in a season: it plays as it was admitted, and what its engine does costs its owner nothing."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.course import course_of
from experiment_runner.competition.jail import LABEL
from experiment_runner.competition.launching import name_of_run
from experiment_runner.competition.season.control import NoServer, ask
from experiment_runner.competition.state import Enrolled
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests import forked
from tests.forked import BIN
from tests.system.runs import wait_until

TAG = "glue-test/season"

FILE = """\
seed_file = "secret.txt"
limits.memory = "256m"
tasks.mines = { env = "mines", steps = 5_000, phase = "proving" }
entrants.alice.image = "glue-test/season"
[season]
opens = 2020-01-01T00:00:00
closes = 2100-01-01T00:00:00
enrol = "closed"
"""


class Served:
    """A season that is served in a process of its own.

    Args:
        folder: of its file and its run.
        engine: where it plays.
    """

    def __init__(self, folder: Path, engine: Any) -> None:
        (folder / "spring.toml").write_text(FILE)
        (folder / "secret.txt").write_text("xyzzy")
        self.run = folder / "run"
        self._engine = engine
        serve = [str(BIN / "glue-compete"), "serve", "spring.toml", "--out", "run"]
        self.server = subprocess.Popen(serve, cwd=folder, env=os.environ)

    def containers(self) -> list[Any]:
        label = f"{LABEL}={name_of_run(self.run)}"
        return list(self._engine.containers.list(filters={"label": label}))

    @property
    def entrant(self) -> Enrolled:
        return course_of(self.run).state.entrants["alice"]

    def over(self) -> int:
        with suppress(ExperimentError):
            return sum(one.state == "over" for one in self.entrant.attempts.values())
        return 0

    def act(self, kind: str, **more: object) -> bool:
        with suppress(NoServer):
            return bool(ask(self.run, {"do": "act", "act": kind, "why": "a test", **more})["ok"])
        return False


@pytest.fixture
def served(engine: Any, build: Callable[[str], str], tmp_path: Path) -> Iterator[Served]:
    """A season in which an honest image plays."""
    engine.images.get(build("honest")).tag(TAG)
    made = Served(tmp_path, engine)
    yield made
    made.server.kill()
    made.server.wait()
    engine.images.remove(TAG, force=True)


def test_an_image_plays_as_it_was_admitted_however_its_tag_moves_and_its_engine_ends_it(
    served: Served, engine: Any, build: Callable[[str], str], tmp_path: Path
) -> None:
    crashes = engine.images.get(build("crashes"))
    wait_until(served.containers, "the container")
    crashes.tag(TAG)
    for container in served.containers():
        container.kill()
    wait_until(lambda: served.over() == 1, "the first attempt")
    assert served.act("rerun", subject="alice")
    wait_until(lambda: served.over() == 2, "the second attempt")
    assert served.act("close")
    assert served.server.wait(120) == 0
    verified = forked.run("glue-compete", "verify", "run", cwd=tmp_path)
    assert "2 of 2 trials are verified" in verified.stderr
    with Results.open(served.run) as results:
        first, second = results.verdicts()["alice/mines/0"], results.verdicts()["alice/mines/1"]
        assert first.score == second.score
        assert [one.reason for one in results.outcomes().values()] == [None, None]
        assert any("told to kill" in event.text for event in results.events())


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_an_attempt_costs_nothing_more_when_the_engine_is_started_again(
    served: Served, how: signal.Signals, tmp_path: Path
) -> None:
    wait_until(served.containers, "the container")
    os.kill(_process_of_our_engine(), how)
    wait_until(lambda: served.over() == 1, "an attempt")
    entrant = served.entrant
    assert [one.state for one in entrant.attempts.values() if one.state != "ours"] == ["over"]
    assert [one.why for one in entrant.attempts.values() if one.state == "over"] == [""]
    assert entrant.used.total() == 1
    assert served.act("close")
    assert served.server.wait(120) == 0
    forked.run("glue-compete", "verify", "run", cwd=tmp_path, status=0)
    with Results.open(served.run) as results:
        lost = "went away" if how is signal.SIGKILL else "was told to kill"
        assert any(f"the container engine {lost}" in event.text for event in results.events())


def _process_of_our_engine() -> int:
    """Return the process of the engine that docker/engine has started, and starts again."""
    address = os.environ.get("DOCKER_HOST", "")
    if "/glue-docker." in address:
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with suppress(OSError):
                words = path.read_bytes().split(b"\0")
                if words[0] == b"dockerd" and address.encode() in words:
                    return int(path.parent.name)
    pytest.skip("the engine is not one of docker/engine: others may use it")

"""An image in a season: it plays as it was admitted, and what its engine does costs its owner nothing."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from experiment_runner.competition.course import course_of
from experiment_runner.competition.jail import LABEL
from experiment_runner.competition.season.control import NoServer, ask
from experiment_runner.competition.season.state import SeasonState
from experiment_runner.competition.starters import name_of_run
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests import forked
from tests.forked import BIN
from tests.system.runs import wait_until

TAG = "glue-test/season"

FILE = """\
seed_file = "secret.txt"
[season]
opens = {opens}
closes = {closes}
enrol = "closed"
[limits]
memory = "256m"
[tasks.mines]
env = "mines"
steps = 5_000
phase = "proving"
[entrants.alice]
image = "glue-test/season"
"""


def test_an_image_plays_as_it_was_admitted_however_its_tag_moves_and_its_engine_ends_it(
    engine: Any, build: Callable[[str], str], tmp_path: Path
) -> None:
    honest, crashes = (engine.images.get(build(name)) for name in ("honest", "crashes"))
    honest.tag(TAG)
    now = datetime.now(UTC)
    opens, closes = ((now + timedelta(days=days)).isoformat(timespec="seconds") for days in (-1, 1))
    (tmp_path / "spring.toml").write_text(FILE.format(opens=opens, closes=closes))
    (tmp_path / "secret.txt").write_text("xyzzy")
    run = tmp_path / "run"
    serve = [str(BIN / "glue-compete"), "serve", "spring.toml", "--out", "run"]
    server = subprocess.Popen(serve, cwd=tmp_path, env=os.environ)

    def containers() -> list[Any]:
        return list(engine.containers.list(filters={"label": f"{LABEL}={name_of_run(run)}"}))

    def over() -> int:
        with suppress(ExperimentError):
            return len(SeasonState.of(course_of(run)).attempts("over"))
        return 0

    def act(kind: str, **more: object) -> bool:
        with suppress(NoServer):
            return bool(ask(run, {"do": "act", "act": kind, "why": "a test", **more})["ok"])
        return False

    try:
        wait_until(containers, "the container")
        crashes.tag(TAG)
        for container in containers():
            container.kill()
        wait_until(lambda: over() == 1, "the first attempt")
        assert act("rerun", subject="alice")
        wait_until(lambda: over() == 2, "the second attempt")
        assert act("close")
        assert server.wait(60) == 0
    finally:
        server.kill()
        engine.images.remove(TAG, force=True)
    verified = forked.run("glue-compete", "verify", "run", cwd=tmp_path)
    assert "2 of 2 trials are verified" in verified.stderr
    with Results.open(run) as results:
        first, second = results.verdicts()["alice/mines/0"], results.verdicts()["alice/mines/1"]
        assert first.score == second.score
        assert [one.reason for one in results.outcomes().values()] == [None, None]
        assert any("told to kill" in event.text for event in results.events())

"""The original test suites, in one process and in three: the same numbers everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from glue import connect, local
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from tests.forked import Recorded
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import main
from tests.system.conformance import SCENARIOS, Seen


@pytest.fixture(scope="module")
def seen_in_one_process() -> dict[str, Seen]:
    return {name: case.run(local(case.agent(), case.environment())) for name, case in SCENARIOS.items()}


@pytest.fixture(scope="module", params=["tcp", pytest.param("ipc", marks=pytest.mark.stage("conformance"))])
def hub(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a hub with an agent and an environment for each scenario, in two more processes."""
    path: Path = tmp_path_factory.mktemp("hub") / "hub.sock"
    url = "tcp://127.0.0.1:*" if request.param == "tcp" else f"ipc://{path}"
    with Hub(HubConfig(bind=(url,))).in_background() as hub:
        (endpoint,) = hub.endpoints
        programs = "tests.system.conformance"
        players = [Recorded(main, role, endpoint, f"{programs}:{role}s") for role in ("agent", "environment")]
        yield endpoint
    for player in players:
        player.wait(TIMEOUT)
        player.kill()


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_gives_the_same_numbers_in_three_processes(
    seen_in_one_process: dict[str, Seen], hub: str, name: str
) -> None:
    with connect(hub, session=name) as glue:
        assert SCENARIOS[name].run(glue) == seen_in_one_process[name]

"""What glue-hub says, and how much of it."""

from __future__ import annotations

import re

from glue.client.experiment import connect
from tests.system.peer import TIMEOUT, running

PROGRAM = "from glue.hub.command import main; main()"


def said(*options: str) -> list[str]:
    """What a hub says of an experiment that comes and goes, after its address."""
    with running("-c", PROGRAM, "--bind", "tcp://127.0.0.1:*", "--heartbeat", "0.05", *options) as hub:
        assert hub.stderr is not None
        url = hub.stderr.readline().split()[-1]
        with connect(url, "s", log=lambda line: None) as glue:
            assert glue.rl_num_episodes() == 0
        with connect(url, "s", log=lambda line: None):
            pass  # once it is in, the hub has heard that the first has left
        hub.terminate()
        _, rest = hub.communicate(timeout=TIMEOUT)
        return [line for line in rest.splitlines() if line not in ("", "interrupted")]


def test_lines_about_peers_have_the_time() -> None:
    lines = said()
    stamp = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d "
    assert all(re.match(stamp, line) for line in lines)
    assert "session 's': experiment" in lines[0]
    assert not any("connected" in line for line in lines)
    assert any(line.endswith("stopped by SIGTERM") for line in lines), lines


def test_a_quiet_hub_says_its_address_alone() -> None:
    assert said("--quiet") == []


def test_a_verbose_hub_mentions_every_connection() -> None:
    assert sum(line.endswith("connected") for line in said("--verbose")) == 2


def test_quiet_and_verbose_exclude_each_other() -> None:
    with running("-c", PROGRAM, "--quiet", "--verbose") as hub:
        _, text = hub.communicate(timeout=TIMEOUT)
    assert hub.returncode == 2
    assert "--quiet and --verbose" in text

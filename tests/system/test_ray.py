"""The same trials on a Ray cluster of two nodes, both on this machine."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from experiment_runner.competition.course import course_of
from experiment_runner.competition.season.control import ask
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests import forked
from tests.forked import BIN
from tests.pages import DOCS, follow
from tests.system.runs import contents, run, wait_until
from tests.system.test_workers import FAULTY, MINES, SARSA

pytest.importorskip("ray", reason="needs the extra `ray`; .ci/run installs it")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


SEARCH = """
episodes = 60
max_steps = 30
seed = 5
[environments.mines]
random_start = true
[agents.sarsa]
[tune]
configurations = 5
trials = 2
final = 3
prune = true
[tune.agents.sarsa]
step_size = {low = 0.01, high = 1.0, log = true}
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster of two nodes with one processor each."""
    from ray.cluster_utils import Cluster

    # Ray's files are not kept. Its sockets need a shorter path than pytest's folders have.
    folder = TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True)
    with folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_TMPDIR", folder.name)
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        nodes.add_node(num_cpus=1)
        nodes.wait_for_nodes()
        yield nodes.address
        nodes.shutdown()


def test_engines_agree(cluster: str, tmp_path: Path) -> None:
    plan = (*SARSA, "--episodes", 40, "--trials", 4)
    for how, name in (
        (("--in-process",), "one"),
        (("--in-process", "--engine", "ray", "--address", cluster), "ray"),
        (("--engine", "ray", "--address", cluster, "--workers", 2), "ray with players of their own"),
    ):
        done = run(*plan, *how, "--out", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert contents(tmp_path / name) == contents(tmp_path / "one")
    assert len(contents(tmp_path / "ray")) == 4


def test_lost_worker_is_replaced_and_no_episode_comes_twice(cluster: str, tmp_path: Path) -> None:
    (tmp_path / "faulty.py").write_text(FAULTY)
    agent = f"{tmp_path}/faulty.py:Faulty"  # workers of Ray have another working directory
    plan = (*MINES, "--agent", agent, "--episodes", 12, "--trials", 2, "--in-process")
    assert run(*plan, "--out", "undisturbed", cwd=tmp_path).returncode == 0
    options = ("--agent-option", "how=SIGKILL", "--agent-option", f"once={tmp_path}/mark")
    ray = ("--engine", "ray", "--address", cluster, "--checkpoint-every", 4)
    done = run(*plan, *options, *ray, "--json", "--out", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "run") == contents(tmp_path / "undisturbed")
    assert json.loads(done.stdout.splitlines()[-1])["episodes"] == 24
    with Results.open(tmp_path / "run") as results:
        lost = [event.text for event in results.events() if event.kind == "lost"]
        assert len(lost) == 1
        assert lost[0].startswith("its Ray worker was lost: ")


def test_search_comes_to_the_choice_of_workers(cluster: str, tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(SEARCH)
    plan = ("--plan", "plan.toml", "--in-process")
    assert run(*plan, "--workers", 2, "--out", "workers", cwd=tmp_path).returncode == 0
    done = run(*plan, "--engine", "ray", "--address", cluster, "--out", "ray", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in ("search", "result"):
        assert contents(tmp_path / "ray" / part) == contents(tmp_path / "workers" / part)


def test_a_season_lets_attempts_play_on_the_cluster(cluster: str, tmp_path: Path) -> None:
    now = datetime.now(UTC)
    opens, closes = ((now + timedelta(days=days)).isoformat(timespec="seconds") for days in (-1, 1))
    agent = BIN / "glue-agent"
    (tmp_path / "secret.txt").write_text("xyzzy")
    (tmp_path / "spring.toml").write_text(
        'seed_file = "secret.txt"\n'
        f'[season]\nopens = {opens}\ncloses = {closes}\nenrol = "closed"\nparallel = 2\n'
        '[tasks.mines]\nenv = "mines"\nepisodes = 3\nmax_steps = 50\nphase = "proving"\n'
        f'[entrants.one]\ncommand = ["{agent}", "random"]\n[entrants.two]\ncommand = ["{agent}", "random"]\n'
    )
    serve = ("serve", "spring.toml", "--out", "run", "--engine", "ray", "--address", cluster)
    server = subprocess.Popen([BIN / "glue-compete", *serve], cwd=tmp_path)

    def played() -> bool:
        with suppress(ExperimentError):
            return len(course_of(tmp_path / "run").state.attempts("over")) == 2
        return False

    try:
        wait_until(played, "two attempts")
        assert ask(tmp_path / "run", {"do": "act", "act": "close", "why": "it is over"})["ok"]
        assert server.wait(120) == 0
    finally:
        server.kill()
    verified = forked.run("glue-compete", "verify", "run", cwd=tmp_path)
    assert "2 of 2 trials are verified" in verified.stderr


def test_cluster_that_is_not_there_is_said_in_one_line(tmp_path: Path) -> None:
    where = ("--engine", "ray", "--address", "127.0.0.1:1")
    done = run(*SARSA, "--episodes", 1, *where, "--out", "run", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "Error: there is no Ray cluster at 127.0.0.1:1: Connection refused\n"


def test_tutorial_can_be_followed(cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    text = (DOCS / "experiments.md").read_text("utf-8").replace("HEAD:6379", cluster)
    follow(text, tmp_path, "runs in the tests, where Ray is installed")
    ray, addressed = (contents(tmp_path / "runs" / name) for name in ("ray", "cluster"))
    assert ray == addressed
    assert {len(episodes) for episodes, _ in ray.values()} == {100}

"""Entrants from elsewhere: one with a key gets onto a verified board, and nobody else gets in."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from experiment_runner.competition.settings import Entrant, Gate
from experiment_runner.competition.starters import gate_for
from glue.client.libzmq import new_pair
from glue.errors import ConfigError
from glue.hub.config import Bind, Keys, Permit
from glue.keys.certificates import encode, write_pair
from glue.wire.messages import Role
from tests.experiment_runner.competition.contest import compete

_FILE = """\
name = "spring"
seed_file = "secret.txt"
tasks.mines = { env = "mines", options.random_start = true, steps = 20 }
entrants.carol = { key = "carol.key" }
"""

_PROGRAM = """\
import os, sys
from pathlib import Path
from glue import serve_agent
from glue.errors import GlueError
from tests.experiment_runner.competition.players import Walker

while not Path("over").exists():
    print(sorted(name for name in os.environ if name.startswith("GLUE")), flush=True)
    try:
        serve_agent(Walker(), wait=0.5)  # its place is in the environment
    except GlueError as error:
        print(error, file=sys.stderr)
"""


@pytest.mark.slow
def test_one_who_joins_with_a_key_gets_to_the_verified_board(tmp_path: Path) -> None:
    (tmp_path / "spring.toml").write_text(_FILE)
    (tmp_path / "secret.txt").write_text("xyzzy")
    (tmp_path / "secret.txt").chmod(0o600)
    write_pair(tmp_path / "keys", "hub", new_pair())
    write_pair(tmp_path, "carol", new_pair())
    url = f"ipc://{tmp_path}/gate"
    place = {
        "GLUE_HUB": url,
        "GLUE_SESSION": "carol",
        "GLUE_KEY": "carol.key_secret",
        "GLUE_HUB_KEY": "keys/hub.key",
        "PYTHONPATH": str(Path(__file__).parents[3]),
    }
    program = subprocess.Popen([sys.executable, "-c", _PROGRAM], cwd=tmp_path, env={**os.environ, **place})
    try:
        done = compete(tmp_path, "run", "spring.toml", "--out", "run", "--keys", "keys", "--bind", url)
    finally:
        (tmp_path / "over").touch()
        program.kill()
        program.wait()
    assert done.returncode == 0, done.stderr
    assert "forfeited" not in done.stderr
    assert "its log is where its program is" in (tmp_path / "run/logs/carol/mines/0.log").read_text()
    verified = compete(tmp_path, "verify", "run")
    assert "1 of 1 trials are verified" in verified.stderr
    (carol,) = json.loads(compete(tmp_path, "board", "run", "--format", "json").stdout)["entrants"]
    assert (carol["name"], carol["place"], carol["forfeits"]) == ("carol", 1, [])
    assert carol["id"] in (tmp_path / "carol.key").read_text()


def test_the_gate_is_open_to_the_owner_of_one_key_as_the_agent_of_one_session(tmp_path: Path) -> None:
    carol, hub = new_pair(), new_pair()
    write_pair(tmp_path / "keys", "hub", hub)
    public, _ = write_pair(tmp_path, "carol", carol)
    entrant, gate = Entrant("carol", key=public), Gate("tcp://127.0.0.1:*", tmp_path / "keys")
    agent, session = frozenset({Role.AGENT}), frozenset({"carol"})
    expected = Bind(
        gate.bind, agent, session, Keys(hub.secret, {carol.public: Permit("carol", agent, session)})
    )
    assert gate_for(entrant, gate) == expected
    public.unlink()
    assert gate_for(replace(entrant, id=encode(carol.public)), gate) == expected  # as it was admitted
    with pytest.raises(ConfigError, match="entrant carol joins with a key"):
        gate_for(entrant, None)

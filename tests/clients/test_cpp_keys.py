"""The C++ library with keys, at a hub that requires them."""

from __future__ import annotations

import subprocess
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.hub.config import Bind
from glue.keys.allowed import read_keys
from tests.clients.languages import CPP, run
from tests.clients.table import SECONDS, program, read_episodes, walked
from tests.hubs import hub_with
from tests.keyed import KeyFolder
from tests.system.proxy import Proxy

EPISODES: Final = 300
SEED: Final = 7
CUTS: Final = 20

ROLES: Final = {"agent": "random", "environment": "skeleton", "experiment": "experiment"}
"""Each role, and the example that plays it."""


class Keyed:
    """Keys of a hub, and of a program for each role."""

    def __init__(self, folder: Path) -> None:
        self.folder = KeyFolder(folder)
        self.secrets = {name: self.folder.entrant(name) for name in (*ROLES, "stranger")}
        self.folder.allow("\n".join(f'[{role}]\nrole = "{role}"\n' for role in ROLES))

    def hub(self) -> AbstractContextManager[str]:
        """Run a hub that admits only the keys on its list; yield its URL."""
        bind = Bind("tcp://127.0.0.1:*", keys=read_keys(self.folder.path))
        return hub_with(bind=bind, greeting=1.0)  # who has no key is told when the hub drops it

    def variables(self, name: str) -> dict[str, str]:
        """Return the environment variables by which a program finds its keys."""
        return {"GLUE_KEY": str(self.secrets[name]), "GLUE_HUB_KEY": str(self.folder.hub_key)}


@pytest.fixture
def keyed(tmp_path: Path) -> Keyed:
    CPP.ready()
    if subprocess.run(["pkg-config", "--exists", "libzmq"]).returncode != 0:
        pytest.skip("there is no libzmq here to build clients/cpp with keys (Debian: libzmq3-dev)")
    return Keyed(tmp_path)


def test_all_roles_play_with_their_keys_and_go_on_when_connections_are_cut(keyed: Keyed) -> None:
    with keyed.hub() as url, Proxy(url, CUTS).in_background() as proxy:
        commands = {role: CPP.programs[example] for role, example in ROLES.items()}
        experiment = [*commands["experiment"], str(EPISODES), str(SEED)]
        with (
            program(commands["agent"], proxy.url, **keyed.variables("agent")),
            program(commands["environment"], proxy.url, **keyed.variables("environment")),
            program(experiment, proxy.url, **keyed.variables("experiment")) as process,
        ):
            assert process.stdout is not None
            played = read_episodes(process.stdout)
            assert process.wait(SECONDS) == 0
            assert proxy.finished.is_set()

    assert played == walked(EPISODES, SEED)


def refused(url: str, **variables: str) -> str:
    """Return the output of an agent that is refused."""
    done = run(CPP.programs["random"], CPP.folder, SECONDS, status=1, GLUE_HUB=url, **variables)
    return done.stdout + done.stderr


def test_a_program_built_without_keys_says_how_to_build_it_with_them(tmp_path: Path) -> None:
    CPP.ready()
    agent = tmp_path / "agent"
    sources = CPP.folder / "examples" / "random.cpp"
    run(["g++", "-std=c++17", f"-I{CPP.folder / 'include'}", "-o", str(agent), str(sources)], tmp_path)
    done = run([str(agent)], tmp_path, SECONDS, status=1, GLUE_KEY="mine")

    assert "-DGLUE_RL_KEYS=1" in done.stderr


def test_who_does_not_get_in_is_told_why(keyed: Keyed) -> None:
    with keyed.hub() as url:
        assert "does not know this key" in refused(url, **keyed.variables("stranger"))
        assert "set GLUE_KEY and GLUE_HUB_KEY" in refused(url)
        assert "GLUE_KEY needs GLUE_HUB_KEY" in refused(url, GLUE_KEY=str(keyed.secrets["agent"]))
    with hub_with() as url:
        assert "unset GLUE_KEY and GLUE_HUB_KEY" in refused(url, **keyed.variables("agent"))

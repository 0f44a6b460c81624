"""Entrants that are waited for in a folder or at a gate, and those whose containers cannot be started."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.launching import InFolder, gate_for, launcher_for
from experiment_runner.competition.match import Match, play
from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.trials import trials
from experiment_runner.executors.job import Ended
from glue import serve_agent
from glue.client.libzmq import new_pair
from glue.errors import ConfigError
from glue.hub.config import Bind, Keys, Permit
from glue.keys.certificates import encode, write_pair
from glue.wire.messages import Role
from tests.experiment_runner.competition.players import SECRET, Walker, competition


def test_an_entrant_in_a_folder_finds_the_socket_of_each_trial_and_needs_no_session(tmp_path: Path) -> None:
    held = competition("alice", trials=2)
    entrant = Entrant("alice", folder=tmp_path)
    launcher = launcher_for(entrant)
    assert isinstance(launcher, InFolder)
    launcher.check(entrant, Limits())
    for number, spec in enumerate(trials(replace(held, entrants=(entrant,)), SECRET)):
        said: list[str] = []
        hub = f"ipc://{tmp_path}/walk-{number}/hub"
        agent = threading.Thread(target=lambda: said.append(serve_agent(Walker(), hub, wait=60.0)))  # noqa: B023
        agent.start()
        reports: list[Any] = []
        play(Match(spec, entrant, held.limits, 40, tmp_path / "log", "test"), reports.append, launcher)
        assert reports[-1] == Ended(None)
        agent.join()
        assert said
        assert not Path(hub.removeprefix("ipc://")).exists()


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"there is no folder .*missing: make it"):
        InFolder().check(Entrant("alice", folder=tmp_path / "missing"), Limits())


def test_containers_without_their_sdk_are_one_line_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "docker", None)
    monkeypatch.setitem(sys.modules, "docker.errors", None)
    monkeypatch.delitem(sys.modules, "experiment_runner.competition.containers", raising=False)
    with pytest.raises(ConfigError, match=r"entrant alice has an image.*pip install 'glue-rl\[compete\]'"):
        launcher_for(Entrant("alice", image="alice/agent:1"))


def test_the_gate_is_open_to_the_owner_of_one_key_as_the_agent_of_one_session(tmp_path: Path) -> None:
    pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
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

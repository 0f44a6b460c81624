"""Records of actions, shown with the observations that their environment reproduces."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from starlette.exceptions import HTTPException

from experiment_runner.competition.records.replay import made_for
from experiment_runner.executors.recording import run_of
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.view.season import replays
from experiment_runner.view.season.replays import replayed
from experiment_runner.view.stream import Reader
from glue.errors import ExperimentError
from glue.trajectory import ActionWriter, Ending
from glue.types import Action, step_of
from tests.experiment_runner.view.pages import unpacked

SPEC = TrialSpec(
    id=TrialId.of("alice", "mines", 0),
    agent=RoleSpec("alice"),
    environment=RoleSpec("mines", {"random_start": True}, "mines"),
    episodes=3,
    max_steps=0,
    seed=7,
)


def record(path: Path) -> list[list[bytes]]:
    """Play three episodes of six steps; return the observations of each, the start first."""
    environment = made_for(SPEC)
    seen = []
    with path.open("wb") as file:
        writer = ActionWriter(file.write)
        writer.run(run_of(SPEC, environment.env_init()))
        for episode in range(SPEC.episodes):
            bodies = [environment.env_start().body]
            writer.start()
            for step in range(6):
                action = Action(ints=[(step + episode) % 4])
                found = step_of(environment.env_step(action))
                writer.step(action.body, found.reward)
                bodies.append(found.observation.body)
                if found.terminal:
                    break
            writer.end(Ending.TERMINAL if found.terminal else Ending.CUTOFF)
            seen.append(bodies)
        writer.close()
    return seen


def test_an_episode_is_shown_as_it_was_played(tmp_path: Path) -> None:
    seen = record(tmp_path / "0.traj")
    for episode, bodies in enumerate(seen, 1):
        about, found = unpacked(replayed("a record", SPEC, tmp_path / "0.traj", episode))
        assert [seen.body for _, _, seen in found] == bodies
        assert about["recording"] == "a record"
        assert about["steps"] == len(bodies) - 1
    with pytest.raises(HTTPException, match="no episode 4"):
        replayed("a record", SPEC, tmp_path / "0.traj", 4)


def test_a_long_way_to_an_episode_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path / "0.traj")
    monkeypatch.setattr(replays, "_MOST_STEPS", 6)
    replayed("a record", SPEC, tmp_path / "0.traj", 1)
    with pytest.raises(ExperimentError, match="at most 6 steps"):
        replayed("a record", SPEC, tmp_path / "0.traj", 3)


def test_only_so_many_wait_for_a_replay_and_the_others_are_told_when_to_come_again() -> None:
    async def ask(count: int) -> list[object]:
        play = Reader("replays", 8)
        asked = [play(lambda: "shown") for _ in range(count)]
        return list(await asyncio.gather(*asked, return_exceptions=True))

    *shown, refused = asyncio.run(ask(9))
    assert shown == ["shown"] * 8
    assert isinstance(refused, HTTPException)
    assert (refused.status_code, refused.headers) == (503, {"Retry-After": "5"})

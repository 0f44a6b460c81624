"""Players served from the cells of a notebook, and the drawing of a curve."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import pytest

from agents.baselines import SkeletonAgent
from env_server.toys import SkeletonEnvironment
from glue import Action, ConfigError, Observation, PeerFailed, connect
from glue.notebook import draw_curve, serve
from tests.hubs import hub_with


class Broken(SkeletonAgent):
    def agent_start(self, observation: Observation) -> Action:
        raise ValueError("as a cell may")


def test_players_are_served_until_they_are_stopped_and_then_replaced() -> None:
    with hub_with() as hub, serve(environment=SkeletonEnvironment(), hub=hub) as environment:
        first = serve(agent=SkeletonAgent(), hub=hub)
        with connect(hub) as experiment:
            experiment.rl_init(seed=1)
            assert experiment.rl_episode(50)
            first.stop()
            assert not first.running
            with serve(agent=SkeletonAgent(), hub=hub) as second:
                experiment.rl_init(seed=1)
                assert experiment.rl_episode(50)
                assert second.running
        assert environment.running
    assert not environment.running


def test_error_of_a_player_is_raised_where_it_is_stopped() -> None:
    with hub_with() as hub, serve(environment=SkeletonEnvironment(), hub=hub):
        broken = serve(agent=Broken(), hub=hub)
        with connect(hub) as experiment:
            experiment.rl_init(seed=1)
            with pytest.raises(PeerFailed):
                experiment.rl_episode(50)
        with pytest.raises(PeerFailed):
            broken.stop()


def test_exactly_one_player_is_served() -> None:
    with pytest.raises(ConfigError):
        serve()
    with pytest.raises(ConfigError):
        serve(agent=SkeletonAgent(), environment=SkeletonEnvironment())


@pytest.mark.parametrize("returns", [[], [1.0], [0.0, float("nan"), 2.0], [float(n) for n in range(2000)]])
def test_curve_is_a_drawing_within_its_frame(returns: list[float]) -> None:
    drawing = ElementTree.fromstring(draw_curve(returns, 2000))
    line = drawing.find("{http://www.w3.org/2000/svg}polyline")
    assert line is not None
    points = [tuple(map(float, point.split(","))) for point in (line.get("points") or "").split()]
    assert len(points) == min(sum(value == value for value in returns), 400)
    assert all(40 <= x <= 600 and 40 <= y <= 200 for x, y in points)
    assert [x for x, _ in points] == sorted(x for x, _ in points)

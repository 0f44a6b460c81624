"""An agent's metrics: as returned, on the wire, and as the experiment receives them."""

from __future__ import annotations

import math
import tracemalloc
from typing import Any

import pytest

from agents.baselines import RandomAgent
from env_server.toys import MinesEnvironment
from glue.engine.local import local
from glue.engine.metrics import MAX_METRIC_NAME, MAX_METRICS, pack_metrics, unpack_metrics
from glue.errors import PeerFailed
from glue.types import Observation


class Measured(RandomAgent):
    def __init__(self, metrics: Any) -> None:
        super().__init__()
        self.metrics = metrics

    def agent_metrics(self) -> Any:
        return self.metrics


@pytest.mark.parametrize(
    "metrics",
    [
        {},
        {"größe": -0.0, "a name of several words": math.inf},
        {"n": 3},
        {"x" * MAX_METRIC_NAME: 1.0},
        {f"{i}": float(i) for i in range(MAX_METRICS)},
    ],
)
def test_the_experiment_receives_the_agents_numbers_in_their_order(metrics: dict[str, float]) -> None:
    glue = local(Measured(metrics), MinesEnvironment())
    glue.rl_init()
    assert list(glue.rl_agent_metrics().items()) == list(metrics.items())


@pytest.mark.parametrize(
    "metrics",
    [
        None,
        [0.5],
        {"": 1.0},
        {"two\nlines": 1.0},
        {"long" * 17: 1.0},
        {3: 1.0},
        {"text": "much"},
        {f"{i}": 0.0 for i in range(MAX_METRICS + 1)},
    ],
)
def test_anything_but_numbers_by_name_is_the_agents_fault(metrics: Any) -> None:
    glue = local(Measured(metrics), MinesEnvironment())
    glue.rl_init()
    with pytest.raises(
        PeerFailed, match="agent_metrics of Measured must return numbers by name; it returned "
    ):
        glue.rl_agent_metrics()


@pytest.mark.parametrize(
    "body",
    [
        Observation([], [1.0]),
        Observation([], [1.0], b"a\nb"),
        Observation([], [1.0, 2.0], b"a\na"),
        Observation([], [1.0], b"a\na"),
        Observation([], [1.0], b"\xff\xfe\n"),
        Observation([], [], b"a"),
        Observation([], [1.0], b"\x1b[2J"),
    ],
)
def test_a_body_whose_names_do_not_fit_is_refused(body: Observation) -> None:
    numbers = body.doubles.size
    with pytest.raises(PeerFailed, match=f"the agent's metrics have {numbers} numbers and "):
        unpack_metrics(body)


def test_too_many_names_are_counted_before_they_are_split() -> None:
    body = Observation([], [1.0] * MAX_METRICS, b"\n" * 2**20)
    tracemalloc.start()
    try:
        with pytest.raises(PeerFailed, match="1000 numbers and 1048577 names"):
            unpack_metrics(body)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_a_name_that_is_not_text_is_shown_with_a_mark() -> None:
    assert unpack_metrics(Observation([], [1.0], b"a\xff")) == {"a\ufffd": 1.0}


def test_nan_crosses() -> None:
    assert math.isnan(unpack_metrics(pack_metrics({"a": math.nan}))["a"])

"""Numbers of a season for Prometheus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from experiment_runner.competition.state import State
from glue.installed import needing


def metrics_of(state: State, status: Mapping[str, Any] | None) -> tuple[bytes, str]:
    """Return the numbers in Prometheus's text format, and its media type.

    Args:
        state: of the season.
        status: the server's, see `experiment_runner.competition.season.control`; None if it does not run.

    Raises:
        ConfigError: prometheus_client is not installed.
    """
    with needing("metrics", "metrics need prometheus_client"):
        import prometheus_client as prometheus

    registry = prometheus.CollectorRegistry()

    def gauge(name: str, text: str, value: float) -> None:
        prometheus.Gauge(f"glue_season_{name}", text, registry=registry).set(value)

    states = Counter(one.state for entrant in state.entrants.values() for one in entrant.attempts.values())
    gauge("entrants", "Entrants that have enrolled.", len(state.entrants))
    attempts = prometheus.Gauge("glue_season_attempts", "Attempts by state.", ["state"], registry=registry)
    for name, number in states.items():
        attempts.labels(name).set(number)
    gauge("up", "Whether the server answers.", status is not None)
    if status is not None:
        gauge("slots", "Attempts that can be played at once.", status["slots"])
        gauge("busy", "Attempts that are played.", status["busy"])
        gauge("accepting", "Whether attempts are accepted.", status["accepting"])
    # Of this process, which serves the page: CPU time, memory, open files.
    prometheus.ProcessCollector(registry=registry)
    return prometheus.generate_latest(registry), prometheus.CONTENT_TYPE_LATEST

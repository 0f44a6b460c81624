"""Entrants who connect from elsewhere, with a key: nothing is started, and they are waited for."""

from __future__ import annotations

import threading
from pathlib import Path

from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.starting import Place
from glue.errors import ConfigError

__all__ = ["Outside"]


class Outside:
    """Waits for entrants who are let in by their key; see `Starter`."""

    def check(self, entrant: Entrant) -> None:
        """Check that the file of the key is there."""
        if entrant.key is None or not entrant.key.is_file():
            raise ConfigError(
                f"entrant {entrant.name}: there is no key {entrant.key}: ask its owner for the public key "
                "that glue-keys new has made"
            )

    def start(self, entrant: Entrant, limits: Limits, place: Place) -> _Elsewhere:
        """Note in the log who is waited for."""
        place.log.write_text(f"{entrant.name} plays elsewhere, and keeps its own log\n", encoding="utf-8")
        return _Elsewhere(place.log)

    def sweep(self, run: str) -> None:
        """Do nothing: nothing was started here."""


class _Elsewhere:
    """An entrant's program on another machine: whether it is alive, only its connection shows."""

    reason: str | None = None

    def __init__(self, log: Path) -> None:
        self.log = log
        self._stopped = threading.Event()

    def wait(self, seconds: float) -> bool:
        """Wait so long, or until `stop`; return False."""
        self._stopped.wait(seconds)
        return False

    def stop(self) -> None:
        """Wait no longer."""
        self._stopped.set()

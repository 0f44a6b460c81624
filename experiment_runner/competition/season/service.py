"""A season as a service: its run directory, its door, its workers and its clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import datetime

from experiment_runner.competition.board.forms import line_of
from experiment_runner.competition.organiser import Held
from experiment_runner.competition.records.journal import utc_now
from experiment_runner.competition.season.acts import acts_for
from experiment_runner.competition.season.control import Door, Organise, Reply, Request
from experiment_runner.competition.season.server import Server, gate_of
from experiment_runner.competition.settings import Competition, Gate
from experiment_runner.executors.dispatcher import Executor
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.store.store import Store
from glue.errors import ConfigError, ExperimentError
from glue.hub.io.listener import reserve
from glue.keys.allowed import HUB
from glue.keys.certificates import SECRET, read_pair


def check_gate(competition: Competition, gate: Gate | None) -> None:
    """Check that all who may connect from elsewhere can.

    Raises:
        ConfigError: there is no gate, it has no port for each slot, or a key cannot be read.
    """
    season = competition.season
    assert season is not None
    if gate is not None:
        gate_of(gate, season.parallel - 1)
        read_pair(gate.keys / f"{HUB}{SECRET}", "keys")
    elif season.enrol != "closed" or any(entrant.key is not None for entrant in competition.entrants):
        raise ConfigError(
            "entrants with keys connect to this machine: give the directory of the hub's own pair (made by "
            f"glue-keys new {HUB}), and an address to listen on",
            settings=("keys", "bind"),
        )


def answering(door: Door) -> Callable[[Held, float], None]:
    """Return the `visit` of a competition that is held at once, which carries out its organiser's acts."""

    def visit(held: Held, seconds: float) -> None:
        def answer(request: Request) -> Reply:
            if not isinstance(request, Organise):
                raise ExperimentError("the season is over, and its final is played")
            acts = acts_for(request, held.course, held.over, utc_now())
            held.record(acts, [new.entrant for new in request.admitted])
            return {"acts": [line_of(one) for one in acts]}

        door.serve(answer, seconds)

    return visit


def serve(
    store: Store,
    competition: Competition,
    secret: bytes,
    code: str | None,
    gate: Gate | None,
    executor: Executor,
    say: Callable[[str], None],
    *,
    now: Callable[[], datetime] = utc_now,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Serve a season until it is closed; see `Server`. Nobody else can take its ports between two matches.

    Raises:
        ConfigError: a port is in use.
        StorageError: the run cannot be written to.
        ExperimentError: the executor can run nothing.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    with ExitStack() as stack:
        assert competition.season is not None
        if gate is not None:
            for slot in range(competition.season.parallel):
                stack.enter_context(reserve(gate_of(gate, slot).bind))
        server = stack.enter_context(
            Server(store, competition, secret, code, gate, say, now=now, clock=clock)
        )
        door = stack.enter_context(Door(store.directory, clock))
        interrupts = stack.enter_context(Interrupts())
        server.serve(door, executor, interrupts)

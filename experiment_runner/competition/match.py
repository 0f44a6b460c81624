"""One entrant plays one trial of a task, in a worker process with its own hub.

Workers are forked, see `experiment_runner.processes.warm` and `experiment_runner.competition.worker`.
Environment and hub are in this process; the entrant's program, which the launcher starts, can reach only the
socket that it is launched with.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from experiment_runner.competition.environment import RecordedEnvironment
from experiment_runner.competition.launching import Launch, Launcher, Running, gate_for
from experiment_runner.competition.records.replay import made_for
from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.trials import agent_seed
from experiment_runner.executors.job import Ended, Lost, Recorded
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.processes.scratch import SOCKET as SHARED
from experiment_runner.processes.scratch import scratch_folder
from experiment_runner.store.database import reported
from glue.client.experiment import RemoteExperiment, connect_over
from glue.console import one_line
from glue.errors import ExperimentError, GlueError, HubClosed, PeerFailed, PeerLost
from glue.hub.config import DEFAULT_SESSION, Bind, HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.listener import open_address
from glue.hub.io.server import Hub
from glue.trajectory import ActionWriter, Ending
from glue.wire.messages import MAX_BODY, Event, Role

NOT_CONNECTED: Final = "it did not connect within"
"""Beginning of the reason if an entrant never joins, or has left and does not join again."""

_LOOK_SECONDS: Final = 0.2
"""Maximum delay in noticing the end of an entrant's program."""

_LAST_WORDS_SECONDS: Final = 10.0
"""Seconds to wait, when an entrant is lost, for the exit status of its program."""

_FAREWELL_SECONDS: Final = 1.0
"""Seconds for an entrant's program to end by itself when everything is played."""

_MAX_MEMORY: Final = 4 * MAX_BODY
"""Maximum bytes of messages that a hub keeps: a flood ends connections but does not fill the memory."""

_MAX_REASON: Final = 300

ASK: Final = "tell-time"
"""Message to an agent at the beginning of a trial; one that answers `yes` is told what time is left."""


@dataclass(frozen=True, slots=True)
class Match:
    """A job for a worker: one entrant in one trial.

    Args:
        spec: the trial.
        entrant: the entrant.
        limits: limits of the entrant.
        steps: number of steps to play; 0 if the number of episodes counts.
        log: the file for the output of the entrant.
        run: identifies the run, see `Launch`.
        gate: where entrants from elsewhere connect; None if there is none.
        absent: why the entrant is not waited for, and forfeits at once; empty if it is.
    """

    spec: TrialSpec
    entrant: Entrant
    limits: Limits
    steps: int
    log: Path
    run: str
    gate: Gate | None = None
    absent: str = ""


class Piece(NamedTuple):
    """The next bytes of the record."""

    data: bytes


class Used(NamedTuple):
    """The resource usage of an entrant; None where it is unknown, as for a program on another machine.

    `processor` is in seconds, `peak` in bytes of memory; `bank` has the seconds left, which never grow.
    """

    processor: float | None
    peak: int | None
    bank: float | None


class Forfeited(NamedTuple):
    """The entrant did not play to the end; `reason` is one readable line."""

    reason: str


Report = Recorded | Piece | Used | Forfeited | Ended | Lost


TimeLeft = Callable[[], tuple[float, float] | None]
"""Function that returns `TimeBank.left`."""


class _Unfinished(ExperimentError):
    """The trial was interrupted, for a reason that is not the entrant's."""


def play(
    match: Match,
    send: Callable[[Report], None],
    launcher: Launcher,
    *,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Play a trial. The last report is `Ended`, preceded by `Forfeited` if the entrant forfeited, or it is
    `Lost` if the trial has to start over.

    Args:
        match: the match.
        send: receives the reports.
        launcher: starts the entrant.
        clock: returns seconds; measures the entrant's time.
    """
    try:
        why = _Playing(match, send, clock).play(launcher)
        if why is not None:
            send(Forfeited(one_line(why, _MAX_REASON) or "no reason was given"))
        send(Ended(None))
    except _Unfinished as error:
        send(Lost(str(error)))
    except GlueError as error:
        send(Ended(str(error)))
    except Exception as error:
        traceback.print_exception(error)
        send(Ended(f"{type(error).__name__}: {error}"))


class _Playing:
    def __init__(self, match: Match, send: Callable[[Report], None], clock: Callable[[], float]) -> None:
        self._match = match
        self._send = send
        self._clock = clock
        self._record = ActionWriter(lambda data: send(Piece(data)))
        self._environment = RecordedEnvironment(
            made_for(match.spec), self._record, match.spec, lambda result: send(Recorded(result, None))
        )
        self._running = Running()
        self._absent_since: float | None = None  # None while its agent is there
        self._over = threading.Event()

    def play(self, launcher: Launcher) -> str | None:
        """Play; return why the entrant forfeits, or None."""
        match = self._match
        if match.absent:
            self._record.close()
            return match.absent
        # A program in a folder is not told its session, so it gets the default; this hub has no other.
        session = match.entrant.name if match.entrant.folder is None else DEFAULT_SESSION
        with ExitStack() as stack:
            launch = self._launch(stack.enter_context(scratch_folder()), session)
            opened = {}
            if match.entrant.key is None:
                bind = Bind(launch.hub, frozenset({Role.AGENT}), frozenset({session}))
            else:
                bind = gate_for(match.entrant, match.gate)
                opened[bind.url] = stack.enter_context(open_address(bind.url, reserved=True))
            config = HubConfig(
                bind=(bind,), max_sessions=1, max_memory=_MAX_MEMORY, time=match.limits, pace=match.spec.pace
            )
            hub = Hub(config, opened=opened, clock=self._clock, processor=lambda: self._running.processor)
            with ExitStack() as joined:
                joined.enter_context(hub.in_background())
                self._environment.num_late = partial(hub.sessions.num_late, session)
                transport = InsideTransport(hub, {Role.ENVIRONMENT: self._environment}, session)
                glue = joined.enter_context(connect_over(transport, session, on_notice=self._notice))
                running = self._running = launcher.start(match.entrant, match.limits, launch)
                self._absent_since = self._clock()
                stack.callback(running.stop)
                joined.callback(self._over.set)
                threading.Thread(
                    target=self._watch, args=(running, glue), name="entrant", daemon=True
                ).start()
                time_left = partial(hub.sessions.time_left, session)
                why = self._play_or_forfeit(glue, running, time_left)
                left = time_left()
            # The hub has said goodbye.
            if why is None:
                running.wait(_FAREWELL_SECONDS)
            running.stop()
            if why is None:
                why = running.offence and f"its program {running.offence}"
            self._send(Used(running.processor, running.peak, left and left[0]))
            return why

    def _launch(self, scratch: Path, session: str) -> Launch:
        match, folder = self._match, scratch / SHARED
        if match.entrant.folder is not None:
            _, task, trial = match.spec.id.parts
            folder = match.entrant.folder / f"{task}-{trial}"
        with reported(f"cannot make the folder of {match.entrant.name}"):
            folder.mkdir(mode=0o711, exist_ok=True)
            match.log.parent.mkdir(parents=True, exist_ok=True)
        return Launch(folder, session, match.log, match.run)

    def _play_or_forfeit(self, glue: RemoteExperiment, running: Running, time_left: TimeLeft) -> str | None:
        environment = self._environment
        try:
            glue.wait_for_players(lambda missing: None)
            glue.rl_init(agent_seed(self._match.spec))
            self._episodes(glue, time_left)
            self._record.close()
        except (PeerLost, PeerFailed, HubClosed) as error:
            if environment.failure is not None:
                raise ExperimentError(f"the environment failed: {environment.failure}") from error
            why = str(error)
            if environment.refusal is not None:
                why = f"its action was refused: {environment.refusal}"
            elif isinstance(error, PeerLost) and running.wait(_LAST_WORDS_SECONDS):
                why = f"its program {running.reason}"
            if running.lost is not None:
                raise _Unfinished(running.lost) from error
            environment.end(Ending.VOID)
            self._record.close()
            return why
        with suppress(GlueError):  # everything is played; the agent's cleanup changes nothing
            glue.rl_cleanup()
        return None

    def _episodes(self, glue: RemoteExperiment, time_left: TimeLeft) -> None:
        steps, spec, played = self._match.steps, self._match.spec, self._environment
        asks = glue.rl_agent_message(ASK) == "yes"
        while played.steps < steps if steps else played.episodes < spec.episodes:
            if asks and (seconds := time_left()) is not None:
                glue.rl_agent_message("time-left bank={:.3f} total={:.3f}".format(*seconds))
            # RL_num_steps is 1 after the start: this allows all remaining steps.
            left = steps - played.steps + 1 if steps else spec.max_steps
            glue.rl_episode(min(left, spec.max_steps or left))
            played.end(Ending.CUTOFF)

    def _notice(self, event: Event, role: Role, name: str) -> None:
        if role is Role.AGENT and event in (Event.JOINED, Event.RETURNED):
            self._absent_since = None
        elif role is Role.AGENT and event is Event.LOST:
            self._absent_since = self._clock()

    def _watch(self, running: Running, glue: RemoteExperiment) -> None:
        """Watch, in a separate thread, for the end of the entrant's program, and for one that stays away."""
        limit = self._match.limits.start_seconds
        while not self._over.is_set():
            if running.wait(_LOOK_SECONDS):
                why = f"its program {running.reason}"
            elif (since := self._absent_since) is not None and self._clock() - since > limit:
                why = f"{NOT_CONNECTED} {limit:g} s"
            else:
                continue
            if not self._over.is_set():
                glue.give_up(why)
            return

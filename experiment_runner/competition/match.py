"""One entrant plays one trial of a task, in a worker process with its own hub.

Workers are forked, see `experiment_runner.processes.warm` and `experiment_runner.executors.workers`.
Environment and hub are in this process; the entrant's program, which the starter starts, can reach only the
socket that it is launched with.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

from experiment_runner.competition.inside import InsideEnvironment
from experiment_runner.competition.outside import InFolder, Outside, gate_for
from experiment_runner.competition.records.replay import made_for
from experiment_runner.competition.secret import agent_seed
from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.starting import Launch, Running, Starter
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import Ended, Lost, Recorded, decode
from experiment_runner.executors.workers import serve
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.processes.scratch import SOCKET as SHARED
from experiment_runner.processes.scratch import scratch_folder
from experiment_runner.store.database import reported
from glue.client.experiment import RemoteExperiment, connect_over
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError, GlueError, HubClosed, PeerFailed, PeerLost
from glue.hub.config import DEFAULT_SESSION, Bind, HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.options import build
from glue.plugins.loading import find
from glue.trajectory import ActionWriter, Ending
from glue.wire.limits import MAX_BODY
from glue.wire.messages import Event, Role

MODULE: Final = "experiment_runner.competition.match"

_LOOK_SECONDS: Final = 0.2
"""Maximum delay in noticing the end of an entrant's program."""

_LAST_WORDS_SECONDS: Final = 10.0
"""Seconds to wait, when an entrant is lost, for the exit status of its program."""

_FAREWELL_SECONDS: Final = 1.0
"""Seconds for an entrant's program to end by itself when everything is played."""

_MAX_MEMORY: Final = 4 * MAX_BODY
"""Maximum bytes of messages that a hub keeps: a flood ends connections but does not fill the memory."""

_MAX_REASON: Final = 300


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
    """

    spec: TrialSpec
    entrant: Entrant
    limits: Limits
    steps: int
    log: Path
    run: str
    gate: Gate | None = None


class Played(NamedTuple):
    """A piece of the record."""

    piece: bytes


class Forfeited(NamedTuple):
    """The entrant did not play to the end; `reason` is one readable line."""

    reason: str


Report = Recorded | Played | Forfeited | Ended | Lost


class _Unfinished(ExperimentError):
    """The trial was interrupted, for a reason that is not the entrant's."""


REPORTS: Final[Mapping[str, type[Report]]] = {kind.__name__: kind for kind in get_args(Report)}
"""The reports of a match, by name."""


def starter_for(entrant: Entrant) -> Starter:
    """Return the starter for an entrant of this kind.

    Raises:
        ConfigError: it needs a package that is not installed.
    """
    if entrant.image is not None:
        try:
            from experiment_runner.competition.containers import Containers
        except ImportError:
            raise ConfigError(
                f"entrant {entrant.name} has an image, and containers need Docker's SDK: "
                "pip install 'glue-rl[compete]'"
            ) from None
        return Containers()
    if entrant.key is not None:
        return Outside()
    if entrant.folder is not None:
        return InFolder()
    from experiment_runner.competition.programs import Programs

    return Programs()


def play(
    match: Match,
    send: Callable[[Report], None],
    starter: Starter,
    *,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Play a trial. The last report is `Ended`, preceded by `Forfeited` if the entrant forfeited, or it is
    `Lost` if the trial has to start over.

    Args:
        match: the match.
        send: receives the reports.
        starter: starts the entrant.
        clock: returns seconds; measures the entrant's time.
    """
    failure = None
    try:
        _Playing(match, send, clock).play(starter)
    except _Unfinished as error:
        send(Lost(str(error)))
        return
    except GlueError as error:
        failure = str(error)
    except Exception as error:
        traceback.print_exception(error)
        failure = f"{type(error).__name__}: {error}"
    send(Ended(failure))


class _Playing:
    def __init__(self, match: Match, send: Callable[[Report], None], clock: Callable[[], float]) -> None:
        self._match = match
        self._send = send
        self._clock = clock
        self._record = ActionWriter(lambda piece: send(Played(piece)))
        self._joined = threading.Event()
        self._over = threading.Event()
        self._ended: str | None = None  # why the entrant cannot continue, set by its watcher

    def play(self, starter: Starter) -> None:
        match = self._match
        environment = made_for(match.spec)
        # A program in a folder is not told its session, so it gets the default; this hub has no other.
        session = match.entrant.name if match.entrant.folder is None else DEFAULT_SESSION
        with ExitStack() as stack:
            launch = self._launch(stack.enter_context(scratch_folder()), session)
            if match.entrant.key is None:
                bind = Bind(launch.hub, frozenset({Role.AGENT}), frozenset({session}))
            else:
                bind = gate_for(match.entrant, match.gate)
            config = HubConfig(bind=(bind,), max_sessions=1, max_memory=_MAX_MEMORY, time=match.limits)
            with ExitStack() as meeting:
                hub = meeting.enter_context(Hub(config, clock=self._clock))
                inside = InsideEnvironment(
                    hub,
                    session,
                    environment,
                    self._record,
                    match.spec,
                    lambda result: self._send(Recorded(result, None)),
                )
                meeting.enter_context(hub.in_background())
                glue = connect_over(InsideTransport(hub), session, on_notice=self._notice)
                meeting.enter_context(glue)
                running = starter.start(match.entrant, match.limits, launch)
                stack.callback(running.stop)
                meeting.callback(self._over.set)
                threading.Thread(
                    target=self._watch, args=(running, glue), name="entrant", daemon=True
                ).start()
                why = self._play_or_forfeit(glue, inside, running)
            # The hub has said goodbye.
            if why is None:
                running.wait(_FAREWELL_SECONDS)
                running.stop()
                why = running.offence and f"its program {running.offence}"
            if why is not None:
                self._send(Forfeited(one_line(why, _MAX_REASON) or "no reason was given"))

    def _launch(self, scratch: Path, session: str) -> Launch:
        shared = self._match.entrant.folder
        if shared is None:
            folder = scratch / SHARED
        else:
            _, task, trial = self._match.spec.id.parts
            folder = shared / f"{task}-{trial}"
        with reported(f"cannot make the folder of {self._match.entrant.name}"):
            folder.mkdir(mode=0o711, exist_ok=True)
            self._match.log.parent.mkdir(parents=True, exist_ok=True)
        return Launch(folder, session, self._match.log, self._match.run)

    def _play_or_forfeit(
        self, glue: RemoteExperiment, inside: InsideEnvironment, running: Running
    ) -> str | None:
        """Play; return why the entrant forfeits, or None."""
        try:
            glue.wait_for_players(lambda missing: None)
            glue.rl_init(agent_seed(self._match.spec))
            self._episodes(glue, inside)
            self._record.close()
        except (PeerLost, PeerFailed, HubClosed) as error:
            if inside.failure is not None:
                raise ExperimentError(f"the environment failed: {inside.failure}") from error
            why = self._reason(error, inside, running)
            if running.lost is not None:
                raise _Unfinished(running.lost) from error
            inside.end(Ending.VOID)
            self._record.close()
            return why
        with suppress(GlueError):  # everything is played; the agent's cleanup changes nothing
            glue.rl_cleanup()
        return None

    def _episodes(self, glue: RemoteExperiment, inside: InsideEnvironment) -> None:
        steps, spec = self._match.steps, self._match.spec
        while inside.steps < steps if steps else inside.episodes < spec.episodes:
            # RL_num_steps is 1 after the start: this allows all remaining steps.
            left = steps - inside.steps + 1 if steps else spec.max_steps
            glue.rl_episode(min(left, spec.max_steps or left))
            inside.end(Ending.CUTOFF)

    def _notice(self, event: Event, role: Role, name: str) -> None:
        if role is Role.AGENT and event is Event.JOINED:
            self._joined.set()

    def _watch(self, running: Running, glue: RemoteExperiment) -> None:
        """Watch, in a separate thread, for the end of the entrant's program, and for one that never joins."""
        limit = self._match.limits.start_seconds
        began = self._clock()
        while not self._over.is_set():
            ended = running.wait(_LOOK_SECONDS)
            if self._over.is_set():
                return
            if ended:
                self._ended = f"its program {running.reason}"
            elif not self._joined.is_set() and self._clock() - began > limit:
                self._ended = f"it did not connect within {limit:g} s"
            if self._ended is not None:
                glue.give_up(self._ended)
                return

    def _reason(self, error: GlueError, inside: InsideEnvironment, running: Running) -> str:
        if inside.refusal is not None:
            return f"its action was refused: {inside.refusal}"
        if isinstance(error, PeerLost) and running.wait(_LAST_WORDS_SECONDS):
            return f"its program {running.reason}"
        return str(error)


def prepare(environments: Sequence[str]) -> None:
    """Import environments and load what they have compiled, for the processes that are forked from this one.

    Those in a user's own file are left to each process: what the file does is not known.
    """
    for name in environments:
        if ":" not in name:
            with suppress(Exception):  # a process that plays says what is wrong
                build(find(Role.ENVIRONMENT, name), {}).env_init()


def main() -> None:
    """Play the match received over the socket whose descriptor is the first argument."""

    def run(job: Any, send: Callable[[object], None], _: Interrupts) -> None:
        match = decode(job, {Match.__name__: Match})
        play(match, send, starter_for(match.entrant))

    serve(run)


if __name__ == "__main__":
    main()

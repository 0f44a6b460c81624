"""The server of a season: it answers requests, plays attempts, and verifies each at its end.

Only this process writes to the run directory, as in a competition held at once, see
`experiment_runner.competition.organiser`. All that it knows is in the journal and in the results, so it may
be killed at any time: a trial that was not over starts over, and everything else continues where it was.

An attempt plays its trials one after the other, in one of `Season.parallel` slots. Entrants who connect from
elsewhere do so at the port of their slot. An attempt waits for its entrant's program, which has to ask for it
again and again; it is cancelled when the program stops asking.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Final

from experiment_runner.competition.board.forms import line_of
from experiment_runner.competition.course import course_of, entrant_of
from experiment_runner.competition.launching import launcher_for, name_of_run, no_gate
from experiment_runner.competition.match import NOT_CONNECTED, Match
from experiment_runner.competition.organiser import Matches, Say, matches
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import Act, act, utc_now
from experiment_runner.competition.records.record import NAMES, is_name
from experiment_runner.competition.records.seal import add_trials, record_acts, record_verdict
from experiment_runner.competition.season import control, schedule
from experiment_runner.competition.season.acts import acts_for
from experiment_runner.competition.season.board import PUBLIC as ANYBODY
from experiment_runner.competition.season.board import Boards, EntrantRow
from experiment_runner.competition.season.control import Door, Reply, Request
from experiment_runner.competition.settings import Competition, Entrant, Gate
from experiment_runner.competition.state import IMAGE_ID, Attempt, Enrolled
from experiment_runner.competition.trials import attempt_trials, derived, levels, pseudonym
from experiment_runner.competition.worker import Replay
from experiment_runner.executors.dispatcher import Dispatcher, Executor
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.plan.limits import TrialId
from experiment_runner.store.records import ReplayVerdict, TrialEnd
from experiment_runner.store.store import Store
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError
from glue.hub.io.listener import reserve
from glue.keys.allowed import HUB
from glue.keys.certificates import PUBLIC, SECRET, encode, read_pair, read_public
from glue.keys.certificates import decode as decode_key

_TURN_SECONDS: Final = 0.05
"""Maximum delay of an answer while attempts are played."""

_IDLE_SECONDS: Final = 0.5

_LOOK_SECONDS: Final = 1.0

_ABSENT_SECONDS: Final = 60.0
"""Time after which the waiting attempt of a program that no longer asks for it is cancelled."""

_MOST_AFTER_CLOSE: Final = 3
"""Failures of ours in a row after which an attempt is not played again when the season is closed."""

_RERUN_SECONDS: Final = 7 * 86_400.0
"""The same for one that the organiser has queued, of which its owner is to learn first."""

_PRESENT_SECONDS: Final = 15.0
"""Time for which a program that has asked counts as present, so that its attempt may be let play."""

_SLACK_SECONDS: Final = 3600.0
"""Time that a trial may take beyond what its entrant's limits allow, as its environment takes time, too."""

_REST_SECONDS: Final = 5.0
"""Time before a slot is used again after an attempt that failed there, and before its entrant plays again."""

_FAREWELL_SECONDS: Final = 30.0
"""Time after the last attempt of a season that is closed, for its program to learn its result."""

_MOST_DOUBLED: Final = 7
"""Number of failures in a row with each of which an entrant's time is doubled."""

_MAX_NAME: Final = 200


@dataclass(slots=True)
class _Slot:
    """An attempt that is played.

    Args:
        attempt: the attempt.
        number: of the slot, from 0.
        trials: ids of its trials, in their order.
        left: ids of those that are not over.
        resumed: whether its first trial is played again after a restart of this server, which its program may
            not have survived.
        forfeit: why it is forfeited; empty if it is not.
    """

    attempt: Attempt
    number: int
    trials: Sequence[str]
    left: deque[str]
    resumed: bool
    forfeit: str = ""


@dataclass(slots=True)
class _Job:
    """A trial that is played or replayed.

    Args:
        until: when it has to be over.
        replay: the job of replaying it; None if it is played.
        problem: why it could not be verified; None if it could, or is played.
    """

    until: float
    replay: Replay | None
    problem: str | None = None


def gate_of(gate: Gate, slot: int) -> Gate:
    """Return the gate of a slot: the address of the first, with the port that many further on.

    Raises:
        ConfigError: the address has no port to count from.
    """
    if gate.bind.startswith("ipc://"):
        return replace(gate, bind=f"{gate.bind}-{slot}")
    host, _, port = gate.bind.rpartition(":")
    found = int(port) + slot if port.isdecimal() and len(port) < 6 else 0
    if not host.startswith("tcp://") or not 0 < found < 2**16:
        raise ConfigError(
            f"{gate.bind} is not an address for {slot + 1} attempts at once, each with its own port: "
            "write one such as tcp://0.0.0.0:4097",
            settings=("bind",),
        )
    return replace(gate, bind=f"{host}:{found}")


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
        raise no_gate("entrants with keys connect to this machine")


class Server(Matches):
    """The server of a season; see the top of this module.

    Args:
        store: of the run.
        competition: as in the organiser's file, with the entrants that it names.
        secret: the secret seed.
        code: with which entrants enrol; None if there is none.
        gate: where entrants with keys connect; None if there are none.
        say: shows a line.
        now: returns the time.
        clock: returns seconds, for waiting.
    """

    def __init__(
        self,
        store: Store,
        competition: Competition,
        secret: bytes,
        code: str | None,
        gate: Gate | None,
        say: Say,
        *,
        now: Callable[[], datetime] = utc_now,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(store, say)
        self._competition = competition
        self._secret = secret
        self._levels = levels(competition, secret)
        self._code = code
        self._gate = gate
        self._now = now
        self._clock = clock
        self._course = course_of(store.directory)
        self._state = self._course.state  # of the acts so far
        self._named = {entrant.name: entrant for entrant in competition.entrants}
        self._directory = store.directory.absolute()
        self._slots: dict[str, _Slot] = {}
        self._jobs: dict[str, _Job] = {}
        self._seen: dict[str, float] = {}
        """When each entrant's program asked last."""
        self._queued: dict[str, float] = {}
        """When the last attempt of each entrant was queued by this server."""
        self._rests: dict[str | int, float] = {}
        """When an entrant whose attempt failed here may play again, and its slot: the port may be taken."""
        self._began = clock()
        self._looked = -math.inf
        self._ended = -math.inf  # when the last attempt was over, or cancelled by the close
        self._boards: Boards | None = None
        self._boards_of = 0  # the number of acts in it
        self._boards_until = 0.0  # when they may be computed again

    def serve(self, executor: Executor) -> None:
        """Serve until the season is closed, what was played is over, and its programs can have learnt of it.

        Raises:
            ConfigError: a port is in use.
            StorageError: the run cannot be written to.
            ExperimentError: the executor can run nothing.
            KeyboardInterrupt: on Ctrl-C or SIGTERM.
        """
        with ExitStack() as stack:
            if self._gate is not None:  # nobody else can take its ports between two matches
                for slot in range(self._state.season.parallel):
                    stack.enter_context(reserve(gate_of(self._gate, slot).bind))
            door = stack.enter_context(Door(self._directory, self._clock))
            interrupts = stack.enter_context(Interrupts())
            dispatcher = Dispatcher(executor, self, interrupts)
            stack.enter_context(executor)
            stack.enter_context(interrupts.deferred())
            self.begin(dispatcher)
            while self.turn(_TURN_SECONDS) or not interrupts.requested:
                if self.may_end:
                    break
                door.serve(self.answer, 0 if dispatcher.running else _IDLE_SECONDS)

    @property
    def over(self) -> bool:
        """Whether the season is closed, and what was played is over, also if it had to start again."""
        return self._state.closed is not None and not self._state.attempts("waiting", "playing")

    @property
    def may_end(self) -> bool:
        """Whether it is over, and has been for as long as programs may take to ask for their results."""
        return self.over and self._clock() >= self._ended + _FAREWELL_SECONDS

    def begin(self, dispatcher: Dispatcher) -> None:
        """Go on with the attempts that were played when the server before this one ended."""
        super().begin(dispatcher)
        for name in self._named:
            launcher_for(self._player(self._state.entrants[name].present)).sweep(name_of_run(self._directory))
        outcomes, verdicts = self._store.outcomes(), self._store.verdicts()
        for one in self._state.attempts("playing"):
            assert one.start is not None
            slot = self._take_slot(one.start, resumed=True)
            while slot.left and slot.left[0] in outcomes:
                verdict = verdicts.get(slot.left[0])
                verified = verdict is not None and verdict.problem is None
                self._was_played(slot, outcomes[slot.left[0]], verified=verified)

    def turn(self, seconds: float = 0.0) -> bool:
        """Start what can start, and store what is reported within `seconds`; return whether anything runs."""
        self._look()
        return self.dispatcher.turn(seconds)

    # What others ask for

    def answer(self, request: Request) -> Reply:
        """Return the reply to a request at the door.

        Raises:
            ExperimentError: it is refused.
        """
        match request:
            case control.Organise():
                return self._organise(request)
            case control.Enrol():
                return self._enrol(request)
            case control.Attempt(name, number):
                return self._attempt(name, number)
            case control.Key(name):
                entrant = self._state.entrants.get(name)
                return {"key": None if entrant is None else entrant.key or None}
            case control.Withdraw(name, number):
                return self._withdraw(name, number)
            case control.Submit():
                return self._submit(request)
            case control.Status():
                return self._status()

    def _organise(self, wanted: control.Organise) -> Reply:
        acts = acts_for(wanted, self._course, (), self._now())
        self._record(*acts)
        self._named |= {entrant.name: entrant for entrant, _ in wanted.admitted}
        return {"acts": [line_of(one) for one in acts]}

    def _enrol(self, wanted: control.Enrol) -> Reply:
        try:
            key = encode(decode_key(wanted.key))
        except ValueError:
            raise ExperimentError("the key is not a public key, as glue-keys makes it") from None
        season, name = self._state.season, wanted.name
        known = self._state.entrants.get(name)
        is_new = known is None or known.key != key
        if self._gate is None or (is_new and season.enrol == "closed"):
            raise ExperimentError("enrolment is closed: ask the organiser")
        token = base64.urlsafe_b64encode(derived(self._secret, "token", name)[:18]).decode()
        more = {"id": key, "token": hashlib.sha256(token.encode()).hexdigest()}
        if is_new:
            self._check_new(wanted, key)
            taken = {one.act.alias for one in self._state.entrants.values()}
            alias = pseudonym(name, self._secret, taken)
            self._act(journal.ENROL, name, "", player=f"{name}.key", alias=alias, team=wanted.team, **more)
        elif not self._state.entrants[name].act.token:  # the organiser has admitted it
            self._act(journal.ENROL, name, "", **more)
        hub_key = encode(read_public(self._gate.keys / f"{HUB}{PUBLIC}", "keys"))
        shown = name if season.names == "own" else self._state.entrants[name].act.alias
        return {"hub_key": hub_key, "token": token, "alias": shown}

    def _check_new(self, wanted: control.Enrol, key: str) -> None:
        season, name = self._state.season, wanted.name
        schedule.check_not_over(self._state, self._now())
        if season.enrol == "code" and not (
            self._code and hmac.compare_digest(self._code.encode(), wanted.code.encode())
        ):
            raise ExperimentError("that is not the code for enrolling: ask the organiser for it")
        if not is_name(name):
            raise ExperimentError(f"{name!r:.80} cannot be a name: {NAMES}")
        if wanted.team and not (season.teams and is_name(wanted.team)):
            raise ExperimentError(f"there are no teams, or {wanted.team!r:.80} cannot be the name of one")
        others = self._state.entrants.values()
        if any(one.name.casefold() == name.casefold() for one in others):
            raise ExperimentError(f"the name {name} is taken: choose another")
        if any(one.key == key for one in others):
            raise ExperimentError("the owner of this key takes part already, under another name")
        if len(others) >= season.most_entrants:
            raise ExperimentError(
                f"{len(others)} take part, and there is no room for more: ask the organiser"
            )

    def _attempt(self, name: str, number: int) -> Reply:
        entrant = self._state.taking_part(name)
        if not self._present(name):
            self._looked = -math.inf
        self._seen[name] = self._clock()
        if number:
            one = self._state.attempt(name, number)
            while one.state == "ours" and one.number + 1 in entrant.attempts:
                one = entrant.attempts[one.number + 1]  # which plays in its place
            return self._shown(entrant, one)
        under_way = entrant.playing or next(iter(entrant.waiting), None)
        if under_way is None:
            self._record(schedule.request(self._state, name, self._now()))
            self._look()
            under_way = entrant.playing or entrant.waiting[0]
        return self._shown(entrant, under_way)

    def _shown(self, entrant: Enrolled, one: Attempt) -> Reply:
        """Return the reply about an attempt to its owner."""
        name, reply = entrant.name, Reply(attempt=one.number)
        if one.start is not None and IMAGE_ID.fullmatch(one.start.id):
            reply["image"] = True
        slot = self._slots.get(name)
        if one.state == "waiting":
            queue = schedule.queue(self._state)
            place = {"place": queue.index(one) + 1} if one in queue else {}
            return {"state": "waiting", "why": self._state.paused or entrant.paused, **reply, **place}
        if one.state == "playing":
            if slot is None or not slot.left:
                return {"state": "verifying", **reply}
            trial, trials = len(slot.trials) - len(slot.left) + 1, len(slot.trials)
            reply |= {"trial": trial, "trials": trials, "session": name}
            next_one = self.matches[slot.left[0]]
            if next_one.entrant.key is not None and next_one.gate is not None:
                reply["hub"] = next_one.gate.bind
            return {"state": "playing", **reply}
        now, board = self._now(), self._newest_boards().seen_by(name)
        row = next((row for row in board.entrants if row.mine), EntrantRow(name))
        played = next((other for other in row.attempts if other.number == one.number), None)
        if played is None or played.state in ("waiting", "playing"):  # the boards are older
            return {"state": "verifying", **reply}
        returns = schedule.returns_at(self._state, now)
        return {
            "state": "over",
            **reply,
            "outcome": "withdrawn" if one.withdrawn else played.state,
            **({} if math.isnan(played.score) else {"score": played.score}),
            **({} if math.isnan(row.low) else {"low": row.low, "high": row.high}),
            "place": row.place,
            "of": sum(other.place is not None for other in board.entrants),
            "left": schedule.left(self._state, entrant, now),
            "returns": None if returns is None else returns.isoformat(),
            "why": one.why,
        }

    def _newest_boards(self) -> Boards:
        """Return the boards after the last act, or somewhat older ones: they may take a fifth of the time."""
        clock = self._clock()
        count = self._state.count
        if self._boards is None or (self._boards_of != count and clock >= self._boards_until):
            self._boards, self._boards_of = None, count
            course = replace(self._course, acts=[*self._course.acts])  # as it is now
            self._boards = Boards.of(self._store, course, self._now())
            self._boards.seen_by(ANYBODY)
            self._boards_until = self._clock() + 4 * (self._clock() - clock)
        return self._boards

    def _withdraw(self, name: str, number: int) -> Reply:
        self._state.taking_part(name)
        one = self._state.attempt(name, number)
        if one.state == "playing":
            raise ExperimentError(f"attempt {number} is played: it can be withdrawn when it is over")
        if one.withdrawn or one.state in ("ours", "cancelled"):
            raise ExperimentError(f"attempt {number} does not count anyway")
        if one.instead and one.state == "waiting":
            raise ExperimentError(
                f"attempt {number} is attempt {one.instead}, which the organiser has run again: it can be "
                "withdrawn when it is over"
            )
        kind, count = journal.CANCEL if one.state == "waiting" else journal.WITHDRAW, self._state.season.count
        if kind == journal.WITHDRAW and count != "best":
            which = "the last attempt counts" if count == "last" else "all attempts count"
            raise ExperimentError(f"{which} in this season, so none that is over can be withdrawn")
        self._act(kind, name, "its owner has withdrawn it", number=number)
        return {}

    def _submit(self, wanted: control.Submit) -> Reply:
        self._state.taking_part(wanted.entrant)
        if not self._state.season.images:
            raise ExperimentError("no images are accepted in this season")
        schedule.check_not_over(self._state, self._now())
        if not IMAGE_ID.fullmatch(wanted.image):
            raise ExperimentError(f"{wanted.image!r:.80} is not the id of an image")
        name = one_line(wanted.name, _MAX_NAME)
        self._act(journal.IMAGE, wanted.entrant, "", player=name, id=wanted.image)
        return {}

    def _status(self) -> Reply:
        state = self._state
        accepting = state.closed is None and state.season.opens <= self._now() < state.season.closes
        return {
            "slots": state.season.parallel,
            "busy": len(self._slots),
            "accepting": accepting and not state.paused,
            "why": state.paused,
        }

    # What is played

    def _act(self, kind: str, name: str, reason: str, **more: Any) -> None:
        self._record(act(kind, name, reason, now=self._now(), **more))

    def _record(self, *acts: Act) -> None:
        """Write acts to the journal, and carry them out."""
        record_acts(self._store, acts)
        if len(acts) > 1 and acts[-1].act == journal.CLOSE:
            self._ended = self._clock()  # programs whose attempts are cancelled learn of it
        for one in acts:
            self._course.acts.append(one)
            self._state.apply(one)
            if one.act in (journal.REQUEST, journal.RERUN):
                self._queued[one.subject] = self._clock()
            self._say(one.line)
        for slot in list(self._slots.values()):
            if self._state.attempt(slot.attempt.entrant, slot.attempt.number).state != "playing":
                self._leave(slot)
        self._looked = -math.inf

    def _look(self) -> None:
        """See, once a second and after each act, what can start, and what has taken too long."""
        clock = self._clock()
        if clock - self._looked < _LOOK_SECONDS:
            return
        self._looked = clock
        state, now = self._state, self._now()
        for trial_id in [trial_id for trial_id, job in self._jobs.items() if clock > job.until]:
            if (slot := self._slots.get(TrialId(trial_id).parts[0])) is not None:
                self._fail(slot, f"{trial_id} has taken far too long")
        for one in state.attempts("waiting"):
            name = one.entrant
            asked = max(self._seen.get(name, self._began), self._queued.get(name, self._began))
            patience = _RERUN_SECONDS if one.instead and state.closed is None else _ABSENT_SECONDS
            if self._has_key(name) and clock - asked > patience:
                self._act(journal.CANCEL, name, "its program has stopped asking for it", number=one.number)
        for name, entrant in state.entrants.items():
            since = entrant.amends if entrant.paused and self._has_key(name) else None
            if since is not None and now >= schedule.day_after(state, since):
                self._act(journal.RESUME, name, "a new day has begun")
        if state.closed is None and state.season.opens <= now < state.season.closes:
            for name in self._named:
                entrant = state.entrants[name]
                if not (entrant.attempts or entrant.excluded or self._has_key(name)):
                    self._act(journal.REQUEST, name, "its first", number=1)
        for one in schedule.next_attempts(state, now, self._is_ready):
            self._begin(one)
        for slot in list(self._slots.values()):
            self._go_on(slot)

    def _present(self, name: str) -> bool:
        return name in self._seen and self._clock() - self._seen[name] < _PRESENT_SECONDS

    def _is_ready(self, one: Attempt) -> bool:
        """Return whether an attempt that waits can be let play."""
        there = not self._has_key(one.entrant) or self._present(one.entrant)
        return there and self._clock() >= self._rests.get(one.entrant, -math.inf)

    def _player(self, playing: Act) -> Entrant:
        """Return an entrant as an act says that has its player and id."""
        return entrant_of(playing, self._named.get(playing.subject))

    def _has_key(self, name: str) -> bool:
        return self._player(self._state.entrants[name].present).key is not None

    def _begin(self, one: Attempt) -> None:
        """Let an attempt play, if there is a slot for it."""
        slot = self._free_slot()
        if slot is not None:
            entrant = self._state.entrants[one.entrant]
            before = entrant.attempts[one.instead].start if one.instead else None
            plays = entrant.present
            if before is not None and IMAGE_ID.fullmatch(before.id):  # an image is run again as it was
                plays = before
            more = {"player": plays.player, "id": plays.id, "value": str(slot)}
            start = act(journal.START, one.entrant, "", now=self._now(), number=one.number, **more)
            self._record(start)
            self._take_slot(start, resumed=False)

    def _free_slot(self) -> int | None:
        """Return a slot that is free, and does not rest since an attempt failed there; None without one."""
        taken = {slot.number for slot in self._slots.values()}
        slots, now = range(self._state.season.parallel), self._clock()
        rested = (slot for slot in slots if now >= self._rests.get(slot, now))
        return next((slot for slot in rested if slot not in taken), None)

    def _take_slot(self, start: Act, *, resumed: bool) -> _Slot:
        """Let an attempt have a slot, and return it."""
        name, number, entrant = start.subject, int(start.value), self._player(start)
        specs = attempt_trials(self._levels, self._competition.trials, start)
        if not resumed:
            add_trials(self._store, specs)
        competition = replace(self._competition, entrants=(entrant,))
        gate = None if self._gate is None else gate_of(self._gate, number)
        ids = [str(spec.id) for spec in specs]
        self.matches.update(zip(ids, matches(competition, specs, self._directory, gate), strict=True))
        attempt = self._state.attempt(name, start.number)
        slot = self._slots[name] = _Slot(attempt, number, ids, deque(ids), resumed)
        return slot

    def _go_on(self, slot: _Slot) -> None:
        """Play the next trial of an attempt, or end the attempt when there is none."""
        if slot.left and slot.left[0] not in self._jobs:
            self._add(slot.left[0])
        elif not slot.left and self._jobs.keys().isdisjoint(slot.trials):
            self._end(slot)

    def _add(self, trial_id: str, replay: Replay | None = None) -> None:
        """Let a trial be played, or replayed."""
        limits = self._competition.limits
        seconds = 2 * limits.start_seconds + limits.total_seconds + _SLACK_SECONDS
        self._jobs[trial_id] = _Job(self._clock() + seconds, replay)
        self.dispatcher.add(trial_id)

    def _was_played(self, slot: _Slot, outcome: TrialEnd, *, verified: bool = False) -> None:
        """Note how the next trial of an attempt has ended, and let it be replayed unless it is verified."""
        played = self.matches[slot.left.popleft()]
        reason, (_, task, number) = outcome.reason, played.spec.id.parts
        if reason is not None and not slot.forfeit:
            slot.forfeit = f"{task}, trial {number % self._competition.trials}: {reason}"
        if played.entrant.key is not None and reason is not None and reason.startswith(NOT_CONNECTED):
            for left in slot.left:  # nobody waits for it in each of them again
                self.matches[left] = replace(self.matches[left], absent=reason)
        if not verified:
            self._add(played.spec.id, Replay(self._directory, played.spec, outcome, played.steps))

    def _end(self, slot: _Slot) -> None:
        """Record that an attempt is over, and pause an entrant that fails again and again."""
        name = slot.attempt.entrant
        self._act(journal.OVER, name, slot.forfeit, number=slot.attempt.number)
        most = self._state.season.failures
        entrant = self._state.entrants[name]
        if entrant.failed >= most and not entrant.paused and self._state.closed is None:
            why = f"it has forfeited {most} attempts in a row, the last in {slot.forfeit}"
            if self._has_key(name):
                until = schedule.day_after(self._state, self._now())
                why += f"; until {until}, or until the organiser resumes it"
            self._act(journal.PAUSE, name, why, number=most)

    def _fail(self, slot: _Slot, why: str) -> None:
        """Record that an attempt has failed, not by its entrant's fault, and let another wait for it."""
        name, now = slot.attempt.entrant, self._now()
        attempts = self._state.entrants[name].attempts
        ours = act(journal.OURS, name, why, now=now, number=slot.attempt.number)
        kind = journal.RERUN if slot.attempt.instead else journal.REQUEST
        instead = slot.attempt.instead or slot.attempt.number
        why = f"instead of attempt {slot.attempt.number}"
        again = act(kind, name, why, now=now, number=len(attempts) + 1, instead=instead)
        ended = [one.state for one in reversed(attempts.values()) if one.state in ("over", "ours")]
        failed = ended.index("over") if "over" in ended else len(ended)
        self._rests[slot.number] = self._clock() + _REST_SECONDS
        self._rests[name] = self._clock() + _REST_SECONDS * 2 ** min(failed, _MOST_DOUBLED)
        ends = self._state.closed is not None and failed + 1 >= _MOST_AFTER_CLOSE
        self._record(ours, *([] if ends else [again]))

    def _leave(self, slot: _Slot) -> None:
        """Take the slot from an attempt that is no longer played."""
        del self._slots[slot.attempt.entrant]
        self._ended = self._clock()
        for trial_id in slot.trials:
            self.forget(trial_id)
            self._jobs.pop(trial_id, None)

    # The collector of the dispatcher

    def start(self, trial_id: str) -> Match | Replay:
        """Return the job of a trial: its match, or its replay if it is over."""
        return self._jobs[trial_id].replay or super().start(trial_id)

    def take(self, trial_id: str, report: Any) -> None:
        """Store a report."""
        if isinstance(report, ReplayVerdict):
            record_verdict(self._store, trial_id, report)
            if report.problem is not None:
                self._jobs[trial_id].problem = f"{trial_id} could not be verified: {report.problem}"
        else:
            super().take(trial_id, report)

    def starts_again(self, trial_id: str) -> bool:
        """Return True: what was lost starts over."""
        return self._jobs[trial_id].replay is not None or super().starts_again(trial_id)

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store the outcome of a trial that was played, and continue after one played or replayed."""
        slot = self._slots[TrialId(trial_id).parts[0]]
        job = self._jobs.pop(trial_id)
        failure = failure or job.problem
        if slot.resumed and self._forfeits.get(trial_id, "").startswith(NOT_CONNECTED):
            failure = failure or "the server was restarted, and its program did not come back"
        if failure is not None:
            if trial_id in self._records:
                super().end(trial_id, failure)
            self._fail(slot, failure)
            return
        if job.replay is None:
            slot.resumed = False
            self._was_played(slot, self._finish(trial_id))
        self._go_on(slot)

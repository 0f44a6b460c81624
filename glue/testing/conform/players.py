"""The kit as the hub of an agent or environment that mirrors (docs/clients.md), and the scenes of players."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import Any, Final

import numpy as np

from glue.client.bodies import READ, write
from glue.core.calls import role_calls
from glue.protocol.messages import CALLS, ErrorCode, Event, Kind, Message, Role, Value
from glue.protocol.wire import FROM_HUB, encode
from glue.testing.conform import forms
from glue.testing.conform.clients import Start
from glue.testing.conform.desk import LULL, MAX_BODY, Desk, Exchange, told
from glue.testing.conform.rules import PLAYERS, Broken, NotJudged, Rules, Tier
from glue.testing.conform.values import CHARS, DOUBLES, EMPTY, INTS, NOT_UTF_8, REWARDS, TEXTS
from glue.testing.conform.wire import Gone, Listener
from glue.testing.mirror import FAIL, FAILURE, MirrorAgent, MirrorEnvironment
from glue.types import Action, Observation

__all__ = ["RULES", "PlayerDesk"]

RULES: Final = Rules()

_KINDS: Final = {
    role: {kind.name.partition("_")[2]: kind for kind, call in CALLS.items() if call.callee is role}
    for role in PLAYERS
}
"""A role's calls, by what their names have beyond the role."""

SPEC: Final = "a task for a mirror, größer als nötig".encode()
SHOWN: Final = Observation(chars=b"ab")
"""What a player is shown where nothing else matters: whoever confuses numbers still understands it."""


class PlayerDesk(Desk):
    """What the mirror should answer is what ours answers; see `glue.testing.mirror`."""

    def __init__(self, role: Role, start: Start, listener: Listener, wait: float) -> None:
        super().__init__(role, start, listener, wait)
        self.kinds = _KINDS[role]
        self.seq = 0

    def begin(self) -> None:
        model: Any = MirrorAgent() if self.role is Role.AGENT else MirrorEnvironment()
        self._handlers = role_calls(self.role, model)
        self._plot: Iterator[tuple[str, tuple[Value, ...], bytes]] = cycle(self._episode())
        self.seq = 0

    def _episode(self) -> list[tuple[str, tuple[Value, ...], bytes]]:
        if self.role is Role.AGENT:
            return [
                ("INIT", (), SPEC),
                ("START", (), SHOWN.body),
                ("STEP", (0.0,), SHOWN.body),
                ("MESSAGE", (), b"how are you?"),
                ("STEP", (0.0,), Observation(chars=b"c").body),
                ("END", (0.0,), b""),
                ("START", (), SHOWN.body),
                ("CLEANUP", (), b""),
            ]
        return [
            ("INIT", (), b""),
            ("START", (), b""),
            ("STEP", (), SHOWN.body),
            ("MESSAGE", (), b"how are you?"),
            ("STEP", (), Observation(chars=b"c").body),
            ("START", (), b""),
            ("CLEANUP", (), b""),
        ]

    def exchanges(self) -> int:
        return len(self._episode())

    def prepare(self) -> Exchange:
        name, scalars, body = next(self._plot)
        return self.call(name, *scalars, body=body)

    def call(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Exchange:
        """Return a call, by default with the next number, and its answer."""
        self.seq = self.seq + 1 if seq is None else seq
        kind = self.kinds[name]
        values, result = self._handlers[kind](scalars, READ[CALLS[kind].request.body](body))
        asked = Message(kind, self.session, self.seq, scalars, body)
        answer = Message(kind, self.session, self.seq, values, write(result))
        return Exchange(encode(asked, FROM_HUB), answer)

    def ask(self, name: str, *scalars: Value, body: bytes = b"", seq: int | None = None) -> Sequence[bytes]:
        """Call, and expect the answer; return its frames."""
        exchange = self.call(name, *scalars, body=body, seq=seq)
        self.send_frames(exchange.frames)
        return self.take(exchange.expected)

    def step(self, shown: Observation | Action, reward: float = 0.0) -> Exchange:
        """Return a step that shows this to the player."""
        scalars = (reward,) if self.role is Role.AGENT else ()
        return self.call("STEP", *scalars, body=shown.body)

    def steps(self, *all_shown: Observation | Action) -> None:
        """Ask for a step with each of these."""
        for each in all_shown:
            exchange = self.step(each)
            self.send_frames(exchange.frames)
            self.take(exchange.expected)

    def settle(self) -> None:
        pass

    def resume(self) -> None:
        pass

    def repeat(self, exchange: Exchange, frames: Sequence[bytes]) -> None:
        self.send_frames(exchange.frames)
        self.take(exchange.expected)

    def took(self, message: Message) -> None:
        pass


# --- Plays --------------------------------------------------------------------------------------------


@RULES.add(
    "calls", Tier.PLAYS, "what-the-calls-mean", "every call is answered, in any order that may come", PLAYERS
)
def calls(desk: PlayerDesk) -> None:
    desk.episode()
    desk.ask("MESSAGE", body=b"before any init")
    start = SHOWN.body if desk.role is Role.AGENT else b""
    init = SPEC if desk.role is Role.AGENT else b""
    for name in ("INIT", "INIT", "START", "START", "CLEANUP", "CLEANUP", "INIT", "START"):
        desk.ask(name, body=start if name == "START" else init if name == "INIT" else b"")
    desk.steps(Action(chars=b"!"), SHOWN)  # On, after the end of the episode.


@RULES.add(
    "doubles", Tier.PLAYS, "bodies", "doubles keep all their bits: negative zero, NaN, infinities", PLAYERS
)
def doubles(desk: PlayerDesk) -> None:
    desk.steps(Observation([], DOUBLES), *(Observation([], [number]) for number in DOUBLES))
    exchange = desk.step(SHOWN, reward=-0.1)  # From the header into the doubles.
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)


@RULES.add("ints", Tier.PLAYS, "bodies", "ints are 32 bits, signed, little-endian", PLAYERS)
def ints(desk: PlayerDesk) -> None:
    desk.steps(Observation(INTS))


@RULES.add("chars", Tier.PLAYS, "bodies", "chars are any bytes", PLAYERS)
def chars(desk: PlayerDesk) -> None:
    desk.steps(Observation(chars=CHARS), Observation(chars=b"\0"))


@RULES.add(
    "empty",
    Tier.PLAYS,
    "bodies",
    "any of the runs may be empty, and all of them",
    PLAYERS,
    needs=("doubles",),
)
def empty(desk: PlayerDesk) -> None:
    desk.steps(*EMPTY)


@RULES.add(
    "large", Tier.PLAYS, "bodies", "bodies may be as large as WELCOME's max_body", PLAYERS, needs=("doubles",)
)
def large(desk: PlayerDesk) -> None:
    # What the mirror adds to it: an int, and one or two doubles.
    spare = MAX_BODY - 16 - 4 - (16 if desk.role is Role.AGENT else 8)
    count = np.arange(spare // 24)
    rest = spare - 12 * len(count)
    desk.steps(Observation([7] * 70, [0.25] * 40), Observation(count, count / 7, b"\xfe" * rest))


@RULES.add(
    "texts",
    Tier.PLAYS,
    "bodies",
    "texts are UTF-8: empty, long, outside of ASCII, with NUL",
    PLAYERS,
    needs=("large",),
)
def texts(desk: PlayerDesk) -> None:
    for text in TEXTS:
        desk.ask("MESSAGE", body=text)
    if desk.role is Role.AGENT:
        for text in TEXTS:
            desk.ask("INIT", body=text)


@RULES.add("rewards", Tier.PLAYS, "the-header", "a reward may be any number", PLAYERS, needs=("doubles",))
def rewards(desk: PlayerDesk) -> None:
    for reward in REWARDS:
        if desk.role is Role.AGENT:
            desk.ask("STEP", reward, body=SHOWN.body)
            desk.ask("END", reward)
        else:
            desk.steps(Action([], [reward]))


@RULES.add(
    "widths",
    Tier.PLAYS,
    "the-header",
    "every format of msgpack is understood, in every width",
    PLAYERS,
    needs=("doubles", "rewards"),
)
def widths(desk: PlayerDesk) -> None:
    kind = int(desk.kinds["STEP"])
    fixed = [forms.float_64(0.0)] if desk.role is Role.AGENT else []
    for variant in forms.VARIANTS:
        exchange = desk.step(SHOWN)
        desk.send_frames((forms.header(kind, desk.session, desk.seq, fixed, **variant), exchange.frames[1]))
        desk.take(exchange.expected)
    for reward, form in forms.rewards() if desk.role is Role.AGENT else ():
        exchange = desk.step(SHOWN, reward)
        desk.send_frames((forms.header(kind, desk.session, desk.seq, [form]), exchange.frames[1]))
        desk.take(exchange.expected)


# --- Survives -----------------------------------------------------------------------------------------

_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(
    "numbers", Tier.SURVIVES, _ONCE, "the numbers of calls only grow, with gaps, up to 2^63 - 1", PLAYERS
)
def numbers(desk: PlayerDesk) -> None:
    for seq in (desk.seq + 93, 2**15, 2**16, 2**31, 2**32, 2**53 + 1, 2**53 + 2, 2**63 - 2, 2**63 - 1):
        desk.ask("MESSAGE", body=b"a gap", seq=seq)
    desk.drop()  # There is no greater number.


@RULES.add(
    "repeated",
    Tier.SURVIVES,
    _ONCE,
    "a call that comes again gets the same answer, and is not carried out again",
    PLAYERS,
)
def repeated(desk: PlayerDesk) -> None:
    for _ in range(desk.exchanges()):
        exchange = desk.prepare()
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
        for _ in range(2):
            desk.send_frames(exchange.frames)
            desk.take(exchange.expected)
    desk.steps(SHOWN)


@RULES.add("outdated", Tier.SURVIVES, _ONCE, "a call with a number below the last is not answered", PLAYERS)
def outdated(desk: PlayerDesk) -> None:
    first = desk.step(SHOWN)
    desk.send_frames(first.frames)
    desk.take(first.expected)
    desk.steps(Observation(chars=b"8"))
    desk.send_frames(first.frames)
    desk.steps(Observation(chars=b"9"))
    desk.nothing("in answer to an outdated call")


@RULES.add(
    "silent-until-welcomed",
    Tier.SURVIVES,
    "greeting",
    "no answer goes over a new connection before WELCOME",
    PLAYERS,
)
def silent_until_welcomed(desk: PlayerDesk) -> None:
    exchange = desk.step(SHOWN)
    desk.send_frames(exchange.frames)
    frames = desk.take(exchange.expected)
    desk.cut()
    desk.connect()
    desk.nothing("between HELLO and WELCOME")
    desk.welcome()
    desk.nothing("until the call comes again")
    desk.repeat(exchange, frames)


@RULES.add(
    "forgets",
    Tier.SURVIVES,
    "greeting",
    "after `resumed` false numbers begin anew, and a number says nothing about calls before",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def forgets(desk: PlayerDesk) -> None:
    desk.steps(SHOWN, SHOWN)
    last = desk.seq
    for seq in (1, last):
        desk.cut()
        desk.connect()
        desk.welcome(resumed=False)
        # With `last`, it has the number of a call that was answered, but is another.
        desk.ask("MESSAGE", body=b"a hub that was restarted", seq=seq)
        desk.seq = last
        desk.steps(Observation(chars=b"6"))
        last = desk.seq


@RULES.add(
    "welcome-lost",
    Tier.SURVIVES,
    "greeting",
    "the very call that was answered last, after `resumed` false, gets the kept answer",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def welcome_lost(desk: PlayerDesk) -> None:
    exchange = desk.step(SHOWN)
    desk.send_frames(exchange.frames)
    desk.take(exchange.expected)
    for _ in range(2):
        desk.cut()
        desk.connect()
        desk.welcome(resumed=False)
        desk.send_frames(exchange.frames)
        desk.take(exchange.expected)
    desk.steps(SHOWN)


# --- Complete -----------------------------------------------------------------------------------------


@RULES.add(
    "unknown-kind",
    Tier.COMPLETE,
    "errors",
    "a kind that it does not know is answered with ERROR unknown-kind",
    PLAYERS,
)
def unknown_kind(desk: PlayerDesk) -> None:
    desk.seq += 1
    desk.send_frames((forms.header(63, desk.session, desk.seq, []),))
    _error(desk, ErrorCode.UNKNOWN_KIND)
    desk.seq += 1
    desk.send_frames((forms.header(62, desk.session, desk.seq, [forms.text("a", 8)]), b"with a body"))
    _error(desk, ErrorCode.UNKNOWN_KIND)
    desk.steps(SHOWN)


def _error(desk: PlayerDesk, code: ErrorCode) -> str:
    got, frames = desk.next(f"ERROR {desk.seq} {code}")
    if (got.kind, got.session, got.seq) != (Kind.ERROR, desk.session, desk.seq) or got.scalars[0] != code:
        raise Broken(f"ERROR {desk.seq} {code!s}", told(got), frames)
    return str(got.scalars[1])


@RULES.add(
    "ignores",
    Tier.COMPLETE,
    "what-a-peer-must-should-and-may-do",
    "ERRORs and NOTICEs that mean nothing to it are ignored, and never answered",
    PLAYERS,
)
def ignores(desk: PlayerDesk) -> None:
    for code in ("not-asked", "a-code-from-the-future"):
        desk.send(Kind.ERROR, code, "for nobody in particular", seq=desk.seq)
        desk.send(Kind.NOTICE, Event.JOINED, Role.EXPERIMENT, "someone")
        desk.steps(SHOWN)
    desk.nothing("in answer to an ERROR or a NOTICE")


@RULES.add(
    "seed", Tier.COMPLETE, "capabilities", "the capability seed: any number from 0 to 2^63 - 1", PLAYERS
)
def seed(desk: PlayerDesk) -> None:
    _needs(desk, "seed")
    for number in (0, 1, 2**31, 2**53 + 1, 2**63 - 1):
        desk.ask("SEED", number)
        if "save" in desk.capabilities:
            desk.ask("SAVE")


@RULES.add("save", Tier.COMPLETE, "capabilities", "the capability save: what was saved is loaded", PLAYERS)
def save(desk: PlayerDesk) -> None:
    _needs(desk, "save")
    desk.episode()
    desk.ask("SAVE")
    for saved in (b"0 0", b"41 2026", b"1000000 9223372036854775807"):
        desk.ask("LOAD", body=saved)
        desk.ask("SAVE")
        desk.steps(SHOWN)


def _needs(desk: PlayerDesk, capability: str) -> None:
    if capability not in desk.capabilities:
        raise NotJudged(f"the client does not offer {capability}")


@RULES.add(
    "broken-text",
    Tier.COMPLETE,
    "bodies",
    "a text that is not UTF-8 is answered, if only with ERROR",
    PLAYERS,
)
def broken_text(desk: PlayerDesk) -> None:
    for text in NOT_UTF_8:
        desk.seq += 1
        desk.send(desk.kinds["MESSAGE"], seq=desk.seq, body=text)
        got, frames = desk.next("an answer or an ERROR")
        if got.kind not in (Kind.ERROR, desk.kinds["MESSAGE"]) or got.seq != desk.seq:
            raise Broken(f"{desk.kinds['MESSAGE'].name} {desk.seq}, or ERROR", told(got), frames)
        if got.kind is Kind.ERROR and _left(desk):
            return
    desk.steps(SHOWN)


@RULES.add(
    "max-body",
    Tier.COMPLETE,
    "greeting",
    "an answer larger than WELCOME's max_body is not sent; ERROR is",
    PLAYERS,
    needs=("silent-until-welcomed",),
)
def max_body(desk: PlayerDesk) -> None:
    desk.cut()
    desk.connect()
    limit = 20_000
    desk.welcome(max_body=limit)
    exchange = desk.step(Observation([1] * 4995))
    desk.send_frames(exchange.frames)
    got, frames = desk.next("ERROR exception")
    if got.kind is not Kind.ERROR or got.scalars[0] != ErrorCode.EXCEPTION or got.seq != desk.seq:
        raise Broken(f"ERROR {desk.seq} exception, since {limit} bytes are allowed", told(got), frames)
    if not _left(desk):
        desk.cut()
        desk.reconnect()
        desk.steps(SHOWN)


@RULES.add(
    "exception",
    Tier.COMPLETE,
    "errors",
    "a player's own failure is reported with ERROR exception and its text",
    PLAYERS,
)
def exception(desk: PlayerDesk) -> None:
    desk.seq += 1
    desk.send(desk.kinds["MESSAGE"], seq=desk.seq, body=FAIL.encode())
    text = _error(desk, ErrorCode.EXCEPTION)
    if FAILURE not in text:
        raise Broken(f"the text {FAILURE!r} in ERROR exception", repr(text))
    if not _left(desk):
        desk.steps(SHOWN)


def _left(desk: PlayerDesk) -> bool:
    """Return whether the client left after an ERROR, as it may."""
    try:
        frames = desk.wire.receive(LULL)
    except Gone:
        frames = None
    else:
        if frames is None:
            return False
        desk.wire.ends(desk.wait)
    desk.cut()
    desk.client.wait(desk.wait)
    return True

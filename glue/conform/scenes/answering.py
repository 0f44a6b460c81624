"""Scenes of the answers of an agent or environment: each call is carried out once."""

from __future__ import annotations

from typing import Final

from glue.conform.hub.comparing import described
from glue.conform.hub.connection import Gone
from glue.conform.hub.mirror import FAIL, FAILURE
from glue.conform.hub.player import SHOWN, PlayerHarness
from glue.conform.hub.rules import PLAYERS, Broken, Requirement, Rules, Tier
from glue.conform.scenes import forms
from glue.conform.scenes.values import NOT_UTF_8
from glue.types import Action, Observation
from glue.wire.messages import ErrorCode, Event, Kind, Role

RULES: Final = Rules(PLAYERS)

_ONCE: Final = "calls-and-how-each-happens-exactly-once"


@RULES.add(Tier.SURVIVES, _ONCE)
def numbers(kit: PlayerHarness) -> None:
    """The numbers of calls only grow, with gaps, up to 2^63 - 1."""
    kit.exchange()
    for seq in (kit.seq + 93, 2**15, 2**16, 2**31, 2**32, 2**53 + 1, 2**53 + 2, 2**63 - 2, 2**63 - 1):
        kit.ask("MESSAGE", body=b"a gap", seq=seq)
    kit.drop()  # There is no greater number.


@RULES.add(Tier.SURVIVES, _ONCE)
def repeated(kit: PlayerHarness) -> None:
    """A repeated call gets the same answer, byte for byte, and is not carried out again."""
    for _ in range(kit.exchanges()):
        exchange = kit.prepare()
        frames = kit.run(exchange)
        for _ in range(2):
            kit.repeat(exchange, frames)
    kit.steps(SHOWN)


@RULES.add(Tier.SURVIVES, _ONCE, needs=("large", "counts", "repeated"), mirror=True)
def large_repeated(kit: PlayerHarness) -> None:
    """An answer of any size is kept: its call is not carried out again."""
    for size in (70_000, 500_000):
        exchange = kit.step(Observation(chars=bytes(size)))
        frames = kit.run(exchange)
        kit.repeat(exchange, frames)
        kit.cut()
        kit.reconnect()
        kit.repeat(exchange, frames)
        kit.steps(SHOWN)


@RULES.add(Tier.SURVIVES, _ONCE)
def outdated(kit: PlayerHarness) -> None:
    """A call with a number below the last is not answered."""
    first = kit.step(SHOWN)
    kit.run(first)
    kit.steps(Observation([0], chars=b"8a"))
    kit.send_frames(first.frames)
    kit.steps(Observation([0], chars=b"9a"))
    kit.nothing("in answer to an outdated call")


@RULES.add(Tier.SURVIVES, "greeting")
def silent_until_welcomed(kit: PlayerHarness) -> None:
    """No answer is sent over a new connection before WELCOME."""
    exchange = kit.step(SHOWN)
    frames = kit.run(exchange)
    kit.cut()
    kit.connect()
    kit.nothing("between HELLO and WELCOME")
    kit.welcome()
    kit.nothing("until the call is repeated")
    kit.repeat(exchange, frames)


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed", "large", "counts"))
def answer_delayed(kit: PlayerHarness) -> None:
    """An answer computed while its connection was cut waits for WELCOME and for the repeated call."""
    for _ in range(3):
        # Large, so that the connection is cut before the answer is sent.
        exchange = kit.step(Observation(chars=bytes(900_000)))
        kit.send_frames(exchange.frames)
        kit.cut()
        kit.connect(queued=exchange.expected)
        kit.nothing("between HELLO and WELCOME")
        kit.welcome()
        kit.run(exchange)
        kit.steps(SHOWN)


@RULES.add(Tier.SURVIVES, "greeting", needs=("outdated",))
def welcome_unasked(kit: PlayerHarness) -> None:
    """A WELCOME that answers no HELLO changes nothing."""
    outdated = kit.step(SHOWN)
    kit.run(outdated)
    kit.steps(SHOWN)
    for seq in (None, 2**40):
        kit.welcome(resumed=False, seq=seq)
    kit.send_frames(outdated.frames)
    kit.nothing("in answer to an outdated call after a WELCOME that answers no HELLO")
    kit.steps(SHOWN)


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",))
def forgets(kit: PlayerHarness) -> None:
    """After `resumed` false numbers start again, and say nothing about earlier calls."""
    kit.steps(SHOWN, SHOWN)
    last = kit.seq
    for seq in (1, last):
        kit.cut()
        kit.connect()
        kit.welcome(resumed=False)
        # With `last`, the call has the number of one that was answered, but is another call.
        kit.ask("MESSAGE", body=b"a hub that was restarted", seq=seq)
        kit.seq = last
        kit.steps(Observation([0], chars=b"6a"))
        last = kit.seq


@RULES.add(Tier.SURVIVES, "greeting", needs=("silent-until-welcomed",), level=Requirement.SHOULD)
def welcome_lost(kit: PlayerHarness) -> None:
    """After `resumed` false the last call, if repeated, still gets the kept answer."""
    exchange = kit.step(SHOWN)
    frames = kit.run(exchange)
    for _ in range(2):
        kit.cut()
        kit.connect()
        kit.welcome(resumed=False)
        kit.repeat(exchange, frames)
    kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "errors")
def unknown_kind(kit: PlayerHarness) -> None:
    """An unknown kind is answered with ERROR unknown-kind."""
    kit.seq += 1
    kit.send_frames((forms.header(63, kit.session, kit.seq, []),))
    _error(kit, ErrorCode.UNKNOWN_KIND)
    kit.seq += 1
    kit.send_frames((forms.header(62, kit.session, kit.seq, [forms.text("a", 8)]), b"with a body"))
    _error(kit, ErrorCode.UNKNOWN_KIND)
    kit.steps(SHOWN)


def _error(kit: PlayerHarness, code: ErrorCode) -> str:
    got, frames = kit.next(f"ERROR {kit.seq} {code}")
    if (got.kind, got.session, got.seq) != (Kind.ERROR, kit.session, kit.seq) or got.scalars[0] != code:
        raise Broken(f"ERROR {kit.seq} {code!s}", described(got), frames)
    return str(got.scalars[1])


@RULES.add(Tier.COMPLETE, "what-a-peer-must-should-and-may-do")
def ignores(kit: PlayerHarness) -> None:
    """ERRORs and NOTICEs that do not concern the player are ignored, and never answered."""
    for code in ("not-asked", "a-code-from-the-future"):
        kit.send(Kind.ERROR, code, "for nobody in particular", seq=kit.seq)
        kit.send(Kind.NOTICE, Event.JOINED, Role.EXPERIMENT, "someone")
        kit.steps(SHOWN)
    kit.nothing("in answer to an ERROR or a NOTICE")


@RULES.add(Tier.COMPLETE, "capabilities", level=Requirement.MAY, capability="seed")
def seed(kit: PlayerHarness) -> None:
    """A seed may be any number from 0 to 2^63 - 1."""
    for number in (0, 1, 2**31, 2**53 + 1, 2**63 - 1):
        kit.ask("SEED", number)
        if "save" in kit.capabilities:
            kit.ask("SAVE")


@RULES.add(Tier.COMPLETE, "capabilities", level=Requirement.MAY, capability="save", mirror=True)
def save(kit: PlayerHarness) -> None:
    """The bytes of save are loaded again."""
    kit.episode()
    kit.ask("SAVE")
    for saved in (b"0 0", b"41 2026", b"1000000 9223372036854775807"):
        kit.ask("LOAD", body=saved)
        kit.ask("SAVE")
        kit.steps(SHOWN)


@RULES.add(
    Tier.COMPLETE,
    "capabilities",
    roles=(Role.AGENT,),
    level=Requirement.MAY,
    capability="metrics",
    mirror=True,
)
def metrics(kit: PlayerHarness) -> None:
    """Each metric is a double, its name a line of the chars; asking changes nothing."""
    kit.episode()
    for _ in range(2):
        kit.ask("METRICS")
        kit.steps(SHOWN)


@RULES.add(
    Tier.COMPLETE,
    "capabilities",
    roles=(Role.ENVIRONMENT,),
    needs=("calls",),
    level=Requirement.MAY,
    capability="truncate",
    mirror=True,
)
def truncate(kit: PlayerHarness) -> None:
    """An episode that is cut off has the terminal 2."""
    kit.steps(*(Action(chars=chars) for chars in (b"a?", b"a!", b"?", b"a")))


@RULES.add(Tier.COMPLETE, "bodies")
def broken_text(kit: PlayerHarness) -> None:
    """A text that is not UTF-8 is answered, if only with ERROR."""
    for text in NOT_UTF_8:
        kit.seq += 1
        kit.send(kit.kinds["MESSAGE"], seq=kit.seq, body=text)
        got, frames = kit.next("an answer or an ERROR")
        if got.kind not in (Kind.ERROR, kit.kinds["MESSAGE"]) or got.seq != kit.seq:
            raise Broken(f"{kit.kinds['MESSAGE'].name} {kit.seq}, or ERROR", described(got), frames)
        if got.kind is Kind.ERROR and _left(kit):
            return
    kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",), mirror=True)
def max_body(kit: PlayerHarness) -> None:
    """An answer larger than WELCOME's max_body is not sent; ERROR is."""
    kit.cut()
    kit.connect()
    limit = 20_000
    kit.welcome(max_body=limit)
    exchange = kit.step(Observation([1] * 4995))
    kit.send_frames(exchange.frames)
    got, frames = kit.next("ERROR exception")
    if got.kind is not Kind.ERROR or got.scalars[0] != ErrorCode.EXCEPTION or got.seq != kit.seq:
        raise Broken(f"ERROR {kit.seq} exception, since {limit} bytes are allowed", described(got), frames)
    if not _left(kit):
        kit.cut()
        kit.reconnect()
        kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "errors", level=Requirement.SHOULD, mirror=True)
def exception(kit: PlayerHarness) -> None:
    """A player's own failure is reported with ERROR exception and its text."""
    kit.seq += 1
    kit.send(kit.kinds["MESSAGE"], seq=kit.seq, body=FAIL.encode())
    text = _error(kit, ErrorCode.EXCEPTION)
    if FAILURE not in text:
        raise Broken(f"the text {FAILURE!r} in ERROR exception", repr(text))
    if not _left(kit):
        kit.steps(SHOWN)


def _left(kit: PlayerHarness) -> bool:
    """Return whether the client left after an ERROR, as it may: it must leave, or answer the next call."""
    exchange = kit.step(SHOWN)
    expected = f"{described(exchange.expected)}, or its end"
    try:
        kit.connection.send(exchange.frames)
        frames = kit.heard(kit.wait)
        if frames is None:
            raise Broken(expected, f"nothing in {kit.wait:g} s")
        got = kit.decoded(frames, expected)
        if got.kind is not Kind.GOODBYE:
            kit.matches(exchange.expected, got, frames)
            return False
        kit.connection.ends(kit.wait)
    except Gone:
        pass
    kit.cut()
    kit.client.wait(kit.wait)
    return True

"""The rules for agents and environments: calls, the values in them, and that each is carried out once."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Final

import numpy as np

from glue import batches
from glue.conform import forms
from glue.conform.clients.connection import Gone
from glue.conform.clients.harness import MAX_BODY, SHOWN, SPEC, TASK, PlayerHarness
from glue.conform.clients.mirror import FAIL, FAILURE
from glue.conform.messages import described
from glue.conform.rules import Broken, NotJudged, Requirement, Rules, Tier
from glue.errors import GlueError, TaskSpecError
from glue.taskspec import parse_task_spec
from glue.types import CUT_OFF, Action, Observation
from glue.wire.beside import readable
from glue.wire.messages import EXTRAS, MASK, PLAYERS, ErrorCode, Event, Kind, Message, Role

RULES: Final = Rules(PLAYERS)


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def calls(kit: PlayerHarness) -> None:
    """Every call is answered, in any legal order."""
    kit.episode()
    if not kit.mirror:
        kit.episode()
        return  # Another order may be an error in the client's task.
    kit.ask("MESSAGE", body=b"between two episodes")
    start = SHOWN.body if kit.role is Role.AGENT else b""
    init = SPEC if kit.role is Role.AGENT else b""
    for name in ("INIT", "INIT", "START", "START", "CLEANUP", "CLEANUP", "INIT", "START"):
        kit.ask(name, body=start if name == "START" else init if name == "INIT" else b"")
    kit.steps(Action(chars=b"!"), SHOWN)  # Steps continue after the end of the episode.


@RULES.add(Tier.PLAYS, "what-the-calls-mean", mirror=True)
def before_init(kit: PlayerHarness) -> None:
    """Any call may come before INIT: messages, a start, a cleanup."""
    start = SHOWN.body if kit.role is Role.AGENT else b""
    for name, body in (("MESSAGE", b"before any init"), ("START", start), ("CLEANUP", b"")):
        kit.fresh()
        kit.ask(name, body=body)
    kit.episode()


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def doubles(kit: PlayerHarness) -> None:
    """Doubles keep all their bits: negative zero, NaN, infinities."""
    kit.steps(Observation([], forms.DOUBLES), *(Observation([], [number]) for number in forms.DOUBLES))
    kit.run(kit.step(SHOWN, reward=-0.1))  # The reward goes from the header into the doubles.


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def ints(kit: PlayerHarness) -> None:
    """Ints are 32 bits, signed, little-endian."""
    kit.steps(Observation(forms.INTS))


@RULES.add(Tier.PLAYS, "bodies", mirror=True)
def chars(kit: PlayerHarness) -> None:
    """Chars are any bytes."""
    kit.steps(Observation(chars=forms.CHARS), Observation(chars=b"\0"))


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles",), mirror=True)
def empty(kit: PlayerHarness) -> None:
    """Any or all of the runs may be empty."""
    kit.steps(*forms.EMPTY)


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles",), mirror=True)
def counts(kit: PlayerHarness) -> None:
    """Each of the runs may have more than 65,535 elements."""
    kit.steps(*forms.MANY)


@RULES.add(Tier.PLAYS, "bodies", needs=("doubles", "counts"), mirror=True)
def large(kit: PlayerHarness) -> None:
    """Bodies may be as large as WELCOME's max_body."""
    # Room for the mirror's additions: an int, and one or two doubles.
    spare = MAX_BODY - 16 - 4 - (16 if kit.role is Role.AGENT else 8)
    count = np.arange(spare // 24)
    rest = spare - 12 * len(count)
    kit.steps(Observation([7] * 70, [0.25] * 40), Observation(count, count / 7, b"\xfe" * rest))


@RULES.add(Tier.PLAYS, "bodies", needs=("large",), mirror=True)
def texts(kit: PlayerHarness) -> None:
    """Texts are UTF-8: empty, long, outside of ASCII, with NUL."""
    for text in forms.TEXTS:
        kit.ask("MESSAGE", body=text)
    if kit.role is Role.AGENT:
        for text in forms.TEXTS:
            kit.ask("INIT", body=text)


@RULES.add(Tier.PLAYS, "the-header", needs=("doubles",), mirror=True)
def rewards(kit: PlayerHarness) -> None:
    """A reward may be any number."""
    for reward in forms.REWARDS:
        if kit.role is Role.AGENT:
            kit.ask("STEP", reward, body=SHOWN.body)
            kit.ask("END", reward)
        else:
            kit.steps(Action([], [reward]))


@RULES.add(Tier.PLAYS, "the-header", needs=("doubles", "rewards"))
def widths(kit: PlayerHarness) -> None:
    """Every format of msgpack is understood, in every width."""
    for variant in forms.VARIANTS:
        exchange = kit.step(SHOWN)
        kind = int(exchange.expected.kind)
        fixed = [forms.float_64(0.0)] if kit.kinds["STEP"] == kind and kit.role is Role.AGENT else []
        kit.send_frames((forms.header(kind, kit.session, kit.seq, fixed, **variant), exchange.frames[1]))
        kit.take(exchange.expected)
    for reward, form in forms.rewards() if kit.role is Role.AGENT and kit.mirror else ():
        kind = int(kit.kinds["STEP"])
        exchange = kit.step(SHOWN, reward)
        kit.send_frames((forms.header(kind, kit.session, kit.seq, [form]), exchange.frames[1]))
        kit.take(exchange.expected)


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


def _error(kit: PlayerHarness, code: ErrorCode, why: str = "") -> str:
    error = kit.expect(
        f"ERROR {kit.seq} {code}{why}",
        lambda got: got[:3] == (Kind.ERROR, kit.session, kit.seq) and got.scalars[0] == code,
    )
    return str(error.scalars[1])


@RULES.add(Tier.COMPLETE, "what-a-peer-must-should-and-may-do")
def ignores(kit: PlayerHarness) -> None:
    """ERRORs and NOTICEs that do not concern the player are ignored, and never answered."""
    for code in ("not-asked", "a-code-from-the-future"):
        kit.send(Kind.ERROR, code, "for nobody in particular", seq=kit.seq)
        kit.send(Kind.NOTICE, Event.JOINED, Role.EXPERIMENT, "someone")
        kit.steps(SHOWN)
    kit.nothing("in answer to an ERROR or a NOTICE")


@RULES.add(Tier.COMPLETE, "capabilities", capability="seed")
def seed(kit: PlayerHarness) -> None:
    """A seed may be any number from 0 to 2^63 - 1."""
    for number in (0, 1, 2**31, 2**53 + 1, 2**63 - 1):
        kit.ask("SEED", number)
        if "save" in kit.capabilities:
            kit.ask("SAVE")


@RULES.add(Tier.COMPLETE, "capabilities", capability="save", mirror=True)
def save(kit: PlayerHarness) -> None:
    """The bytes of save are loaded again."""
    kit.episode()
    kit.ask("SAVE")
    for saved in (b"0 0", b"41 2026", b"1000000 9223372036854775807"):
        kit.ask("LOAD", body=saved)
        kit.ask("SAVE")
        kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "capabilities", roles=(Role.AGENT,), capability="metrics", mirror=True)
def metrics(kit: PlayerHarness) -> None:
    """Each metric is a double, its name a line of the chars; asking changes nothing."""
    kit.episode()
    for _ in range(2):
        kit.ask("METRICS")
        kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "an-environment-that-does-not-wait", roles=(Role.AGENT,), capability="pace")
def pace(kit: PlayerHarness) -> None:
    """A step's reward may be followed by a deadline and a latency, or not."""
    kit.episode()
    shown = SHOWN if kit.mirror else Observation([0])
    for scalars in ((0.0, 0.04, 0.01), (0.0,), (0.0, 0.0, 3600.0)):
        kit.ask("STEP", *scalars, body=shown.body)


@RULES.add(
    Tier.COMPLETE,
    "capabilities",
    roles=(Role.ENVIRONMENT,),
    needs=("calls",),
    capability="truncate",
    mirror=True,
)
def truncate(kit: PlayerHarness) -> None:
    """An episode that is cut off has the terminal 2."""
    kit.steps(*(Action(chars=chars) for chars in (b"a?", b"a!", b"?", b"a")))


_BESIDE: Final = "beside-the-observation"


@RULES.add(Tier.COMPLETE, _BESIDE, roles=(Role.AGENT,), capability=MASK, mirror=True)
def mask(kit: PlayerHarness) -> None:
    """The bits of a mask, of which there may be none, say which values are legal."""
    kit.steps(*forms.MASKED, SHOWN)
    kit.ask("START", body=forms.MASKED[0].body)


@RULES.add(Tier.COMPLETE, _BESIDE, roles=(Role.ENVIRONMENT,), capability=MASK, mirror=True)
def beside(kit: PlayerHarness) -> None:
    """A mask and extras follow the observation, with their sizes in bytes 12 to 15."""
    kit.steps(*forms.ASKING, SHOWN)


@RULES.add(
    Tier.COMPLETE,
    _BESIDE,
    roles=(Role.ENVIRONMENT,),
    needs=("beside", "silent-until-welcomed"),
    capability=MASK,
    mirror=True,
)
def unconfirmed(kit: PlayerHarness) -> None:
    """A mask or extras that the last WELCOME does not confirm are not sent."""
    for carries in (None, frozenset[str](), {MASK}, {EXTRAS}):
        kit.connect()
        kit.welcome(carries=carries)
        for asking in forms.ASKING:
            exchange = kit.step(asking)
            expected = exchange.expected._replace(body=readable(exchange.expected.body, carries or set()))
            kit.run(exchange._replace(expected=expected))
    kit.reconnect()


@RULES.add(Tier.COMPLETE, "bodies")
def broken_text(kit: PlayerHarness) -> None:
    """A text that is not UTF-8 is answered, if only with ERROR."""
    kinds = Kind.ERROR, kit.kinds["MESSAGE"]
    for text in forms.NOT_UTF_8:
        kit.seq += 1
        kit.send(kit.kinds["MESSAGE"], seq=kit.seq, body=text)
        expected = f"{kinds[1].name} {kit.seq}, or ERROR"
        got = kit.expect(expected, lambda got: got.kind in kinds and got.seq == kit.seq)
        if got.kind is Kind.ERROR and _left(kit):
            return
    kit.steps(SHOWN)


@RULES.add(Tier.COMPLETE, "greeting", needs=("silent-until-welcomed",), mirror=True)
def max_body(kit: PlayerHarness) -> None:
    """An answer larger than WELCOME's max_body is not sent; ERROR is."""
    kit.connect()
    limit = 20_000
    kit.welcome(max_body=limit)
    exchange = kit.step(Observation([1] * 4995))
    kit.send_frames(exchange.frames)
    _error(kit, ErrorCode.EXCEPTION, f", since {limit} bytes are allowed")
    if not _left(kit):
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
    with suppress(Gone):
        kit.connection.send(exchange.frames)
        frames = kit.heard(kit.wait)
        if frames is None:
            raise Broken(expected, f"nothing in {kit.wait:g} s")
        got = kit.decoded(frames, expected)
        if got.kind is not Kind.GOODBYE:
            kit.matches(exchange.expected, got, frames)
            return False
        kit.connection.ends(kit.wait)
    kit.cut()
    kit.client.wait(kit.wait)
    return True


_GAMES: Final = 3

_STEPS: Final = 60
"""Number of steps in which the environment's batch is checked."""


@RULES.add(Tier.COMPLETE, "batches", name="batch", roles=(Role.AGENT,), capability="batch")
def acting(kit: PlayerHarness) -> None:
    """An agent is shown a batch, and answers with an action for each of its games."""
    kit.fresh()
    kit.ask("INIT", body=batches.batch_task_spec(_GAMES, TASK.decode()).encode())
    for step, terminals in enumerate(([0, 0, 0], [0, 1, 2], [2, 2, 2], [1, 0, 1], [0, 0, 0])):
        values = [Observation([0])] * (_GAMES + terminals.count(CUT_OFF))
        rewards = np.zeros(_GAMES) if step == 0 else np.array([0.5, -0.25, 1.0])
        body = batches.pack_batch(
            batches.Batch(rewards, np.array(terminals, np.int32), batches.Ragged.of(values))
        ).body
        name, scalars = ("STEP", (float(rewards.sum()),)) if step else ("START", ())
        answer = _answer(kit, name, *scalars, body=body)
        try:
            batches.unpack_actions(Action.from_body(answer.body), _GAMES)
        except GlueError as error:
            raise Broken(f"the actions of {_GAMES} games: {error}", described(answer)) from None
    kit.drop()  # The client's numbers are not those of the kit's own model.


@RULES.add(Tier.COMPLETE, "batches", name="batch", roles=(Role.ENVIRONMENT,), capability="batch")
def playing(kit: PlayerHarness) -> None:
    """An environment shows each of its games: rewards, terminals, and last observations of those cut off."""
    kit.fresh()
    text = _answer(kit, "INIT").body.decode()
    try:
        games, inner = batches.read_batch_task_spec(text)
    except GlueError as error:
        raise Broken(f"the task spec of a batch: {error}", repr(text)) from None
    generator = np.random.default_rng(0)
    _checked(_answer(kit, "START"), games, start=True)
    try:
        actions = parse_task_spec(inner).actions
    except TaskSpecError as error:
        raise NotJudged(f"its task spec does not tell the legal actions: {error}") from None
    for _ in range(_STEPS):
        chosen = [Action(*actions.sample(generator)) for _ in range(games)]
        _checked(_answer(kit, "STEP", body=batches.pack_actions(batches.Ragged.of(chosen)).body), games)
    kit.drop()


def _answer(kit: PlayerHarness, name: str, *scalars: float, body: bytes = b"") -> Message:
    """Call a player whose answer is not the mirror's; return the answer."""
    kit.seq += 1
    kind = kit.kinds[name]
    kit.send(kind, *scalars, seq=kit.seq, body=body)
    return kit.expect(f"{kind.name} {kit.seq}", lambda got: got[:3] == (kind, kit.session, kit.seq))


def _checked(answer: Message, games: int, start: bool = False) -> None:
    """Check the batch in the answer to ENV_START or ENV_STEP."""
    try:
        rewards, terminals, _ = batches.unpack_batch(Observation.from_body(answer.body))
    except GlueError as error:
        raise Broken(f"a batch of {games} games: {error}", described(answer)) from None
    sum_of_rewards = math.fsum(rewards.tolist())
    reward, terminal = (sum_of_rewards, False) if start else answer.scalars
    for kept, expected in (
        (len(rewards) == len(terminals) == games, f"rewards and terminals of {games} games"),
        (not start or not (rewards.any() or terminals.any()), "rewards and terminals of 0 at the start"),
        (terminal is False, "the terminal false: games of a batch end by themselves"),
        (
            math.isclose(float(str(reward)), sum_of_rewards, rel_tol=1e-9, abs_tol=1e-9),
            f"as reward {sum_of_rewards!r}, the sum of the games' rewards",
        ),
    ):
        if not kept:
            raise Broken(expected, described(answer))

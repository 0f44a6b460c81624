"""docs/protocol-reference.md agrees with the program: its examples to the byte, its tables, its limits."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Final

import pytest

import glue.testing
from glue.engine.local import local
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, HubConfig
from glue.hub.io.channels import MAX_UNSENT, MAX_WITHOUT_SESSION
from glue.hub.sessions import INSTANCE_SIZE, ONE_RUN
from glue.types import AbstractType, Action, Observation, beside_sizes, body_size
from glue.wire.codec import decode, encode
from glue.wire.messages import (
    BESIDE,
    CALLS,
    CONTROL,
    MAX_BODY,
    MAX_HEADER,
    MAX_NAME,
    OBSERVING,
    OUTCOME,
    PACE,
    PROTOCOL_VERSION,
    Body,
    ErrorCode,
    Event,
    Kind,
    Role,
    Scalar,
    Shape,
)
from tests.glue.wire.examples import EXAMPLES, TEXT, Example
from tests.pages import DOCS, blocks, rows, section
from tests.players import ScriptedAgent, ScriptedEnvironment

NOTHING: Final = "–"


def tables(*head: str) -> list[list[list[str]]]:
    """Return the rows of every table with these column heads."""
    line = re.escape("| " + " | ".join(head) + " |")
    found = re.findall(rf"^{line}\n\|[- |]+\|\n((?:\|.*\|\n)+)", TEXT, re.MULTILINE)
    return [[[cell.strip() for cell in row.strip("|").split("|")] for row in t.splitlines()] for t in found]


def table(*head: str) -> list[list[str]]:
    (rows,) = tables(*head)
    return rows


# --- The examples -------------------------------------------------------------------------------------


KINDS_HEAD: Final = ("code", "kind", "request: scalars", "request: body", "reply: scalars", "reply: body")
CONTROL_HEAD: Final = ("code", "kind", "direction", "scalars")
OBSERVING_HEAD: Final = ("code", "kind", "direction", "scalars", "body")


@pytest.mark.parametrize("example", EXAMPLES, ids=str)
def test_example_decodes_to_what_it_means(example: Example) -> None:
    message = decode(example.frames, example.shapes)

    kind, session, seq, *scalars = example.meant
    assert message[:3] == (example.kind, session, seq)
    assert kind == example.kind
    assert list(message.scalars) == [tuple(s) if isinstance(s, list) else s for s in scalars]
    assert b"".join(example.frames[1:]) == message.body
    assert encode(message, example.shapes) == example.frames


@pytest.mark.parametrize("example", EXAMPLES, ids=str)
def test_commentary_of_an_example_is_true(example: Example) -> None:
    shape = example.shapes[example.kind]
    body = b"".join(example.frames[1:])
    if shape.body in (Body.OBSERVATION, Body.ACTION):
        expected = comments_on(body)
    elif shape.body is Body.OBSERVATION_ACTION:
        cut = body_size(body)
        expected = comments_on(body[:cut]) + comments_on(body[cut:])
    elif shape.body is Body.TEXT and body:
        quoted = [comment.split('"')[1] for comment in example.comments]
        assert "".join(quoted) == body.decode()
        return
    else:
        return
    assert example.comments == expected


def comments_on(body: bytes) -> list[str]:
    value = AbstractType.from_body(body)
    ints, doubles, chars = value.counts
    counts = [
        f"{count} {name}{'' if count == 1 else 's'}"
        for count, name in ((ints, "int"), (doubles, "double"), (chars, "char"))
    ]
    text = [f'"{value.chars.decode()}"'.replace("\n", "\\n")] if chars else []
    mask, extras = beside_sizes(body)
    sizes = [f"{mask} byte{'' if mask == 1 else 's'} of mask", f"{extras} bytes of extras"]
    numbers = [*map(repr, value.doubles.tolist()), *map(str, value.ints.tolist())]
    beside = ["mask"] * bool(mask) + ["extras"] * bool(extras)
    return [*counts, *(sizes if mask or extras else ["zero"]), *numbers, *text, *beside]


def test_every_kind_has_an_example_in_every_direction() -> None:
    expected = set()
    for kind, call in CALLS.items():
        asker = "experiment" if call.callee is None else "hub"
        answerer = "hub" if call.callee is None else str(call.callee)
        expected |= {(kind, asker, answerer), (kind, answerer, asker)}
    for _, name, direction, _ in table(*CONTROL_HEAD):
        for way in ("peer → hub", "hub → peer") if direction == "either" else (direction,):
            sender, receiver = way.split(" → ")
            expected.add((Kind[name], sender, receiver))
    for _, name, direction, _, _ in table(*OBSERVING_HEAD):
        sender, receiver = direction.split(" → ")
        expected.add((Kind[name], sender, receiver))

    assert {(e.kind, e.sender, e.receiver) for e in EXAMPLES} == expected


def test_the_examples_of_bodies_are_right() -> None:
    (_, _, plain), (_, _, beside), *_ = blocks(TEXT, "body")
    mask = [False, True, False, True, False, True]
    for block, value in (
        (plain, Observation([11, -2], [0.5], b"abc")),
        (beside, Observation([11], mask=mask, extras={"coins": 7, "walk.x": 0.5})),
    ):
        lines = [line.partition(";") for line in block.splitlines()]
        assert b"".join(bytes.fromhex(data) for data, _, _ in lines) == value.body
        assert [comment.strip() for _, _, comment in lines if comment] == comments_on(value.body)


def test_code_in_the_text_is_that_of_the_examples() -> None:
    ((_, _, c),) = blocks(TEXT, "c")
    ((_, _, javascript),) = blocks(TEXT, "js")

    assert c in (DOCS / "examples/c/peer.h").read_text()
    assert javascript in (DOCS.parent / "clients/javascript/src/body.js").read_text()


# --- The tables ---------------------------------------------------------------------------------------

TYPES: Final = {int: "int", float: "float", bool: "bool", str: "text", bytes: "binary"}

BODIES: Final = {
    Body.NONE: NOTHING,
    Body.OBSERVATION: "observation",
    Body.ACTION: "action",
    Body.OBSERVATION_ACTION: "observation, action",
    Body.TEXT: "text",
    Body.BLOB: "bytes",
}


def scalars_cell(shape: Shape) -> str:
    cells = [
        ", ".join(f"`{scalar.name}` {type_cell(scalar)}" for scalar in s) for s in (shape.scalars, shape.more)
    ]
    with_what = "[`mask`, `extras` or `pace`](#capabilities)"
    if shape.more == CONTROL[Kind.HELLO].scalars[-1:]:
        return f"; with {with_what} also ".join(cells)
    paced = (CALLS[Kind.AGENT_STEP].request, CALLS[Kind.RL_NUM_STEPS].reply)
    capability = PACE if shape in paced else OUTCOME
    return f"; with [`{capability}`](#capabilities) also ".join(filter(None, cells)) or NOTHING


def type_cell(scalar: Scalar) -> str:
    if scalar.items is not None:
        return f"array of {TYPES[scalar.items]}"
    return TYPES[scalar.type] + (" or nil" if scalar.optional else "")


def call_row(kind: Kind) -> list[str]:
    request, reply = CALLS[kind].request, CALLS[kind].reply
    cells = [scalars_cell(request), BODIES[request.body], scalars_cell(reply), BODIES[reply.body]]
    return [str(int(kind)), kind.name, *cells]


def test_tables_of_the_players_calls_are_those_of_the_program() -> None:
    environment, agent = tables(*KINDS_HEAD, "capability")

    for lines, role in ((environment, Role.ENVIRONMENT), (agent, Role.AGENT)):
        expected = [
            [*call_row(kind), f"`{call.capability}`" if call.capability else NOTHING]
            for kind, call in CALLS.items()
            if call.callee is role
        ]
        assert sorted(lines) == sorted(expected)


def test_table_of_the_experiments_requests_is_that_of_the_program() -> None:
    expected = [call_row(kind) for kind, call in CALLS.items() if call.callee is None]

    assert sorted(table(*KINDS_HEAD)) == sorted(expected)


def test_table_of_control_messages_is_that_of_the_program() -> None:
    rows = [[code, kind, scalars] for code, kind, _, scalars in table(*CONTROL_HEAD)]

    assert sorted(rows) == sorted([str(int(k)), k.name, scalars_cell(s)] for k, s in CONTROL.items())
    assert {shape.body for shape in CONTROL.values()} == {Body.NONE}


def test_table_of_what_observers_are_shown_is_that_of_the_program() -> None:
    rows = [[code, kind, scalars, body] for code, kind, _, scalars, body in table(*OBSERVING_HEAD)]

    assert sorted(rows) == sorted(
        [str(int(kind)), kind.name, scalars_cell(shape), BODIES[shape.body]]
        for kind, shape in OBSERVING.items()
    )


def test_tables_of_scalars_of_the_greeting_are_complete() -> None:
    hello, welcome = tables("scalar", "meaning")

    for lines, kind in ((hello, Kind.HELLO), (welcome, Kind.WELCOME)):
        scalars = CONTROL[kind].scalars + CONTROL[kind].more
        assert [row[0].strip("`") for row in lines] == [scalar.name for scalar in scalars]


def test_table_of_errors_is_that_of_the_program() -> None:
    rows = table("code", "in", "from", "meaning")

    assert sorted(row[0].strip("`") for row in rows) == sorted(ErrorCode)


def test_table_of_capabilities_is_that_of_the_program() -> None:
    rows = table("capability", "calls", "meaning")

    documented = {(row[0].strip("`"), name) for row in rows for name in row[1].split(", ")}
    with_calls = {(c.capability, k.name) for k, c in CALLS.items() if c.capability is not None}
    others = (ONE_RUN, OUTCOME, "truncate", "batch", PACE, *BESIDE)
    assert documented == with_calls | {(name, NOTHING) for name in others}


def test_every_event_of_a_notice_is_named() -> None:
    for event in Event:
        assert f"`{event}`" in TEXT


def test_limits_and_defaults_are_those_of_the_program() -> None:
    config = HubConfig()

    limits = [row[1] for row in table("limit", "value")]
    assert limits == [
        f"{MAX_HEADER} bytes",
        f"{config.max_body} bytes",
        "64",
        f"1 to {MAX_NAME} characters, all printable",
        "0 to 2^63 - 1",
        f"{INSTANCE_SIZE} bytes",
    ]
    assert config.max_body == MAX_BODY
    room = [row[1] for row in table("room", "value", "beyond it")]
    assert room == [
        "a quarter of those of the hub",
        f"{config.greeting:g} s",
        f"{MAX_WITHOUT_SESSION}",
        "a quarter of the machine's memory, or as the hub is configured",
        f"{MAX_UNSENT} bytes",
    ]
    defaults = [row[1] for row in table("default", "value")]
    assert defaults == [
        f"`{DEFAULT_HUB}`",
        f"`{DEFAULT_SESSION}`",
        f"{config.heartbeat:g} s",
        f"{config.timeout:g} s",
        f"{config.max_sessions}",
    ]
    assert (config.bind, PROTOCOL_VERSION) == ((DEFAULT_HUB,), 1)


# --- Statements about the program ---------------------------------------------------------------------


def test_episodes_of_the_worked_table_come_out_as_said() -> None:
    agent = ScriptedAgent()
    heads = ("`max_steps`", "terminal", "RL_NUM_STEPS", "RL_NUM_EPISODES", "RL_RETURN", "the agent received")
    with local(agent, ScriptedEnvironment(length=3, reward=1.0)) as glue:
        glue.rl_init()
        for max_steps, *expected in table(*heads):
            del agent.calls[:]
            terminal = str(glue.rl_episode(int(max_steps))).lower()
            received = ", ".join(call.split()[0].removeprefix("agent_") for call in agent.calls)
            counters = [glue.rl_num_steps(), glue.rl_num_episodes(), glue.rl_return()]
            assert [terminal, *map(str, counters), received] == expected


def test_zmtp_of_the_appendix_is_that_of_the_vectors() -> None:
    texts = [[line.partition(";")[0] for line in body.splitlines()] for _, _, body in blocks(TEXT, "zmtp")]
    vectors = json.loads(Path(glue.testing.__file__).with_name("vectors.json").read_text("utf-8"))["zmtp"]
    named = [vectors[name] for name in ("greeting", "ready", "ping", "pong")]
    assert [bytes.fromhex("".join(lines)).hex() for lines in texts] == named


# --- The first page -----------------------------------------------------------------------------------

FIRST: Final = (DOCS / "protocol.md").read_text(encoding="utf-8")


def test_first_page_shows_blocks_and_calls_of_the_reference() -> None:
    assert {*blocks(FIRST, "body", "message")} <= {*blocks(TEXT, "body", "message")}
    for callee in (Role.AGENT, Role.ENVIRONMENT):
        basic = {
            (str(kind.value), kind.name)
            for kind, call in CALLS.items()
            if call.callee is callee and not call.capability
        }
        shown = rows(section(FIRST, f"The calls of an {callee}"), "| code |")
        assert {(code, name) for code, name, *_ in shown} == basic
    shown = rows(section(FIRST, "Greeting"), "| code |")
    assert all(Kind(int(code)).name == name for code, name, *_ in shown)
    for _, name, scalars, _ in shown:
        assert [*filter(None, scalars.split(", "))] == [scalar.name for scalar in CONTROL[Kind[name]].scalars]


def test_steps_to_build_an_agent_name_the_right_codes() -> None:
    named = re.findall(r"\b(\d+) \(([A-Z_]+)\)", section(FIRST, "What to build first"))

    assert len(named) > 8
    assert all(Kind(int(code)).name == name for code, name in named)
    assert Action([5]).body == bytes.fromhex("01000000") + bytes(12) + struct.pack("<i", 5)

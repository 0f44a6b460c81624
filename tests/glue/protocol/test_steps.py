"""The messages of a step, recognised by their bytes: the same as the codec writes, and nothing damaged."""

from __future__ import annotations

import msgpack
import pytest

from glue.protocol import zmtp
from glue.protocol.messages import Kind
from glue.protocol.steps import StepFormat, lead_of, step_formats
from glue.types import Action, Observation

BODY = bytes(Observation([1, 2], [0.5], b"abc").body)
LONG = bytes(Action(range(100)).body)
MESSAGES = [
    pytest.param(step_formats(Kind.ENV_STEP, "s")[0], (), id="an action"),
    pytest.param(
        step_formats(Kind.ENV_STEP, "s")[1], (-0.25, True), id="a reward, a terminal, an observation"
    ),
    pytest.param(step_formats(Kind.AGENT_STEP, "s")[0], (-0.25,), id="a reward and an observation"),
]
NUMBERS = [1, 127, 128, 255, 256, 65_535, 65_536, StepFormat.max_seq]
"""At both ends of each form that msgpack has for a whole number."""


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
@pytest.mark.parametrize("body", [BODY, LONG], ids=["short", "long"])
@pytest.mark.parametrize("seq", NUMBERS)
def test_what_is_written_is_what_the_codec_writes_and_is_recognised(
    form: StepFormat, scalars: tuple[float, ...], body: bytes, seq: int
) -> None:
    data = form.encode(seq, scalars, body)
    assert data == zmtp.encode([msgpack.packb((int(form.kind), "s", seq, *scalars)), body])
    assert form.decode(data) == ((seq, scalars, body), len(data))


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
def test_other_kinds_and_sessions_are_left_to_the_parser(
    form: StepFormat, scalars: tuple[float, ...]
) -> None:
    for seq in NUMBERS:
        for kind in (Kind.ENV_STEP, Kind.AGENT_STEP):
            for session in ("s", "t", "longer"):
                other = zmtp.encode([msgpack.packb((int(kind), session, seq, *scalars)), BODY])
                assert (form.decode(other) is None) == ((kind, session) != (form.kind, "s"))


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
@pytest.mark.parametrize("body", [BODY, LONG], ids=["short", "long"])
@pytest.mark.parametrize("seq", NUMBERS)
def test_what_is_cut_is_left_to_the_parser(
    form: StepFormat, scalars: tuple[float, ...], body: bytes, seq: int
) -> None:
    data = form.encode(seq, scalars, body)
    assert [form.decode(data[:size]) for size in range(len(data))] == [None] * len(data)


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
@pytest.mark.parametrize("seq", NUMBERS)
def test_one_of_several_messages_is_found_where_it_begins(
    form: StepFormat, scalars: tuple[float, ...], seq: int
) -> None:
    other = zmtp.encode([msgpack.packb((int(form.kind), "another", seq, *scalars)), LONG])
    data = form.encode(seq, scalars, BODY)
    several = other + data + data[:-1]
    assert lead_of(several, 0) == step_formats(form.kind, "another")[len(scalars) // 2].lead
    assert lead_of(several, len(other)) == form.lead
    assert form.decode(several, len(other)) == ((seq, scalars, BODY), len(other + data))
    assert form.decode(several, len(other + data)) is None
    assert [lead_of(b"", 0), lead_of(several, len(several))] == [b"", b""]


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
@pytest.mark.parametrize("seq", NUMBERS)
def test_a_changed_byte_changes_a_number_or_is_not_recognised(
    form: StepFormat, scalars: tuple[float, ...], seq: int
) -> None:
    data = form.encode(seq, scalars, BODY)
    head = len(data) - len(BODY)
    for at in range(head + 16):
        changed = bytearray(data)
        changed[at] ^= 0x80
        found = form.decode(bytes(changed))
        # The sequence number and the reward may be any; nothing else before the body's numbers has a choice.
        if found is not None:
            assert found == (read(bytes(changed)), len(data))
            assert found[0][2] == BODY
            assert found[0][:2] != (seq, scalars)


def read(data: bytes) -> tuple[int, tuple[float, ...], bytes]:
    """Return what a message carries, by way of the parsers."""
    decoder = zmtp.Decoder(zmtp.ROUTER, 2**20)
    decoder.receive_data(zmtp.GREETING + b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER" + data)
    while not isinstance(event := decoder.next_event(), list):
        assert event is not None
    _, _, seq, *scalars = msgpack.unpackb(event[0])
    return seq, tuple(scalars), event[1]

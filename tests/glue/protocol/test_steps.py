"""The messages of a step, recognised by their bytes: the same as the codec writes, and nothing damaged."""

from __future__ import annotations

import msgpack
import pytest

from glue.protocol import zmtp
from glue.protocol.messages import Kind
from glue.protocol.steps import StepFormat, step_formats
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


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
@pytest.mark.parametrize("body", [BODY, LONG], ids=["short", "long"])
def test_what_is_written_is_recognised_with_its_number_alone(
    form: StepFormat, scalars: tuple[float, ...], body: bytes
) -> None:
    data = form.encode(7, scalars, body)
    header: bytes = msgpack.packb((int(form.kind), "s", 7, *scalars))
    assert form.header(7, scalars) == header
    assert data == zmtp.encode([header, body])
    assert form.decode(data, 7) == (scalars, body)
    assert form.decode(data, 8) is None


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
def test_what_is_cut_or_longer_is_left_to_the_parser(form: StepFormat, scalars: tuple[float, ...]) -> None:
    data = form.encode(7, scalars, BODY)
    assert [form.decode(data[:size], 7) for size in range(len(data))] == [None] * len(data)
    assert form.decode(data + b"\0", 7) is None


@pytest.mark.parametrize(("form", "scalars"), MESSAGES)
def test_a_changed_byte_is_never_a_body_of_another_size(form: StepFormat, scalars: tuple[float, ...]) -> None:
    data = form.encode(7, scalars, BODY)
    head = len(data) - len(BODY)
    for at in range(head + 16):
        changed = bytearray(data)
        changed[at] ^= 0x80
        found = form.decode(bytes(changed), 7)
        # A reward may be any number; nothing else before the numbers of the body has a choice.
        assert found is None or (found[1] == BODY and found[0] != scalars)

"""Random conversations of original programs, with any fault."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from random import Random

from glue.legacy import bodies
from glue.legacy.bodies import MAX_COUNT, MAX_STRING
from glue.legacy.codec import Control, Layout, Vocabulary
from glue.types import Action
from glue.wire.messages import Body

TYPES = [
    Action([1]).body,
    Action([2]).body,
    Action().body,
    Action([1, 2], [0.5], b"abc").body,
    Action([1, 2], [-0.5], b"abc").body,
    Action((), [float("nan")], b"\0" * 5).body,
    Action([3], (), b"abcd").body,
]
REWARDS = (0.0, -0.0, 1.0, float("inf"))


def payload_of(random: Random, layout: Layout) -> bytes:
    """Return a payload, now and then one that ends early, is too long, or has counts that are too large."""
    forms = {"d": REWARDS, "i": (0, 1, 2, -1), "I": (0, 2**32 - 1)}
    head = b"".join(struct.pack(">" + form, random.choice(forms[form])) for form in layout.head.format[3:])
    if layout.body is Body.TEXT:
        body = random.choice([b"", b"text", b"cut\0off"])
        count = random.choice([len(body)] * 8 + [len(body) + 1, MAX_STRING, MAX_STRING + 1])
        payload = head + struct.pack(">I", count) + body
    else:
        types = {Body.NONE: 0, Body.OBSERVATION_ACTION: 2}.get(layout.body, 1)
        payload = head + b"".join(bodies._OBSERVATION.write(random.choice(TYPES)) for _ in range(types))
    match random.randrange(10):
        case 0:
            return payload[: random.randrange(len(payload) + 1)]
        case 1:
            return payload + bytes(random.randrange(1, 20))
        case 2 if len(payload) > len(head) + 12:
            return head + struct.pack(">3I", *random.choices([0, 1, MAX_COUNT, MAX_COUNT + 1], k=3)) + payload
    return payload


def conversation(random: Random, vocabulary: Vocabulary) -> Iterator[bytes]:
    """Yield the frames of a program, most of them of one kind, and none of it after a wrong one."""
    kinds = list(vocabulary)
    typed = [kind for kind in kinds if vocabulary[kind].body not in (Body.NONE, Body.TEXT)]
    usual = random.choice(random.choice([kinds, typed or kinds, typed or kinds]))
    for _ in range(random.randrange(1, 7)):
        kind = usual if random.random() < 0.8 else random.choice(kinds)
        payload = payload_of(random, vocabulary[kind])
        announced = len(payload) if random.random() < 0.95 else random.choice([0, 2**31, len(payload) + 3])
        kind = kind if random.random() < 0.95 else random.choice([0, -1, 9, 99, Control.CONNECT_AGENT])
        yield struct.pack(">iI", kind, announced) + payload

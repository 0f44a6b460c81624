"""Values that peers are known to get wrong, headers in every format of msgpack, and malformed messages."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from glue.types import Action, Observation

_SOME: Final = [0, 1, -1, 127, 128, -128, 255, 256, 65536, 2**31 - 1, -(2**31)]
INTS: Final = [*_SOME, -sum(_SOME)]
"""Extremes of 32 bits. Their sum is 0, which even a client that encodes doubles wrongly can show."""

DOUBLES: Final = [
    *(0.0, -0.0, 1.0, -0.1, 1 / 3),
    *(math.inf, -math.inf, math.nan),
    *(5e-324, 2.0**-1022, 1.7976931348623157e308),
]

REWARDS: Final = [0.0, -0.0, 1.0, -0.1, 1 / 3, math.inf, -math.inf, math.nan, 5e-324, 1e300, 2.0**53]

MANY: Final = [
    Observation(np.zeros(70_000, np.int32)),
    Observation([], np.zeros(70_000)),
    Observation([], [], bytes(70_000)),
]
"""Runs whose counts take more than 16 bits."""

CHARS: Final = bytes(range(256))

EMPTY: Final = [
    Observation(),
    Observation([1]),
    Observation([], [1.0]),
    Observation([], [], b"a"),
    Observation([1], [1.0]),
    Observation([], [1.0], b"a"),
    Observation([1], [], b"a"),
    Observation(),
]

MASKED: Final = [
    *(
        Observation([3, -5], [0.5], b"ab", mask=mask)
        for mask in ([True], [False, True, True], [False] * 8 + [True], [True, False] * 150)
    ),
    Observation(mask=[False] * 6 + [True]),
]
"""Observations with masks of 1 to 38 bytes."""

WITH_EXTRAS: Final = [
    Observation([3], [0.5], b"ab", extras={"coins": 7}),
    Observation(
        mask=[True, False, True],
        extras={
            "z.least": -(2**63),
            "most": 2**63 - 1,
            "half": 0.5,
            "text": "größer, 走る",
            "bytes": bytes(range(256)),
            "ints": [0, -1, 127, -128, 255, -32768, 65535, 2**31, -(2**31), 2**53 + 1],
            "floats": [0.5, -1.25],
            "nothing": [],
        },
    ),
    Observation([1], extras={f"n{number}": number for number in range(64)}),
    Observation([], [], b"a", extras={"many": [0.25] * 7000}),
]
"""Observations with extras of every type; floats are not whole, as some languages have one type of number."""

ASKING: Final = [
    Action([1, 0, -2], [0.5, -2.25], b"\0\xffa&"),
    Action([], [0.5], b"&"),
    Action([0] * 8 + [7], [], b"&"),
    Action([1] * 300, [0.125], b"&"),
]
"""Actions that the mirror's environment answers with a mask, if there are ints, and extras."""

TEXTS: Final = [
    text.encode()
    for text in (
        "",
        "plain",
        "größer als π",
        "走る 🏃",
        "a\0b\0",
        "\0",
        "two\nlines\r\n",
        "x" * 255,
        "ß" * 40_000,
    )
]

NOT_UTF_8: Final = [b"\xff\xfe", b"a\xc3", b"\xed\xa0\x80", b"\xc0\x80"]


_NUMBERS: Final = {
    "uint 8": (0xCC, ">B"),
    "uint 16": (0xCD, ">H"),
    "uint 32": (0xCE, ">I"),
    "uint 64": (0xCF, ">Q"),
    "int 8": (0xD0, ">b"),
    "int 16": (0xD1, ">h"),
    "int 32": (0xD2, ">i"),
    "int 64": (0xD3, ">q"),
}


def number(value: int, form: str) -> bytes:
    """Return a whole number in a format such as `uint 16`."""
    code, layout = _NUMBERS[form]
    return bytes([code]) + struct.pack(layout, value)


def fitting(value: int) -> Iterator[bytes]:
    """Yield a whole number in every format that holds it."""
    for form in _NUMBERS:
        try:
            yield number(value, form)
        except struct.error:
            continue


def float_64(value: float) -> bytes:
    """Return a float."""
    return b"\xcb" + struct.pack(">d", value)


def text(value: str, bits: int) -> bytes:
    """Return a text in `str 8`, `str 16` or `str 32`."""
    data = value.encode()
    code = {8: 0xD9, 16: 0xDA, 32: 0xDB}[bits]
    return bytes([code]) + len(data).to_bytes(bits // 8, "big") + data


def header(
    kind: int,
    session: str,
    seq: int,
    scalars: Sequence[bytes],
    *,
    array: int = 4,
    kind_form: str = "uint 8",
    session_bits: int = 8,
    seq_form: str = "uint 64",
) -> bytes:
    """Return a header whose scalars are already msgpack; `array` is the bits of the array length."""
    items = [number(kind, kind_form), text(session, session_bits), number(seq, seq_form), *scalars]
    count = len(items)
    head = {4: bytes([0x90 | count]), 16: b"\xdc" + count.to_bytes(2, "big")}
    return head.get(array, b"\xdd" + count.to_bytes(4, "big")) + b"".join(items)


VARIANTS: Final[list[dict[str, Any]]] = [
    {"array": 16},
    {"array": 32},
    *({"kind_form": form} for form in _NUMBERS),
    {"session_bits": 16},
    {"session_bits": 32},
    *({"seq_form": form} for form in _NUMBERS if not form.endswith(" 8")),
]
"""Options of `header` for each item in each of its formats, provided that `seq` has at most 15 bits."""


def rewards() -> Iterator[tuple[float, bytes]]:
    """Yield rewards, each in a format that holds it."""
    yield 1.0, float_64(1.0)
    for value in (0.5, -0.0, float("inf")):
        yield value, b"\xca" + struct.pack(">f", value)
    yield from ((1.0, b"\x01"), (127.0, b"\x7f"), (-1.0, b"\xff"), (-32.0, b"\xe0"))
    for whole in (200, -100, 40_000, -30_000, 3_000_000_000, -2_000_000_000, 2**53, -(2**53)):
        for data in fitting(whole):
            yield float(whole), data


def truths() -> Iterator[tuple[bool, bytes]]:
    """Yield truth values, each as an integer; 2 is left out, as it may mean that an episode was cut off."""
    yield from ((False, b"\x00"), (True, b"\x01"), (True, b"\x03"), (True, b"\xff"))
    for whole in (0, 1, 100, -100):
        for data in fitting(whole):
            yield whole != 0, data


_Frames = tuple[bytes, ...]


def _header(change: Callable[[bytes], bytes]) -> Callable[[_Frames], _Frames]:
    return lambda frames: (change(frames[0]), *frames[1:])


def _body(change: Callable[[bytes], bytes]) -> Callable[[_Frames], _Frames]:
    return lambda frames: (frames[0], change(frames[1] if len(frames) > 1 else b""))


SPOILED: Final[Mapping[str, Callable[[_Frames], _Frames]]] = {
    "an empty header": _header(lambda header: b""),
    "a header that is no msgpack": _header(lambda header: b"\xc1" + header[1:]),
    "a header that is cut short": _header(lambda header: header[:-1]),
    "a header that promises 4294967295 items": _header(lambda header: b"\xdd\xff\xff\xff\xff" + header[1:]),
    "a header with a text of 4294967295 bytes": _header(lambda header: header[:2] + b"\xdb\xff\xff\xff\xff"),
    "three frames": lambda frames: (*frames, b"", b"")[:3],
}
"""Malformed messages, each as a change of a valid message's frames."""

SPOILED_BODIES: Final[Mapping[str, Callable[[_Frames], _Frames]]] = {
    "a body that is shorter than its counts say": _body(lambda body: body[:-1]),
    "a body with a byte behind it": _body(lambda body: body + b"\0"),
    "a body whose fourth word is not zero": _body(lambda body: body[:12] + b"\1\0\0\0" + body[16:]),
    "a body that promises 4294967295 chars": _body(lambda body: body[:8] + b"\xff\xff\xff\xff" + body[12:]),
    "a body of 8 bytes": _body(lambda body: body[:8]),
    "no body where there has to be one": lambda frames: frames[:1],
}
"""Malformed bodies, each as a change of the frames of a message with an abstract type."""

"""Values that clients are known to get wrong."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from glue.types import Observation

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

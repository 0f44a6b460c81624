"""Record layouts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from glue.compiled.records import Flag, Int, Real, layout, new


class Inner:
    a: Int
    b: Flag


class Outer:
    first: Annotated[Inner, Inner]
    many: Annotated[Sequence[Inner], Inner, (2, 3)]
    number: Real


def test_a_record_is_laid_out_as_its_class_says() -> None:
    outer = new(Outer)
    assert outer.shape == (1,)
    assert outer.dtype.names == ("first", "many", "number")
    assert outer["many"].shape == (1, 2, 3)
    assert outer["first"].dtype.names == ("a", "b")
    assert outer["first"]["b"].dtype == np.bool_
    assert layout(Outer) is layout(Outer)

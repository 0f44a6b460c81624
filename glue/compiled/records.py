"""Records that compiled code works on: declared once, for people, for mypy and for numba.

A record is a class of annotated fields: their names and types are what mypy checks, and `layout` is the
same as a NumPy dtype. Compiled functions take records and change them in place.
"""

from __future__ import annotations

import typing
from functools import cache
from typing import Annotated

import numpy as np
import numpy.typing as npt

Int = Annotated[int, np.int64]
Real = Annotated[float, np.float64]
Flag = Annotated[bool, np.bool_]
Word = Annotated[np.uint64, np.uint64]

Array = npt.NDArray[np.void]
"""Contiguous records, as compiled functions take them from Python."""


@cache
def layout(record: type) -> np.dtype[np.void]:
    """Return the memory layout of `record`: its annotated fields in order, aligned.

    A field is annotated with one of the types above, or with a type and a shape:
    `Annotated[Sequence[Sprite], Sprite, 4]`. The result is the same object for the same record, because
    numba recognises a dtype by identity much faster than by comparing its fields.
    """
    fields = []
    for name, hint in typing.get_type_hints(record, include_extras=True).items():
        _, kind, *shape = typing.get_args(hint)
        base = np.dtype(kind) if issubclass(kind, np.generic) else layout(kind)
        fields.append((name, base, *shape))
    return np.dtype(fields, align=True)


def new(record: type) -> Array:
    """Return one record of all zeros, as an array of shape (1,)."""
    return np.zeros(1, layout(record))

"""The one place that knows numba: how functions are compiled and records laid out.

`jit` is for the rules, `entry` for what Python calls: its machine code is kept on disk, beside the
source or, where that cannot be written, in the user's cache folder. A record is declared once, as a
class of annotated fields: names and types for people and for mypy, the memory layout for numba.
Functions take records and change them in place.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
import time
import typing
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numba
import numpy as np
import numpy.typing as npt
from numba.core import event
from numba.core.caching import FunctionCache

__all__ = ["Array", "Flag", "Int", "Real", "Word", "entry", "jit", "layout", "new", "say_when_compiling"]

Function = TypeVar("Function", bound=Callable[..., Any])

Int = Annotated[int, np.int64]
Real = Annotated[float, np.float64]
Flag = Annotated[bool, np.bool_]
Word = Annotated[np.uint64, np.uint64]

Array = npt.NDArray[np.void]
"""Records side by side, as kernels take them from Python."""


def _digest() -> str:
    """Return a digest of every source file beside this one."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


_SOURCES: Final = _digest()


class _Cache(FunctionCache):
    """Numba's cache on disk, out of date as soon as any module of the package changes.

    By itself it looks at the file of the entry alone, and would go on using what was compiled from
    an older version of a function that the entry calls.
    """

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        return (*super()._index_key(sig, codegen), _SOURCES)  # type: ignore[no-untyped-call]


def jit(function: Function) -> Function:
    """Return `function` compiled when it is first needed."""
    compiled: Function = numba.njit(function)
    return compiled


def entry(function: Function) -> Function:
    """Return `function` compiled when first called, or read from disk if it was compiled before."""
    compiled = jit(function)
    with contextlib.suppress(RuntimeError):  # no folder to write to: compile in every process
        compiled._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
    return compiled


@contextlib.contextmanager
def say_when_compiling() -> Iterator[None]:
    """Tell the person at the terminal, on stderr, if an entry called in this block must be compiled."""
    listener = _Announcement()
    with event.install_listener("numba:compile", listener):
        yield
    listener.finish()


class _Announcement(event.Listener):
    """One line that begins with the first compilation and ends when all are done."""

    def __init__(self) -> None:
        self._began: float | None = None

    def on_start(self, event: object) -> None:
        if self._began is None:
            self._began = time.perf_counter()
            print("compiling the agent, this once ...", end=" ", file=sys.stderr, flush=True)

    def on_end(self, event: object) -> None:
        pass

    def finish(self) -> None:
        if self._began is not None:
            print(f"done in {time.perf_counter() - self._began:.0f} s", file=sys.stderr, flush=True)


@cache
def layout(record: type) -> np.dtype[np.void]:
    """Return the memory layout of `record`: its annotated fields in order, aligned.

    A field is annotated with one of the types above, or with a type and a shape:
    `Annotated[Sequence[Sprite], Sprite, 4]`. It is always the same object, by which numba knows the
    type of an array much faster than by comparing layouts.
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

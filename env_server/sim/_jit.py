"""The one place that knows numba: `jit` for a rule of the game, `entry` for what Python calls.

Both return the function compiled to machine code without the interpreter's lock, so that games can
run on several cores. No fast-math: every float operation is rounded as written. An entry's machine
code is kept on disk, beside the source or, where that cannot be written, in the user's cache folder.
With NUMBA_DISABLE_JIT=1 both return the function as it is.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config, event
from numba.core.caching import FunctionCache

__all__ = ["entry", "jit", "say_when_compiling"]

Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """Return `function` compiled when an entry first needs it."""
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    return cast(Function, compiled)


def entry(function: Function) -> Function:
    """Return `function` compiled on its first call, or read from the disk if it was compiled before."""
    compiled = jit(function)
    if not config.DISABLE_JIT:  # type: ignore[attr-defined]
        with suppress(RuntimeError):  # no folder can be written: compile in every process
            compiled._cache = _Cache(function)  # type: ignore[attr-defined, no-untyped-call]
    return compiled


@contextmanager
def say_when_compiling() -> Iterator[None]:
    """Tell the person at the terminal, on stderr, if an entry called in this block must be compiled."""
    listener = _Announcement()
    with event.install_listener("numba:compile", listener):
        yield
    listener.finish()


class _Announcement(event.Listener):
    """One line when the first compilation begins, and its end when all are done."""

    def __init__(self) -> None:
        self._began: float | None = None

    def on_start(self, event: object) -> None:
        if self._began is None:
            self._began = time.perf_counter()
            print("mario: compiling the simulator, this once ...", end=" ", file=sys.stderr, flush=True)

    def on_end(self, event: object) -> None:
        pass

    def finish(self) -> None:
        if self._began is not None:
            print(f"done in {time.perf_counter() - self._began:.0f} s", file=sys.stderr, flush=True)


def _digest_of_sources() -> str:
    """Return a digest of every file that an entry is compiled from."""
    here = Path(__file__).parent
    beside = ("game.py", "observation.py", "reward.py")
    sources = [*sorted(here.glob("*.py")), *(here.parent / name for name in beside)]
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


_SOURCES = _digest_of_sources()


class _Cache(FunctionCache):
    """numba's cache on disk, which by itself looks at the entry's own file only.

    Machine code of yesterday's rules would be wrong without a word, so all the rules' files count.
    """

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        key = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return (*key, _SOURCES, bool(config.BOUNDSCHECK))  # type: ignore[attr-defined]

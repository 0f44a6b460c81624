"""The one place that knows numba: `jit` for a function of compiled code, `entry` for what Python calls.

Both return the function compiled to machine code that runs without the interpreter's lock, so that
several threads can use several cores. No fast-math: every float operation is rounded as written. An
entry's machine code is cached on disk, beside the source or, where that is not writable, in the user's
cache folder; what was cached beside the source is read even where nothing can be written, as in a container
whose file system is read-only. With NUMBA_DISABLE_JIT=1 both return the function unchanged.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache

from glue.console import say

__all__ = ["announce_compilation", "entry", "jit"]

Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """Return `function` compiled when an entry first needs it."""
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    return cast(Function, compiled)


def entry(function: Function) -> Function:
    """Return `function` compiled on its first call, or read from the cache if it was compiled before."""
    compiled = jit(function)
    if not config.DISABLE_JIT:  # type: ignore[attr-defined]
        with suppress(RuntimeError):  # no folder is writable: compile in every process
            compiled._cache = _Cache(function)  # type: ignore[attr-defined]
    return compiled


@contextmanager
def announce_compilation(what: str) -> Iterator[None]:
    """Print to stderr that WHAT is compiled, and how long it took, if an entry called in this block is."""
    listener = _Announcement(what)
    with event.install_listener("numba:compile", listener):
        yield
    listener.finish()


class _Announcement(event.Listener):
    """A line before the first compilation and one after the last: other programs write in between."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._began: float | None = None

    def on_start(self, event: object) -> None:
        if self._began is None:
            self._began = time.perf_counter()
            say(f"compiling {self._what}, this once ...")

    def on_end(self, event: object) -> None:
        pass

    def finish(self) -> None:
        if self._began is not None:
            say(f"compiled {self._what} in {time.perf_counter() - self._began:.0f} s")


_given, _in_tree, *_others = cast("list[Any]", CompileResultCacheImpl._locator_classes)
"""Where numba looks: in NUMBA_CACHE_DIR, beside the source, in the user's cache folder, and so on."""


class _FilledLocator(_in_tree):  # type: ignore[misc, valid-type]
    """The cache beside the source, if it has been filled; it need not be writable."""

    def ensure_cache_path(self) -> None:
        folder = Path(self.get_cache_path())
        if not any(folder.glob("*.nbi")):
            raise OSError(f"nothing is cached in {folder}")


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [_given, _FilledLocator, _in_tree, *_others]  # noqa: RUF012


class _Cache(FunctionCache):
    """numba's cache on disk, invalidated by a change of any module of the entry's package.

    numba alone checks only the file that defines the entry, and would go on using machine code of an
    older version of a function that the entry calls.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._sources = Path(function.__code__.co_filename)

    def save_overload(self, sig: object, data: object) -> None:
        """Save machine code, unless the cache is read-only."""
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        key = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        digests = (_digest(_package(self._sources)), _digest(Path(__file__).parent))
        return (*key, *digests, bool(config.BOUNDSCHECK))  # type: ignore[attr-defined]


def _package(file: Path) -> Path:
    """Return the folder of the outermost package that `file` belongs to, or `file` if it is in none."""
    outermost = file
    for folder in file.parents:
        if not (folder / "__init__.py").exists():
            break
        outermost = folder
    return outermost


@cache
def _digest(sources: Path) -> bytes:
    """Return a digest of a file, or of every module below a folder."""
    files = sorted(sources.rglob("*.py")) if sources.is_dir() else [sources]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()

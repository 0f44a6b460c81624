"""Compilation by numba: `jit` for functions of compiled code, `entry` for those that Python calls.

Both return the function compiled to machine code that runs without the interpreter's lock, so that
several threads can use several cores. No fast-math: every float operation is rounded as written. An
entry's machine code is cached on disk, next to the source or, where that is not writable, in the user's
cache folder; code cached next to the source is read even where nothing can be written, as in a container
whose file system is read-only. With NUMBA_DISABLE_JIT=1 both return the function unchanged.
"""

from __future__ import annotations

import fcntl
import hashlib
import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Final, TypeVar, cast

from numba.core import config, event, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

from glue.console import say, say_why_slow
from glue.system import clock

_POLL_SECONDS: Final = 0.1
_SPIN_SECONDS: Final = 0.5

Function = TypeVar("Function", bound=Callable[..., Any])


_OPTIONS: Final = {
    "nopython": True,
    "nogil": True,
    "error_model": "numpy",
    "boundscheck": None,
    "no_cfunc_wrapper": True,
}


def jit(function: Function) -> Function:
    """Return `function` compiled into each entry that calls it, and as an entry if Python calls it."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    options = {**_OPTIONS, "no_cpython_wrapper": True}
    return cast(Function, _Part(function, targetoptions=options, pipeline_class=_PartCompiler))


def entry(function: Function) -> Function:
    """Return `function` compiled on its first call, or read from the cache if it was compiled before."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    compiled: Any = CPUDispatcher(function, targetoptions=dict(_OPTIONS))
    with suppress(RuntimeError):  # no folder is writable: compile in every process
        compiled._cache = _Cache(function)
    return cast(Function, compiled)


class _Part(CPUDispatcher):
    """A function without the wrapper through which Python calls compiled code: an entry serves such calls.

    numba itself would compile it again for each constant and each width of integer that it is called with.
    """

    _own_entry: Any = None

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the template of a call: integers except uint64, constants too, are passed as int64."""
        widened = {name: _widened(kind) for name, kind in kws.items()}
        return super().get_call_template([*map(_widened, args)], widened)

    def __call__(self, *arguments: Any) -> Any:
        if self._own_entry is None:
            self._own_entry = entry(self.py_func)
        return self._own_entry(*arguments)


def _widened(kind: Any) -> Any:
    """Return the type in which compiled code passes a value of type `kind`."""
    kind = types.unliteral(kind)  # type: ignore[no-untyped-call]
    return types.int64 if isinstance(kind, types.Integer) and kind != types.uint64 else kind


class _PartLibrary(JITCodeLibrary):
    """Intermediate code: a part is optimised and made machine code only within the entries that call it.

    Machine code and wrappers of each part, with all that it calls, would take nearly half of the time, and
    optimising each part separately another third. Entries are no slower without them.
    """

    @property
    def codegen(self) -> Any:
        """Receiver of `set_env`, which needs machine code."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Ignore the environment: code that never calls Python has no use for it."""

    def _optimize_final_module(self) -> None:
        """Leave optimisation to the entries."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


class _PartCompiler(Compiler):
    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        if library is None:
            library = _PartLibrary(target.codegen(), "part")  # type: ignore[no-untyped-call]
            library.enable_object_caching()
        super().__init__(typing, target, library, *others)  # type: ignore[no-untyped-call]


@contextmanager
def announce_compilation(what: str) -> Iterator[None]:
    """Print to stderr that `what` is being compiled, in a terminal the time passed, and how long it took.

    Nothing is printed if no entry called in this block has to be compiled. If another process is compiling
    the same entry, wait for its machine code, and say so.
    """
    listener = _Announcement(what)
    try:
        with event.install_listener("numba:compile", listener), _leaving_at_once():
            try:
                yield
            finally:
                _Cache.release()
    finally:
        listener.over.set()
    listener.finish()


@contextmanager
def _leaving_at_once() -> Iterator[None]:
    """Let a command end at once for a signal, as LLVM may run for many seconds between two bytecodes.

    The handler of SIGINT has the function for that as its attribute `leave`; other handlers, such as that of
    a notebook, are left unchanged.
    """
    leave = getattr(signal.getsignal(signal.SIGINT), "leave", None)
    if leave is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_leave_for_signals, args=(reader, leave), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writer)


def _leave_for_signals(reader: int, leave: Callable[[int], object]) -> None:
    while number := os.read(reader, 1):
        if number[0] in (signal.SIGINT, signal.SIGTERM):
            leave(number[0])
    os.close(reader)


class _Announcement(event.Listener):
    """A line before the first compilation and one after the last: other programs write in between.

    Attributes:
        over: set when nothing more is compiled.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._began: float | None = None
        self.over = threading.Event()

    def on_start(self, event: object) -> None:
        if self._began is None:
            self._began = clock.monotonic()
            say_why_slow(f"compiling {self._what}, this once ...")
            if sys.stderr.isatty():
                threading.Thread(target=self._spin, name="spinner", daemon=True).start()

    def _spin(self) -> None:
        """Show the time passed; the cursor stays at the beginning, for lines of other programs."""
        for mark in itertools.cycle("|/-\\"):
            if self.over.wait(_SPIN_SECONDS) or self._began is None:
                return
            passed = f"{clock.monotonic() - self._began:.0f} s"
            print(f"  {mark} {passed}\x1b[K", end="\r", file=sys.stderr, flush=True)

    def on_end(self, event: object) -> None:
        pass

    def finish(self) -> None:
        if self._began is not None:
            say(f"compiled {self._what} in {clock.monotonic() - self._began:.0f} s")


_given, _in_tree, *_others = cast("list[Any]", CompileResultCacheImpl._locator_classes)
"""The locators of numba's cache: NUMBA_CACHE_DIR, next to the source, the user's cache folder, and so on."""


class _FilledLocator(_in_tree):  # type: ignore[misc, valid-type]
    """The cache next to the source, if it has been filled; it need not be writable."""

    def ensure_cache_path(self) -> None:
        folder = Path(self.get_cache_path())
        if not any(folder.glob("*.nbi")):
            raise OSError(f"nothing is cached in {folder}")


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [_given, _FilledLocator, _in_tree, *_others]  # noqa: RUF012


class _Cache(FunctionCache):
    """numba's cache on disk, invalidated by a change to any module of the packages that it is made from.

    numba itself checks only the file that defines the entry, and would keep using machine code of an older
    version of a function that the entry calls.
    """

    _impl_class = _CacheImpl
    _locks: ClassVar[dict[Path, int]] = {}
    """File descriptors of the locks that this process holds, by name: it is compiling those entries."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._function = function

    def load_overload(self, sig: object, target_context: object) -> Any:
        """Return cached machine code; None if this process has to compile it while others wait."""
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None and self._lock():
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        return found

    def save_overload(self, sig: object, data: object) -> None:
        """Save machine code, unless the cache is read-only."""
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        self.release(self._lock_name)

    @property
    def _lock_name(self) -> Path:
        return Path(self.cache_path) / f"{self._py_func.__qualname__}.lock"

    def _lock(self) -> bool:
        """Take the lock of this entry; return whether another process held it until now."""
        name = self._lock_name
        self.release(name)
        try:
            file = os.open(name, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        except OSError:  # read-only: compile as if there were no other process
            return False
        self._locks[name] = file
        waited = False
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if not waited:
                    say_why_slow(
                        f"another process is compiling {self._py_func.__qualname__}: waiting for it ..."
                    )
                waited = True
                clock.sleep(_POLL_SECONDS)
            except OSError:  # a file system without locks
                return waited
            else:
                return waited

    @classmethod
    def release(cls, *names: Path) -> None:
        """Release the locks of these names, or all if there are none, even of failed compilations."""
        for name in names or tuple(cls._locks):
            if name in cls._locks:
                os.close(cls._locks.pop(name))

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        key = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        packages = sorted({_package(Path(part.__code__.co_filename)) for part in _parts(self._function)})
        digests = [_digest(sources) for sources in (*packages, Path(__file__).parent)]
        return (*key, *digests, bool(config.BOUNDSCHECK))  # type: ignore[attr-defined]


def _parts(function: Callable[..., Any]) -> set[Callable[..., Any]]:
    """Return `function` and the functions compiled into it, which are found through its globals."""
    found: set[Callable[..., Any]] = set()
    left = [function]
    while left:
        part = left.pop()
        if part not in found:
            found.add(part)
            named = (part.__globals__.get(name) for name in part.__code__.co_names)
            left += [called.py_func for called in named if isinstance(called, CPUDispatcher)]
    return found


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

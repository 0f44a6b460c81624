"""The beginning of every command: Ctrl-C and SIGTERM are handled before anything slow is imported.

This module, and those that call it, import only modules that Python itself has loaded, or loads in a
millisecond: until `handle_signals` has been called, Ctrl-C prints a traceback. Hence no `typing`, except for
type checkers, for which TYPE_CHECKING is true.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

import glue.system.forks  # noqa: F401  # for the handlers that are set here
from glue.names import others

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import Final, NoReturn

EXIT_INTERRUPTED: Final = 128 + signal.SIGINT
EXIT_TERMINATED: Final = 128 + signal.SIGTERM

_STDERR: Final = 2
_IMPORTLIB: Final = "<frozen importlib"

_received: Final[list[int]] = []
"""Signals that have been received."""


class Terminated(KeyboardInterrupt):
    """SIGTERM was received: clean up as for Ctrl-C."""


def start(module: str, name: str) -> NoReturn:
    """Run the command of this name in a module, which is imported, and exit."""
    handle_signals()
    open_streams()
    # NumPy's threads would spin for 2**26 cycles before they sleep, from its import on, in children too.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "16")
    if found := others(sys.path):
        message = (
            f"note: {', '.join(found.values())} has the name of a package of glue-rl; commands use ours, "
        )
        message += "your programs import glue_rl first\n"
        os.write(_STDERR, message.encode(errors="replace"))
    try:
        import_module("glue.cli.shared").run(getattr(import_module(module), name))
        raise AssertionError(f"{name} returned")
    except KeyboardInterrupt as interrupt:
        _leave(signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)
    except Exception:
        # An interruption within a lock of `threading` becomes another exception.
        if _received:
            _leave(_received[-1])
        raise
    finally:
        # While Python exits, nothing is left that could catch an exception.
        _handle_with(_leave)


def open_streams() -> None:
    """Open the null device in place of each standard stream that is closed, as in `glue-hub >&-`.

    Otherwise the next file that is opened would get its number, and what is printed.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115
    # A name that the terminal's encoding lacks is shown with escapes.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def handle_signals() -> None:
    """Let SIGINT (Ctrl-C) raise KeyboardInterrupt, and SIGTERM `Terminated`.

    During an import they end the program at once: an exception inside the import of NumPy or libzmq becomes
    an ImportError or is lost, and output written so far survives any kill. A signal that is ignored,
    as under nohup, remains ignored.
    """
    _interrupt.leave = _leave  # type: ignore[attr-defined]  # for glue.compiled.jit, which may block for long
    _handle_with(_interrupt)


def is_stuck() -> bool:
    """Return whether printing would block, because standard error is a full pipe that is not being read."""
    from glue.system import network

    try:
        return not network.select([], [_STDERR], [], 0)[1]
    except (OSError, ValueError):  # closed
        return True


def _handle_with(handler: Callable[[int, FrameType | None], NoReturn]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    _received.append(number)
    if _is_importing(frame):
        _leave(number)
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTLIB):
            return True
        frame = frame.f_back
    return False


def _leave(number: int, frame: FrameType | None = None) -> NoReturn:
    if not is_stuck():
        os.write(_STDERR, b"interrupted\n")
    os._exit(EXIT_TERMINATED if number == signal.SIGTERM else EXIT_INTERRUPTED)

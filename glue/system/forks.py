"""Signals in forked children: they end a child of one of our processes as they end any program.

A child inherits the signal handlers of its parent, but not the threads and the unfinished work that they rely
on: a `multiprocessing.Pool` of a player's own could not be ended. Import this module where a handler is set;
like `glue.cli.entry` it imports nothing slow.
"""

from __future__ import annotations

import os
import signal

from glue.names import NAMES


def _forget_handlers() -> None:
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        variables = getattr(signal.getsignal(number), "__globals__", {})
        # Not `__module__`, which is `__main__` in our workers and players.
        if (variables.get("__package__") or "").partition(".")[0] in NAMES:
            usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, usual)
            signal.set_wakeup_fd(-1)  # the parent's


os.register_at_fork(after_in_child=_forget_handlers)

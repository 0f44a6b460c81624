"""What the command lines share: how a command runs and exits, and the options that several have.

Click is a skin over functions: a command reads its options, calls one function, and an error becomes an
exit code here and nowhere else. What is slow to import is imported by that function, so that `--help` and
completion answer at once.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

import click

from glue.console import say
from glue.core.config import HUB_KEY_VARIABLE, KEY_VARIABLE
from glue.entry import EXIT_INTERRUPTED, EXIT_TERMINATED, Terminated, handle_signals, is_stuck
from glue.errors import ConfigError, GlueError

__all__ = [
    "HUB_KEY_SETTINGS",
    "KEY_SETTINGS",
    "WAIT_VARIABLE",
    "Terminated",
    "keys_option",
    "legacy_port_option",
    "run",
]

WAIT_VARIABLE: Final = "GLUE_WAIT"
"""The environment variable of the option `--wait`, in every command that has it."""

keys_option: Final = click.option(
    "--keys",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Admit only the owners of the keys in DIR, in the roles of DIR/allow.toml, and encrypt everything. "
    "DIR is read again on SIGHUP.",
)
"""The option of all commands that start a hub; see `glue.keys.allowed`."""

KEY_SETTINGS: Final[Mapping[str, Any]] = {
    "metavar": "FILE",
    "envvar": KEY_VARIABLE,
    "show_envvar": True,
    "help": "Secret key by which the hub recognises you; glue-keys new makes it.",
}
HUB_KEY_SETTINGS: Final[Mapping[str, Any]] = {
    "metavar": "KEY",
    "envvar": HUB_KEY_VARIABLE,
    "show_envvar": True,
    "help": "Public key of the hub, a file or the key itself; needed with --key.",
}
"""The options `--key` and `--hub-key` of all commands that join a hub."""

legacy_port_option: Final = click.option(
    "--legacy-port",
    multiple=True,
    metavar="[HOST:]PORT[=SESSION]",
    help="Port at which original RL-Glue programs join a session; they look for 4096. Repeat it for several.",
)
"""The option of all commands that start a hub; see `glue.core.config.LegacyPort.parse`."""


_T = TypeVar("_T")


def _abortable(callback: Callable[..., _T]) -> Callable[..., _T]:
    """Return `callback` with KeyboardInterrupt as click.Abort: Click would print, and wait for it."""

    @wraps(callback)
    def call(*values: object, **options: object) -> _T:
        try:
            return callback(*values, **options)
        except KeyboardInterrupt as interrupt:
            if not is_stuck():
                say("")  # after the terminal's ^C
            raise click.Abort from interrupt

    return call


def run(command: click.Command) -> NoReturn:
    """Run `command` with the program's arguments, and exit with a code of docs/commands.md.

    Every option can be set by an environment variable, such as GLUE_EXPERIMENT_EPISODES for `--episodes` of
    glue-experiment, unless it declares another one.
    """
    handle_signals()
    if command.callback is not None:
        command.callback = _abortable(command.callback)
    prefix = (command.name or "").upper().replace("-", "_")
    try:
        code = command.main(standalone_mode=False, auto_envvar_prefix=prefix)
        sys.stdout.flush()
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt) as error:
        cause = error if isinstance(error, Terminated) else error.__cause__ or error.__context__
        exit_code = EXIT_TERMINATED if isinstance(cause, Terminated) else EXIT_INTERRUPTED
        if is_stuck():
            # Python would wait for it at exit, too.
            os._exit(exit_code)
        say("interrupted")
        sys.exit(exit_code)
    except GlueError as error:
        say(f"Error: {error}")
        sys.exit(2 if isinstance(error, ConfigError) else 1)
    except BrokenPipeError:
        # The reader of our output has seen enough. Python would complain once more at exit.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        say(f"Error: cannot write the output: {error.strerror}")
        # Python would try once more at exit, and complain.
        os._exit(1)
    sys.exit(code if isinstance(code, int) else 0)

"""Common parts of the command lines: running a command, its exit code, and shared options.

Click is a thin layer over functions: a command reads its options and calls one function; errors become
exit codes here and nowhere else. That function imports the slow modules, so that `--help` and completion
answer at once.
"""

from __future__ import annotations

import errno
import logging
import os
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

import click

from glue.cli.entry import EXIT_INTERRUPTED, EXIT_TERMINATED, Terminated, is_stuck
from glue.console import LOG, say
from glue.errors import ConfigError, GlueError
from glue.hub.config import HUB_KEY_VARIABLE, KEY_VARIABLE

WAIT_VARIABLE: Final = "GLUE_WAIT"
"""The environment variable of the option `--wait`, in every command that has it."""

DIRECTORY: Final = click.Path(path_type=Path, file_okay=False)
FILE: Final = click.Path(path_type=Path, dir_okay=False)

keys_option: Final = click.option(
    "--keys",
    type=DIRECTORY,
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
"""The option of all commands that start a hub; see `glue.hub.config.LegacyPort.parse`."""


_T = TypeVar("_T")
_Command = TypeVar("_Command", bound=Callable[..., object])


def pace_options(command: _Command) -> _Command:
    """Add the options that make up a `glue.pace.Pace`; each is None if it is not given."""
    rate = click.option(
        "--rate", type=float, metavar="HZ", help="Steps of the environment per second: it does not wait."
    )
    late = click.option(
        "--late",
        metavar="repeat|ACTION",
        help="What is carried out while the agent is late: its last action, or one such as 0,1. "
        "[default: repeat]",
    )
    delay = click.option(
        "--delay", type=int, metavar="STEPS", help="Carry each action out so many steps later."
    )
    return rate(late(delay(command)))


def reporting(callback: Callable[..., _T]) -> Callable[..., _T]:
    """Prepare the callback of a command for `run`, which itself prepares the commands that exist by then.

    A GlueError gets a note of the command's own options for the settings that it names. KeyboardInterrupt
    becomes click.Abort, because Click itself would print, and might block.
    """

    @wraps(callback)
    def call(*values: object, **options: object) -> _T:
        try:
            return callback(*values, **options)
        except GlueError as error:
            given = click.get_current_context().command.params
            # The common options of players begin with an underscore: a player may have one of that name.
            known = {(x.name or "").removeprefix("_"): x for x in given if isinstance(x, click.Option)}
            flags = [known[setting].opts[0] for setting in error.settings if setting in known]
            if flags:
                error.add_note(f" ({', '.join(flags)})")
            raise
        except KeyboardInterrupt as interrupt:
            if not is_stuck():
                say("")  # after the terminal's ^C
            raise click.Abort from interrupt

    return call


def prepare(command: click.Command) -> None:
    """Let a command, and its subcommands that exist by now, report as `reporting` describes."""
    if command.callback is not None:
        command.callback = reporting(command.callback)
    if isinstance(command, click.Group):
        for each in command.commands.values():
            prepare(each)


class _Printer(logging.Handler):
    """The printer of the log of a hub's clients."""

    def emit(self, record: logging.LogRecord) -> None:
        say(record.getMessage())


def run(command: click.Command) -> NoReturn:
    """Run `command` with the program's arguments, and exit with a code of docs/commands.md.

    Every option can be set by an environment variable, such as GLUE_EXPERIMENT_EPISODES for `--episodes` of
    glue-experiment, unless it declares another one.
    """
    LOG.addHandler(_Printer())
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    prepare(command)
    prefix = (command.name or "").upper().replace("-", "_")
    try:
        code = command.main(prog_name=command.name, standalone_mode=False, auto_envvar_prefix=prefix)
        sys.stdout.flush()
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt) as error:
        cause = error if isinstance(error, Terminated) else error.__cause__ or error.__context__
        exit_code = EXIT_TERMINATED if isinstance(cause, Terminated) else EXIT_INTERRUPTED
        if is_stuck():
            # Python would wait for standard error at exit, too.
            os._exit(exit_code)
        say("interrupted")
        sys.exit(exit_code)
    except GlueError as error:
        say(f"Error: {error}{''.join(getattr(error, '__notes__', ()))}")
        sys.exit(2 if isinstance(error, ConfigError) else 1)
    except BrokenPipeError:
        # The reader of our output has closed it. Python would complain again at exit.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            say(f"Error: {_reason(error)}")
            sys.exit(1)
        say(f"Error: cannot write the output: {error.strerror}")
        # Python would try again at exit, and complain.
        os._exit(1)
    sys.exit(code if isinstance(code, int) else 0)


def _reason(error: OSError) -> str:
    """Return the reason of an error of the system that no command expects.

    Raises:
        OSError: `error`, if it names no file: it may be a mistake of ours.
    """
    try:
        os.getcwd()
    except OSError:
        return "the working directory is gone: change to one that exists"
    if error.filename is None:
        raise error
    return f"{error.filename}: {error.strerror}"

"""What the command lines share: errors as one line, and `glue-env NAME`, `glue-agent NAME`.

Click is a skin over functions: a command reads its options, calls one function, and an error becomes an
exit code here and nowhere else.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final, NoReturn

import click

from glue import __version__
from glue.console import say
from glue.core.config import DEFAULT_HUB, DEFAULT_SESSION
from glue.errors import ConfigError, GlueError
from glue.options import Parameter, Value, build, parameters
from glue.players.loading import find, names
from glue.protocol.messages import Role

__all__ = ["EXIT_INTERRUPTED", "Extra", "Terminated", "player_command", "run"]

EXIT_INTERRUPTED: Final = 130
_EXIT_TERMINATED: Final = 143

legacy_port_option: Final = click.option(
    "--legacy-port",
    multiple=True,
    metavar="[HOST:]PORT[=SESSION]",
    help="Port at which original RL-Glue programs join a session; they look for 4096. Repeat it for several.",
)
"""The option of all commands that bring a hub; see `glue.core.config.LegacyPort.parse`."""


class Terminated(KeyboardInterrupt):
    """SIGTERM came: leave as politely as for Ctrl-C."""


def run(command: click.Command) -> NoReturn:
    """Run `command` with the program's arguments, and exit.

    0: done. 1: it failed, and said why in one line. 2: it was called wrongly. 130, 143: Ctrl-C, SIGTERM.
    """
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = command.main(standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt) as error:
        cause = error if isinstance(error, Terminated) else error.__cause__ or error.__context__
        sys.exit(_EXIT_TERMINATED if isinstance(cause, Terminated) else EXIT_INTERRUPTED)
    except GlueError as error:
        say(f"Error: {error}")
        sys.exit(2 if isinstance(error, ConfigError) else 1)
    except BrokenPipeError:
        # Whoever read our output has seen enough. Python would complain once more at exit.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        say(f"Error: cannot write the output: {error.strerror}")
        # Python would try once more at exit, and complain.
        os._exit(1)
    sys.exit(code if isinstance(code, int) else 0)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


Serve = Callable[[Mapping[str, Any], str, Callable[[str], None]], str]
"""Serves players, by session, at a hub, with a log; returns the hub's reason for the goodbye."""


@dataclass(frozen=True, slots=True)
class Extra:
    """An option that every player of a command has beside its own.

    Args:
        option: what click reads.
        apply: returns the player to serve for the one made and the value given.
    """

    option: click.Option
    apply: Callable[[Any, Any], Any]


def player_command(
    role: Role, command: str, serve: Serve, about: str, example: str, extra: Extra
) -> click.Group:
    """Return the command that starts an agent or environment by name: `glue-agent`, `glue-env`.

    Its subcommands are the installed names; `module:Class` and `path/to/file.py:Class` work as well.
    The options of each are its constructor's, see `glue.options`, and `extra`.
    """
    listed = ", ".join(names(role))
    help_text = (
        f"{about}\n\nNAME is one of {listed}, or your own as module:Class or path/to/file.py:Class. "
        f"`{command} NAME --help` lists its options.\n\n\b\nExamples:\n{example}"
    )
    return _PlayerGroup(role, serve, extra, name=command, help=help_text)


class _PlayerGroup(click.Group):
    """A group whose subcommands are made from the classes that its arguments name."""

    def __init__(self, role: Role, serve: Serve, extra: Extra, name: str, help: str) -> None:
        super().__init__(name=name, help=help, subcommand_metavar="NAME [OPTIONS]", no_args_is_help=True)
        self._role = role
        self._serve = serve
        self._extra = extra
        click.version_option(__version__, prog_name=name)(self)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return names(self._role)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        found = find(self._role, cmd_name)
        return _serving(self._role, self.name or "", cmd_name, found, self._serve, self._extra)


def _serving(role: Role, command: str, name: str, factory: type, serve: Serve, extra: Extra) -> click.Command:
    known = parameters(factory)
    extra_name = extra.option.name
    assert extra_name is not None

    # The names are ours, so that a player may have a parameter called hub or quiet.
    def start(_hub: str, _session: tuple[str, ...], _quiet: bool, **options: Value | None) -> None:
        added = options.pop(extra_name)
        given = {key: value for key, value in options.items() if value is not None}
        players = {one: build(factory, given) for one in _session}
        if added:
            players = {one: extra.apply(player, added) for one, player in players.items()}
        log = _silent if _quiet else say
        log(f"the hub said goodbye: {serve(players, _hub, log)}")

    summary = (factory.__doc__ or f"The {role} {name}.").strip()
    common: list[click.Parameter] = [
        click.Option(["--hub", "_hub"], default=DEFAULT_HUB, show_default=True, help="Address of the hub."),
        click.Option(
            ["--session", "_session"],
            multiple=True,
            default=(DEFAULT_SESSION,),
            show_default=True,
            help="Session to take part in; repeat it to serve several over one connection.",
        ),
        click.Option(["--quiet", "_quiet"], is_flag=True, help="Say nothing but errors."),
        extra.option,
    ]
    own: Sequence[click.Parameter] = [_option(parameter) for parameter in known.values()]
    examples = f"\b\nExamples:\n{_examples(command, name, known)}"
    return click.Command(name, callback=start, params=[*own, *common], help=summary, epilog=examples)


def _examples(command: str, name: str, known: Mapping[str, Parameter]) -> str:
    """Return how to start a player by itself, and how glue-experiment starts it, with an option."""
    flag = command.removeprefix("glue-")
    option = next((f"{own.name}={own.shown}" for own in known.values() if own.default is not None), None)
    given = "" if option is None else f" --{flag}-option {option}"
    return f"  {command} {name} --hub {DEFAULT_HUB}\n  glue-experiment --{flag} {name}{given} --episodes 100"


def _silent(line: str) -> None:
    pass


def _option(parameter: Parameter) -> click.Option:
    """Return the command line's option for a constructor's parameter."""
    flag = f"--{parameter.flag}"
    if parameter.type is bool:
        flag = f"{flag}/--no-{flag[2:]}"
    option = parameter.option
    notes = []
    if option.choices:
        notes.append("one of " + ", ".join(option.choices))
    if option.low is not None or option.high is not None:
        low = "" if option.low is None else f"{option.low:.15g}"
        high = "" if option.high is None else f"{option.high:.15g}"
        notes.append(f"{low}..{high}")
    if option.unit:
        notes.append(option.unit)
    if parameter.default is not None:
        notes.append(f"default {parameter.shown}")
    text = option.help + (f" [{'; '.join(notes)}]" if notes else "")
    return click.Option([flag, parameter.name], type=parameter.type, default=None, help=text)

"""The common parts of `glue-env` and `glue-agent`: a command whose subcommands are agents or environments.

The subcommands are the installed names; `module:Class` and `path/to/file.py:Class` work as well. The options
of each are the parameters of its constructor (see `glue.options`) and the options common to all.
"""

from __future__ import annotations

import inspect
import re
import shlex
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from glue import __version__
from glue.cli.season import SEASON_SETTINGS, play_agents, play_programs
from glue.cli.shared import HUB_KEY_SETTINGS, KEY_SETTINGS, WAIT_VARIABLE, reporting
from glue.console import LOG, errors_only
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, HUB_VARIABLE, SESSION_VARIABLE
from glue.options import Parameter, Value, parameters
from glue.plugins.loading import construct, find, names, short_name, summaries, without_seed
from glue.plugins.naming import NamingCommand
from glue.wire.messages import Role

_COMMANDS: Final = {Role.AGENT: "glue-agent", Role.ENVIRONMENT: "glue-env"}


@dataclass(frozen=True, slots=True)
class Extra:
    """An option that players of a command have besides their own.

    Args:
        option: the option on the command line.
        apply: returns the player to serve, given the player made and the option's value.
        method: the method that a player's class must have for the option; "" for every player.
    """

    option: click.Option
    apply: Callable[[Any, Any], Any]
    method: str = ""


def player_command(role: Role, example: str, *extras: Extra) -> click.Group:
    """Return the command that starts an agent or environment by name.

    Args:
        role: agent or environment.
        example: command lines for the help, each after two spaces.
        extras: options of agents or environments.
    """
    command = _COMMANDS[role]
    help_text = (
        f"Connect an {role} to a hub, and serve until the hub says goodbye.\n\n"
        "NAME is one of the commands below, or your own class as module:Class or path/to/file.py:Class. "
        f"`{command} NAME --help` lists its options.\n\n\b\nExamples:\n{example}"
    )
    return _PlayerGroup(role, extras, name=command, help=help_text)


class _PlayerGroup(NamingCommand, click.Group):
    """A group whose subcommands are made from the classes that its arguments name."""

    def __init__(self, role: Role, extras: Sequence[Extra], name: str, help: str) -> None:
        super().__init__(name=name, help=help, subcommand_metavar="NAME [OPTIONS]", no_args_is_help=True)
        if role is Role.AGENT:
            self.params.append(click.Option(["--season"], **SEASON_SETTINGS))
            self.invoke_without_command = True
            self.callback = self._begin
        self._role = role
        self._extras = extras
        click.version_option(__version__, prog_name=name)(self)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return names(self._role)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        factory = find(self._role, cmd_name)
        extras = [extra for extra in self._extras if not extra.method or hasattr(factory, extra.method)]
        return _serving(self._role, cmd_name, factory, extras)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the subcommand; with --season before it, the arguments are a program."""
        season = ctx.params.get("season")
        if season is None:
            return super().resolve_command(ctx, args)
        program = click.Command("PROGRAM", callback=reporting(partial(play_programs, season, args)))
        return program.name, program, []

    def _begin(self, season: Path | None) -> None:
        context = click.get_current_context()
        if context.invoked_subcommand is None:
            if season is None:
                context.fail("Missing command.")
            play_programs(season, ())

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the installed names with their summaries, without importing any of them."""
        known = summaries(self._role)
        width = max(formatter.width - 6 - max(map(len, known), default=0), 10)
        rows = [(name, textwrap.shorten(text, width, placeholder="...")) for name, text in known.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in names(self._role) if name.startswith(incomplete)]
        return [*found, *click.Command.shell_complete(self, ctx, incomplete)]

    def remedy(self, option: str, args: Sequence[str]) -> str:
        """Return the way to give `option`, which is one of the player."""
        player = next((word for word in args if word in names(self._role)), "NAME")
        rest = [word for word in args if word != player]
        return f"{option} comes after the name of the {self._role}: {self.name} {player} {shlex.join(rest)}"


def _serving(role: Role, name: str, factory: type, extras: Sequence[Extra]) -> click.Command:
    """Return the subcommand that serves players made by `factory`."""
    known = parameters(factory)

    # Our names begin with an underscore, so that a player may have a parameter called hub or quiet.
    def start(
        _hub: str,
        _session: tuple[str, ...],
        _key: str | None,
        _hub_key: str | None,
        _wait: float | None,
        _quiet: bool,
        _batch: int | None = None,
        _openenv: str | None = None,
        _insecure: bool = False,
        _season: Path | None = None,
        **options: Value | None,
    ) -> None:
        from glue.client.players import serve_agent, serve_environment
        from glue.plugins.batched import make_batch

        added = [(extra, options.pop(str(extra.option.name))) for extra in extras]
        given = {key: value for key, value in options.items() if value is not None}
        make = partial(construct, factory, given)
        if _insecure and _openenv is None:
            raise ConfigError("--insecure is for --openenv: give an address, too")

        def made() -> Any:
            player = make() if _batch is None else make_batch(name, make, _batch)
            for extra, value in added:
                if value is not None and value is not False:
                    player = extra.apply(player, value)
            return player

        if _season is not None:
            play_agents(_season, made, _label(name, given))
            return
        if _openenv is not None:
            _serve_openenv(made, name, _openenv, _insecure)
            return
        players = {one: made() for one in _session}
        serve = serve_agent if role is Role.AGENT else serve_environment
        with errors_only() if _quiet else nullcontext():
            if (warning := without_seed(role, name, factory)) is not None:
                LOG.warning("%s", warning)
            reason = serve(players, _hub, key=_key, hub_key=_hub_key, wait=_wait, name=_label(name, given))
            LOG.info("the hub said goodbye: %s", reason)

    # The parameters are listed as options.
    summary = _help(factory.__doc__ or f"The {role} {name}.")
    common = [
        click.Option(
            ["--hub", "_hub"],
            default=DEFAULT_HUB,
            show_default=True,
            envvar=HUB_VARIABLE,
            show_envvar=True,
            help="Address of the hub.",
        ),
        click.Option(
            ["--session", "_session"],
            multiple=True,
            default=(DEFAULT_SESSION,),
            show_default=True,
            envvar=SESSION_VARIABLE,
            show_envvar=True,
            help="Session to take part in; repeat it to serve several over one connection.",
        ),
        click.Option(["--key", "_key"], **KEY_SETTINGS),
        click.Option(["--hub-key", "_hub_key"], **HUB_KEY_SETTINGS),
        click.Option(
            ["--wait", "_wait"],
            type=click.FloatRange(0),
            metavar="SECONDS",
            envvar=WAIT_VARIABLE,
            show_envvar=True,
            help="Timeout for the hub to answer. [default: wait forever]",
        ),
        click.Option(["--quiet", "_quiet"], is_flag=True, help="Print nothing but errors."),
        *(extra.option for extra in extras),
    ]
    if role is Role.AGENT:
        common.append(click.Option(["--season", "_season"], **SEASON_SETTINGS))
    if role is Role.ENVIRONMENT:
        text = "Serve N games as one environment, to an agent that acts in all of them at once."
        common += [
            click.Option(["--batch", "_batch"], type=click.IntRange(1), metavar="N", help=text),
            click.Option(
                ["--openenv", "_openenv"],
                metavar="HOST:PORT",
                help="Serve OpenEnv's clients at this address, instead of a hub: a game for each connection.",
            ),
            click.Option(
                ["--insecure", "_insecure"],
                is_flag=True,
                help="With --openenv, allow an address that other machines can reach.",
            ),
        ]
    options = [*(_option(parameter) for parameter in known.values()), *common]
    for option in options:
        # An environment variable would reach the players of an experiment, which would not record it.
        option.allow_from_autoenv = False
    examples = f"\b\nExamples:\n{_examples(role, name, known)}"
    return click.Command(name, callback=reporting(start), params=[*options], help=summary, epilog=examples)


def _serve_openenv(make: Callable[[], Any], name: str, address: str, insecure: bool) -> None:
    """Serve environments without a hub.

    Raises:
        ConfigError: an option of a hub or of a single game was given, too; see also `glue.openenv.serve`.
    """
    from glue.openenv import serve

    context = click.get_current_context()
    for option in ("_hub", "_session", "_key", "_hub_key", "_wait", "_quiet", "_batch", "_render"):
        if context.get_parameter_source(option) is ParameterSource.COMMANDLINE:
            flag = option.replace("_", "-").lstrip("-")
            raise ConfigError(f"--openenv serves each client a game, without a hub: leave out --{flag}")
    serve(make, name, address, insecure=insecure)


def _help(docstring: str) -> str:
    """Return a docstring for Click: programs keep their lines, and sections for programmers are left out."""
    parts = inspect.cleandoc(docstring).split("\n\n")
    kept = [part for part in parts if not re.match(r"(Args|Attributes|Raises|Returns):\n", part)]
    return "\n\n".join(f"\b\n{part}" if part.startswith(" ") else part for part in kept)


def _label(name: str, options: Mapping[str, Value]) -> str:
    """Return the name of a player in lines and in results, as in `sarsa step_size=0.2`."""
    words = [short_name(name) or name, *(f"{option}={value}" for option, value in options.items())]
    return textwrap.shorten(" ".join(words), 100, placeholder="...")


def _examples(role: Role, name: str, known: Mapping[str, Parameter]) -> str:
    """Return command lines that start a player on its own, and by glue-experiment with an option."""
    command = _COMMANDS[role]
    flag = command.removeprefix("glue-")
    option = next(
        (f"{own.name}={own.shown or 'VALUE'}" for own in known.values() if own.default is not None), None
    )
    given = "" if option is None else f" --{flag}-option {option}"
    return f"  {command} {name} --hub {DEFAULT_HUB}\n  glue-experiment --{flag} {name}{given} --episodes 100"


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
    if parameter.default not in (None, ""):
        notes.append(f"default {parameter.shown}")
    text = option.help + (f" [{'; '.join(notes)}]" if notes else "")
    return click.Option([flag, parameter.name], type=parameter.type, default=None, help=text)

"""Options that name agents and environments: completed in the shell, and explained when they are mixed up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import click
from click.shell_completion import CompletionItem

from glue.errors import GlueError
from glue.options import parameters
from glue.plugins.loading import find, names
from glue.wire.messages import Role

_FLAGS: Final = {"--agent": Role.AGENT, "--env": Role.ENVIRONMENT}


def complete_names(role: Role) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Return the `shell_complete` of a parameter that names an agent or environment."""

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return [CompletionItem(name) for name in names(role) if name.startswith(incomplete)]

    return complete


class NamingCommand(click.Command):
    """A command with `--agent NAME` and `--env NAME`, whose own options are given with `--agent-option`.

    If an option of the agent or environment is given as one of the command, the error says how to write it.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        given = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            remedy = self.remedy(error.option_name, given)
            if remedy is None:
                raise
            raise click.UsageError(remedy, ctx) from None

    def remedy(self, option: str, args: Sequence[str]) -> str | None:
        """Return the way to give `option` if a player named in `args` has it, else None."""
        wanted = option.lstrip("-")
        for flag, role in _FLAGS.items():
            name = _value_of(flag, args)
            if name is None:
                continue
            try:
                known = parameters(find(role, name))
            except GlueError:
                continue
            for parameter in known.values():
                if wanted in (parameter.flag, f"no-{parameter.flag}"):
                    if parameter.type is bool:
                        value = "on" if wanted == parameter.flag else "off"
                    else:
                        value = _value_of(option, args) or "VALUE"
                    assignment = f"{flag}-option {parameter.name}={value}"
                    return f"{option} is an option of the {role} {name}: write {assignment}"
        return None


def _value_of(flag: str, args: Sequence[str]) -> str | None:
    for word, following in zip(args, [*args[1:], None], strict=True):
        if word == flag:
            return following
        if word.startswith(f"{flag}="):
            return word.partition("=")[2]
    return None

"""A command with many options: `--help` shows the common ones, `--help-all` also the others, in groups."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import click

from glue.plugins.naming import NamingCommand

_ALL: Final = f"{__name__}.all"


class GroupedCommand(NamingCommand):
    """A command whose less common options are in groups.

    Args:
        groups: the flags of each group, by its title; all other options are common.
    """

    def __init__(self, *arguments: Any, groups: Mapping[str, tuple[str, ...]], **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._groups = groups
        self.params.append(
            click.Option(
                ["--help-all"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                callback=_show_all,
                help="Show all options and exit.",
            )
        )

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the common options, and the groups or where to find them."""
        lines = {
            param.opts[-1]: line for param in self.get_params(ctx) if (line := param.get_help_record(ctx))
        }
        groups = {title: [lines.pop(flag) for flag in flags] for title, flags in self._groups.items()}
        with formatter.section("Options"):
            formatter.write_dl(list(lines.values()))
        if _ALL not in ctx.meta:
            formatter.write_paragraph()
            formatter.write_text(f"More by --help-all: {', '.join(title.lower() for title in groups)}.")
            return
        for title, group in groups.items():
            with formatter.section(title):
                formatter.write_dl(group)


def _show_all(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        ctx.meta[_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()

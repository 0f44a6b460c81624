"""`glue-conform`: judge a client in any language."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from glue import __version__
from glue.commands import run
from glue.console import say
from glue.errors import ConfigError
from glue.protocol.messages import THREE_ROLES, Role
from glue.testing.conform.hub.clients import TRANSPORTS, starter
from glue.testing.conform.hub.rules import Tier

if TYPE_CHECKING:
    from glue.testing.conform.judge import Verdict

__all__ = ["conform", "main"]

_FAILED: Final = 1


@click.command("glue-conform")
@click.argument("role", type=click.Choice([str(role) for role in THREE_ROLES]))
@click.argument("command", nargs=-1, required=True)
@click.option(
    "--tier",
    type=click.Choice([str(tier) for tier in Tier]),
    default=str(Tier.COMPLETE),
    show_default=True,
    help="The highest tier to judge; it includes those before it.",
)
@click.option(
    "--transport",
    type=click.Choice(TRANSPORTS),
    multiple=True,
    default=TRANSPORTS,
    show_default=True,
    help="How the client connects. Repeat it for several.",
)
@click.option(
    "--wait",
    type=click.FloatRange(0.1),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="Timeout for each message that the client has to send.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead of lines.")
@click.option(
    "--scorecard",
    "card",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Also write the verdicts to this file, as a table in Markdown.",
)
@click.version_option(__version__, prog_name="glue-conform")
def conform(
    role: Role,
    command: tuple[str, ...],
    tier: Tier,
    transport: tuple[str, ...],
    wait: float,
    as_json: bool,
    card: Path | None,
) -> int:
    """Judge a client in any language: an agent, an environment or an experiment.

    glue-conform acts as the hub: it starts COMMAND, which connects to the address in GLUE_HUB and joins the
    session in GLUE_SESSION. COMMAND has to be the mirror that docs/clients.md describes. A line is printed
    for each rule; the exit code is 0 if the client reaches the tier.

    \b
    Examples:
      glue-conform agent -- ./mirror agent
      glue-conform experiment --tier plays -- node mirror.mjs experiment
      glue-conform agent --scorecard agent.md -- python -m glue.testing.mirror agent
    """
    from glue.testing.conform.judge import judge
    from glue.testing.conform.report import document, line, reached, scorecard, summary

    if card is not None and not card.parent.is_dir():
        raise ConfigError(f"cannot write {card}: there is no folder {card.parent}; make it first")

    def report(verdict: Verdict) -> None:
        if not as_json:
            click.echo(line(verdict))

    verdicts = [
        verdict
        for each in dict.fromkeys(transport)
        for verdict in judge(
            Role(role), starter(command), transport=each, tier=Tier(tier), wait=wait, report=report
        )
    ]
    if as_json:
        click.echo(json.dumps(document(Role(role), command, verdicts), indent=2))
    else:
        click.echo(summary(verdicts))
    if card is not None:
        card.write_text(scorecard(Role(role), command, verdicts), encoding="utf-8")
        say(f"wrote {card}")
    return 0 if all(reached(verdicts).values()) else _FAILED


def main() -> None:
    """Run `glue-conform`."""
    run(conform)

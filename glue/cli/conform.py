"""`glue-conform`: judge a client in any language."""

from __future__ import annotations

import json
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Final

import click

from glue import __version__
from glue.cli.shared import FILE
from glue.conform.clients.process import TRANSPORTS, starter
from glue.conform.rules import Outcome, Tier
from glue.console import for_terminal, say
from glue.errors import ConfigError
from glue.wire.messages import THREE_ROLES, Role

_HUB: Final = "hub"


@click.command("glue-conform")
@click.argument("role", type=click.Choice([*map(str, THREE_ROLES), _HUB]))
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
@click.option(
    "--seeds",
    type=click.IntRange(1),
    metavar="N",
    help="Instead of the rules play N scripts of random faults, as breaks at any byte.",
)
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Play one of these scripts.")
@click.option("--mirror", is_flag=True, help="Judge the client as the mirror, whatever its name.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead of lines.")
@click.option(
    "--scorecard",
    "card",
    type=FILE,
    metavar="FILE",
    help="Also write the verdicts to this file, as a table in Markdown.",
)
@click.version_option(__version__, prog_name="glue-conform")
def conform(
    role: str,
    command: tuple[str, ...],
    tier: Tier,
    transport: tuple[str, ...],
    wait: float,
    seeds: int | None,
    seed: int | None,
    mirror: bool,
    as_json: bool,
    card: Path | None,
) -> int:
    """Judge a client in any language, an agent, environment or experiment, or a hub.

    glue-conform acts as the hub: it starts COMMAND, which connects to the address in GLUE_HUB and joins the
    session in GLUE_SESSION. The mirror that docs/clients.md describes, whose name in HELLO is "mirror", is
    judged by every rule, any other agent or environment by those that do not depend on the content of its
    answers; an experiment has to be the mirror. A line is printed for each rule; the exit code is 0 if no
    MUST of the tier is broken.

    A hub is judged by its address, in place of COMMAND; it may be in use.

    \b
    Examples:
      glue-conform agent -- ./mirror agent
      glue-conform experiment --tier plays -- node mirror.mjs experiment
      glue-conform agent --scorecard agent.md -- python -m glue.testing.mirror agent
      glue-conform agent --seeds 200 -- ./mirror agent
      glue-conform hub tcp://127.0.0.1:4097
    """
    from glue.conform.clients.judge import judge, judge_scripts
    from glue.conform.hubs.judge import judge_hub
    from glue.conform.report import document, line, reached, scorecard, summary

    if card is not None and not card.parent.is_dir():
        raise ConfigError(f"cannot write {card}: there is no folder {card.parent}; make it first")

    scripts = range(seed, seed + 1) if seed is not None else range(seeds or 0)
    if scripts and (role == _HUB or (seed is not None and seeds is not None)):
        raise ConfigError("scripts of faults are for clients: give --seeds N, or --seed N for one of them")
    if role == _HUB:
        if len(command) != 1:
            raise ConfigError("a hub is judged by its address alone, such as tcp://127.0.0.1:4097")
        judged = judge_hub(command[0], wait=wait)
    else:
        judging = partial(judge_scripts, seeds=scripts) if scripts else partial(judge, tier=Tier(tier))
        judged = chain.from_iterable(
            judging(Role(role), starter(command), transport=each, mirror=mirror, wait=wait)
            for each in dict.fromkeys(transport)
        )
    verdicts = []
    for verdict in judged:
        verdicts.append(verdict)
        if not as_json and (not scripts or verdict.outcome is not Outcome.PASSED):
            click.echo(for_terminal(line(verdict)))
    if as_json:
        click.echo(json.dumps(document(role, command, verdicts), indent=2))
    else:
        click.echo(summary(verdicts))
    if card is not None:
        card.write_text(scorecard(role, command, verdicts), encoding="utf-8")
        say(f"wrote {card}")
    return 0 if all(reached(verdicts).values()) else 1

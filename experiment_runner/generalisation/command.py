"""`glue-generalise`: how well an agent plays levels that it has not seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from glue import __version__
from glue.commands import run
from glue.console import say
from glue.errors import ConfigError
from glue.players.naming import complete_names
from glue.protocol.messages import Role

__all__ = ["generalise", "main"]


@click.command("glue-generalise")
@click.option(
    "--agent",
    "agent_name",
    help="Agent: an installed name, module:Class or path/to/file.py:Class.",
    shell_complete=complete_names(Role.AGENT),
)
@click.option(
    "--agent-option",
    "agent_options",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of the agent; {seed} in it is the seed of the trial. Repeat it for several.",
)
@click.option("--train", default="train-200", show_default=True, help="Set of levels to learn on.")
@click.option("--test", default="test-1000", show_default=True, help="Set of unseen levels.")
@click.option(
    "--learn",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Episodes on training levels before the agent is scored.",
)
@click.option(
    "--relearn",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Episodes on each level before the one that is scored there.",
)
@click.option(
    "--seed",
    "seeds",
    type=click.IntRange(0),
    multiple=True,
    default=(1, 2, 3),
    show_default=True,
    help="Seed of a trial. Repeat it for several.",
)
@click.option("--name", help="What the table calls the result. [default: the agent's name]")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File for the score of every level, as JSON.",
)
@click.option(
    "--table",
    "results",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    multiple=True,
    help="Play nothing; print the table of this file, which --out wrote. Repeat it for several.",
)
@click.version_option(__version__, prog_name="glue-generalise")
def generalise(
    agent_name: str | None,
    agent_options: tuple[str, ...],
    train: str,
    test: str,
    learn: int,
    relearn: int,
    seeds: tuple[int, ...],
    name: str | None,
    out: Path | None,
    results: tuple[Path, ...],
) -> None:
    """Score an agent on training levels and on unseen levels of Infinite Mario.

    The table shows return and goal rate on both sets of levels, and the gap between them.

    \b
    Examples:
      glue-generalise --agent random
      glue-generalise --agent hierarchical-internal --learn 2000 --out internal.json
      glue-generalise --table internal.json --table random.json
    """
    from env_server.mario.level_sets import resolve_levels
    from experiment_runner.generalisation.evaluation import evaluate
    from experiment_runner.generalisation.summary import table
    from glue.options import build, parse_assignments
    from glue.players.loading import find

    if results:
        print(table([_read(path) for path in results]))
        return
    if agent_name is None:
        raise click.UsageError("name the agent with --agent, or results with --table")
    if out is not None:  # before hours of playing
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"cannot write {out}: {error.strerror}") from None
    sets = [resolve_levels(levels, None, None) for levels in (train, test)]
    factory = find(Role.AGENT, agent_name)
    trials = []
    for seed in seeds:
        given = [option.replace("{seed}", str(seed)) for option in agent_options]
        agent = build(factory, parse_assignments(factory, given))
        played = evaluate(agent, seed, *map(_numbers, sets), learn=learn, relearn=relearn, progress=say)
        trials.append(played.document())
    document: dict[str, Any] = {
        "name": name or agent_name,
        "agent": agent_name,
        "agent_options": [*agent_options],
        "train": train,
        "test": test,
        "learn": learn,
        "relearn": relearn,
        "trials": trials,
    }
    if out is not None:
        out.write_text(json.dumps(document) + "\n", encoding="utf-8")
        say(f"wrote {out}")
    print(table([document]))


def _numbers(levels: range | None) -> range:
    assert levels is not None
    return levels


def _read(path: Path) -> dict[str, Any]:
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        names = ("name", "trials")
        if not all(name in document for name in names):
            raise ValueError(f"it has no {' or '.join(names)}")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} is not a result of glue-generalise: {error}") from None
    return document


def main() -> None:
    """Run `glue-generalise`."""
    run(generalise)


if __name__ == "__main__":
    main()

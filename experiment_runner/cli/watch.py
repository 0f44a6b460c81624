"""`glue-watch`: show an agent playing, in the terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from glue import __version__
from glue.cli.shared import FILE
from glue.console import say
from glue.errors import ConfigError
from glue.options import parse_assignments
from glue.plugins.loading import construct, find, load_trained
from glue.plugins.naming import NamingCommand, complete_names
from glue.wire.messages import Role

if TYPE_CHECKING:
    from glue.cli.screen import Marks, TerminalScreen
    from glue.engine.experiment import Experiment
    from glue.types import Observation


@click.command("glue-watch", cls=NamingCommand)
@click.option(
    "--env",
    "environment",
    metavar="NAME",
    default="mario",
    show_default=True,
    shell_complete=complete_names(Role.ENVIRONMENT),
    help="Environment.",
)
@click.option(
    "--agent", metavar="NAME", required=True, shell_complete=complete_names(Role.AGENT), help="Agent."
)
@click.option(
    "--env-option",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of the environment; see `glue-env NAME --help`.",
)
@click.option(
    "--agent-option",
    multiple=True,
    metavar="NAME=VALUE",
    help="Option of the agent; see `glue-agent NAME --help`.",
)
@click.option(
    "--load",
    type=FILE,
    help="Start from an agent saved by `glue-results agent`, including its random generator.",
)
@click.option("--episodes", type=click.IntRange(1), default=1, show_default=True, help="Episodes to show.")
@click.option(
    "--after",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Episodes to play first, without showing them.",
)
@click.option(
    "--max-steps", type=click.IntRange(0), default=0, show_default=True, help="Step limit; 0 for none."
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 1000),
    default=10.0,
    show_default=True,
    help="Steps shown per second.",
)
@click.option(
    "--plan",
    is_flag=True,
    help="Draw the agent's plan too, if it has one: its answer to the message `marks`.",
)
@click.option("--gif", type=FILE, help="Also write an animated GIF of the shown episodes.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Random seed.")
@click.version_option(__version__, prog_name="glue-watch")
def watch(
    environment: str,
    agent: str,
    env_option: tuple[str, ...],
    agent_option: tuple[str, ...],
    load: Path | None,
    episodes: int,
    after: int,
    max_steps: int,
    speed: float,
    plan: bool,
    gif: Path | None,
    seed: int,
) -> None:
    """Show an agent playing in this terminal.

    \b
    Examples:
      glue-watch --agent sample
      glue-watch --agent hierarchical --after 500
      glue-watch --agent hierarchical --load mario.agent --agent-option learning=off --agent-option epsilon=0
      glue-watch --env mines --agent sarsa --after 1000 --speed 5
      glue-watch --env mario --agent planner --plan
    """
    from glue.cli.screen import TerminalScreen, draws_marks, film, renderer
    from glue.engine.local import local

    env_class, agent_class = find(Role.ENVIRONMENT, environment), find(Role.AGENT, agent)
    world = construct(env_class, parse_assignments(env_class, env_option))
    player = construct(agent_class, parse_assignments(agent_class, agent_option))
    if load is not None:
        player = load_trained(player, load)
    draw = renderer(world)
    if plan and not draws_marks(draw):
        raise ConfigError(f"--plan: the drawing of {environment} shows no marks; leave --plan out")
    save_film = film(world) if gif else None
    screen = TerminalScreen(sys.stdout, draw)
    shown: list[tuple[Observation, Marks]] = []
    with local(player, world) as glue:
        glue.rl_init(seed)
        for _ in range(after):
            glue.rl_episode(max_steps)
        for number in range(after + 1, after + episodes + 1):
            title = f"{agent} in {environment}, episode {number}"
            played = shown if gif else None
            episode_return, steps = play(glue, screen, title, max_steps, speed, plan=plan, shown=played)
            say(f"episode {number}: return {episode_return:.2f} in {steps} steps")
    if save_film:
        save_film(gif, [one for one, _ in shown], speed, [marks for _, marks in shown])
        say(f"wrote {gif}")


def play(
    glue: Experiment,
    screen: TerminalScreen,
    title: str,
    max_steps: int,
    speed: float,
    sleep: Callable[[float], None] = time.sleep,
    *,
    plan: bool = False,
    shown: list[tuple[Observation, Marks]] | None = None,
) -> tuple[float, int]:
    """Run and draw one episode, `speed` steps a second; return its return and number of steps.

    If the screen is not a terminal, nothing is drawn and there are no pauses.

    Args:
        glue: runs the episode.
        screen: to draw on.
        title: below the drawing.
        max_steps: step limit; 0 for none.
        speed: steps a second.
        sleep: waits for seconds.
        plan: ask the agent for marks before each step, and draw them.
        shown: receives every observation with its marks.

    Raises:
        ConfigError: the agent has no plan.
    """
    from glue.cli.screen import read_marks
    from glue.engine.experiment import steps

    def show(observation: Observation, reward: float, terminal: bool) -> None:
        marks = read_marks(glue.rl_agent_message("marks")) if plan and not terminal else ()
        if shown is not None:
            shown.append((observation, marks))
        screen.show(observation, reward, made, glue.rl_return(), title, marks)

    pause = 1.0 / speed if screen.live else 0.0
    made = 0
    with screen:
        show(glue.rl_start().observation, 0.0, False)
        for made, step in enumerate(steps(glue, max_steps), 1):  # noqa: B007  # `show` reads it
            sleep(pause)
            show(step.observation, step.reward, step.terminal)
    return glue.rl_return(), glue.rl_num_steps()

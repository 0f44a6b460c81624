"""The examples of the client libraries in Python. Usage: python_programs.py random|skeleton|experiment."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from env_server.toys import SkeletonEnvironment
from glue import connect, serve_agent, serve_environment
from glue.errors import PeerLost
from tests.clients.random_agent import RandomAgent

_MAX_STEPS = 1000


def few_episodes(hub: str, session: str, episodes: int = 10, seed: int = 1) -> None:
    """Play some episodes, and print the outcome of each."""
    with connect(hub, session) as glue:
        glue.rl_init(seed)
        done = 0
        while done < episodes:
            try:
                glue.rl_episode(_MAX_STEPS)
            except PeerLost as error:
                print(f"again, because {error}", file=sys.stderr)
                continue
            done += 1
            print(f"episode {done}: return {glue.rl_return()}, {glue.rl_num_steps()} steps", flush=True)
        glue.rl_cleanup()


def main(program: str, *arguments: str) -> None:
    """Run a program at the hub and in the session that GLUE_HUB and GLUE_SESSION name."""
    hub = os.environ["GLUE_HUB"]
    session = os.environ.get("GLUE_SESSION", "default")
    if program == "random":
        serve_agent(RandomAgent(), hub, session)
    elif program == "skeleton":
        serve_environment(SkeletonEnvironment(), hub, session)
    else:
        few_episodes(hub, session, *map(int, arguments))


if __name__ == "__main__":
    main(*sys.argv[1:])

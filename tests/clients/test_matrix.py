"""An agent in one language, an environment in a second, an experiment in a third: every combination."""

from __future__ import annotations

from contextlib import ExitStack

from env_server.toys import SkeletonEnvironment
from glue.engine.local import local
from tests.clients.languages import LANGUAGES, PYTHON
from tests.clients.random_agent import RandomAgent
from tests.clients.table import SECONDS, Episode, hub, program, read_episodes

EPISODES = 10
SEED = 3

ALL = (PYTHON, *LANGUAGES)


def expected() -> list[Episode]:
    glue = local(RandomAgent(), SkeletonEnvironment())
    glue.rl_init(SEED)
    return [
        (glue.rl_return(), glue.rl_num_steps()) for _ in range(EPISODES) if glue.rl_episode(1000) is not None
    ]


def test_every_combination_of_languages_plays_the_same_episodes() -> None:
    for language in LANGUAGES:
        language.ready()
    right = expected()
    arguments = (str(EPISODES), str(SEED))
    for agent in ALL:
        with ExitStack() as stack:
            url = stack.enter_context(hub())
            for environment in ALL:
                session = f"{agent.name} and {environment.name}"
                stack.enter_context(program(agent.programs["random"], url, session))
                stack.enter_context(program(environment.programs["skeleton"], url, session))
            for environment in ALL:
                session = f"{agent.name} and {environment.name}"
                for experiment in ALL:
                    # The players remain for the experiment in the next language.
                    with program((*experiment.programs["experiment"], *arguments), url, session) as process:
                        assert process.stdout is not None
                        assert read_episodes(process.stdout) == right, (session, experiment.name)
                        assert process.wait(SECONDS) == 0

"""An agent in one language, an environment in a second, an experiment in a third: every combination."""

from __future__ import annotations

from contextlib import ExitStack

from glue import connect
from tests.clients.languages import LANGUAGES, PYTHON
from tests.clients.table import SECONDS, program, read_episodes, walked
from tests.hubs import hub_with
from tests.players import outcomes

EPISODES = 10
SEED = 3

ALL = (PYTHON, *LANGUAGES)


def test_every_combination_of_languages_plays_the_same_episodes() -> None:
    for language in LANGUAGES:
        language.ready()
    right = walked(EPISODES, SEED)
    arguments = (str(EPISODES), str(SEED))
    for agent in ALL:
        with ExitStack() as stack:
            url = stack.enter_context(hub_with())
            for environment in ALL:
                session = f"{agent.name}-{environment.name}"
                stack.enter_context(program(agent.programs["random"], url, session))
                stack.enter_context(program(environment.programs["skeleton"], url, session))
            for environment in ALL:
                session = f"{agent.name}-{environment.name}"
                with connect(url, session, wait=SECONDS) as glue:
                    glue.rl_init(SEED)
                    assert outcomes(glue, EPISODES, 1000) == right, session
                for experiment in LANGUAGES:
                    # The players remain for the experiment in the next language.
                    with program((*experiment.programs["experiment"], *arguments), url, session) as process:
                        assert process.stdout is not None
                        assert read_episodes(process.stdout) == right, (session, experiment.name)
                        assert process.wait(SECONDS) == 0

"""Players of both packages called rlglue: the same results as by those packages' own loops."""

from __future__ import annotations

import importlib
import runpy
from pathlib import Path
from typing import Any

import pytest

from glue import load_run, local
from glue.errors import ConfigError, LocalProtocolError
from glue.options import build, parameters
from glue.plugins.loading import file_in, find, located
from glue.rlglue.package import TaskSpecParser, provide
from glue.taskspec import parse_task_spec
from glue.testing import check_agent, check_environment
from glue.types import Action, Observation
from glue.wire.messages import Role
from tests import forked

CODEC = """
from random import Random

from rlglue.agent import AgentLoader as AgentLoader
from rlglue.agent.Agent import Agent
from rlglue.environment import EnvironmentLoader as EnvironmentLoader
from rlglue.environment.Environment import Environment
from rlglue.types import Action, Observation, Reward_observation_terminal
from rlglue.utils import TaskSpecVRLGLUE3

SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 0.9 OBSERVATIONS INTS (0 20) "
    "DOUBLES (2 -1.0 1.0) CHARCOUNT 3 ACTIONS INTS (0 1) CHARCOUNT 1 REWARDS (-1.0 UNSPEC) EXTRA a line"
)


class Line(Environment):
    def __init__(self, length=21, slip=0.1):
        self.length, self.slip, self.inits = length, slip, 0

    def env_init(self):
        self.inits += 1
        self.random = Random(7)
        return SPEC

    def _seen(self):
        seen = Observation(1, 2, 3)
        seen.intArray = [self.at]
        seen.doubleArray = [self.at / 21, -0.0]
        seen.charArray = ["a", "\\xff", str(self.at % 10)]
        return seen

    def env_start(self):
        self.at = self.length // 2
        return self._seen()

    def env_step(self, action):
        assert action.charArray == ["x"], action.charArray
        way = action.intArray[0] if self.random.random() > self.slip else 1 - action.intArray[0]
        self.at += 2 * way - 1
        ended = self.at in (0, self.length - 1)
        return Reward_observation_terminal(float(self.at > 0) if ended else -0.01, self._seen(), ended)

    def env_cleanup(self):
        pass

    def env_message(self, message):
        return "inits %d" % self.inits if message == "inits" else None


class Silent(Environment):
    def env_init(self):
        pass

    env_start = env_step = env_init


class Walker(Agent):
    def agent_init(self, text):
        spec = TaskSpecVRLGLUE3.TaskSpecParser(text)
        assert spec.valid and spec.getDiscountFactor() == 0.9
        assert spec.getIntActions() == [[0, 1]] and spec.getCharCountActions() == 1
        self.random, self.ended = Random(3), 0
        self.value = [0.0] * (spec.getIntObservations()[0][1] + 1)

    def _act(self, observation):
        assert isinstance(observation, Observation)
        self.at = observation.intArray[0]
        assert observation.charArray == ["a", "\\xff", str(self.at % 10)]
        act = Action(1, 0, 1)
        best = int(self.value[self.at] >= 0)
        act.intArray[0] = self.random.randrange(2) if self.random.random() < 0.3 else best
        act.charArray[0] = "x"
        return act

    def agent_start(self, observation):
        return self._act(observation)

    def agent_step(self, reward, observation):
        self.value[self.at] += 0.5 * (reward + self.value[observation.intArray[0]] - self.value[self.at])
        return self._act(observation)

    def agent_end(self, reward):
        self.ended += 1
        self.value[self.at] += 0.5 * (reward - self.value[self.at])

    def agent_cleanup(self):
        pass

    def agent_message(self, message):
        return str(self.ended)


if __name__ == "__main__":
    AgentLoader.loadAgent(Walker())
"""

ANDNP = """
import numpy as np
from rlglue import BaseAgent, BaseEnvironment


class Grid(BaseEnvironment):
    def __init__(self, seed, size: int = 5, form: str = "int"):
        self.random, self.size, self.form = np.random.default_rng(seed), size, form

    def _seen(self):
        if self.form == "int":
            return int(self.at @ (1, self.size))
        return self.at.astype({"ints": np.int64, "doubles": np.float32, "bytes": np.uint8}[self.form])

    def start(self):
        self.at = self.random.integers(0, self.size, 2)
        return self._seen()

    def step(self, action):
        self.at = np.clip(self.at + ((1, 0), (-1, 0), (0, 1), (0, -1))[action], 0, self.size - 1)
        ended = bool((self.at == self.size - 1).all())
        return self._seen(), -1.0, ended, False, {"gamma": 0.0 if ended else 1.0}


class Wanderer(BaseAgent):
    def __init__(self, seed: int = 0, laziness: float = 0.5):
        self.random, self.laziness, self.log = np.random.default_rng(seed), laziness, []

    def _act(self, obs):
        self.log.append(np.asarray(obs).tolist())
        return int(self.random.integers(4)) if self.random.random() > self.laziness else np.int64(0)

    def start(self, obs):
        return self._act(obs)

    def step(self, reward, obs, extra):
        self.log.append(reward)
        return self._act(obs)

    def end(self, reward, extra):
        self.log.append(("end", reward))


class Needy(BaseAgent):
    def __init__(self, observations, actions: int = 4): ...
    def start(self, obs): ...
    def step(self, reward, obs, extra): ...


class Ends(Grid):
    def step(self, action):
        return 0, 1.0, False, True, {}


class Neither:
    def start(self): ...
"""


OLDER = """
from RlGlue import BaseAgent, BaseEnvironment, RlGlue
from RlGlue.environment import BaseEnvironment as Same
import numpy as np


class Count(BaseEnvironment):
    def __init__(self, extra: bool = False):
        assert Same is BaseEnvironment
        self.extra = extra

    def start(self):
        self.at = 0
        return np.array([self.at])

    def step(self, action):
        self.at += action
        found = (-1.5, np.array([self.at]), self.at >= 3)
        return (*found, {"gamma": 1}) if self.extra else found


class Up(BaseAgent):
    def start(self, observation):
        self.log = [("start", int(observation))]
        return 1

    def step(self, reward, observation):
        self.log.append((reward, int(observation)))
        return 1

    def end(self, reward):
        self.log.append(("end", reward))
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, which holds players of both packages."""
    (tmp_path / "codec.py").write_text(CODEC)
    (tmp_path / "andnp.py").write_text(ANDNP)
    (tmp_path / "older.py").write_text(OLDER)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def players(environment: str, agent: str, **options: Any) -> tuple[Any, Any]:
    """Return an agent and an environment as the commands make them."""
    return (
        build(find(Role.AGENT, f"rlglue:{agent}"), {}),
        build(find(Role.ENVIRONMENT, f"rlglue:{environment}"), options),
    )


def test_codec_s_players_play_as_by_rl_glue_s_own_rules(here: Path) -> None:
    agent, environment = players("codec.py:Line", "codec.py:Walker", slip=0.2)
    found = []
    with local(agent, environment) as glue:
        glue.rl_init()
        for _ in range(30):
            ended = glue.rl_episode(40)
            found.append((glue.rl_num_steps(), glue.rl_return(), ended))
        assert glue.rl_agent_message("ended") == str(sum(bool(ended) for *_, ended in found))
        assert (glue.rl_env_message("inits"), glue.rl_env_message("else")) == ("inits 1", "")
        glue.rl_cleanup()

    their_agent, their_environment = agent.source(), environment.source(slip=0.2)
    their_agent.agent_init(their_environment.env_init())
    expected = []
    for _ in range(30):
        action = their_agent.agent_start(their_environment.env_start())
        steps, total, ended = 1, 0.0, False
        while not ended and steps < 40:
            result = their_environment.env_step(action)
            total += result.r
            ended = result.terminal
            if ended:
                their_agent.agent_end(result.r)
            else:
                steps += 1
                action = their_agent.agent_step(result.r, result.o)
        expected.append((steps, total, ended))
    assert found == expected
    assert len({steps for steps, *_ in expected}) > 5


@pytest.mark.parametrize("form", ["int", "ints", "doubles", "bytes"])
def test_players_of_rlglue_andnp_play_as_by_its_own_loop(form: str, here: Path) -> None:
    rlglue = pytest.importorskip("rlglue.rl_glue")
    agent, environment = players("andnp.py:Grid", "andnp.py:Wanderer", form=form, size=4)
    found = []
    with local(agent, environment) as glue:
        glue.rl_init(11)
        for _ in range(20):
            ended = glue.rl_episode(31)
            found.append((bool(ended), glue.rl_return()))
    seeds = [player._options["seed"] for player in (agent, environment)]
    assert seeds[0] != seeds[1]
    original = agent.source(seed=seeds[0])
    theirs = rlglue.RlGlue(original, environment.source(seed=seeds[1], form=form, size=4))
    assert found == [(theirs.runEpisode(30), theirs.total_reward) for _ in range(20)]
    assert {ended for ended, _ in found} == {True, False}
    assert agent._made.log == original.log


@pytest.mark.parametrize("extra", [False, True])
def test_players_of_rlglue_as_it_was_before_2025_play(here: Path, extra: bool) -> None:
    agent, environment = players("older.py:Count", "older.py:Up", extra=extra)
    with local(agent, environment) as glue:
        glue.rl_init()
        assert glue.rl_episode(9)
        assert (glue.rl_return(), glue.rl_num_steps()) == (-4.5, 3)
    assert agent._made.log == [("start", 0), (-1.5, 1), (-1.5, 2), ("end", -1.5)]


def test_an_environment_of_the_codec_without_a_task_spec_has_none_or_that_of_its_option(here: Path) -> None:
    silent = find(Role.ENVIRONMENT, "rlglue:codec.py:Silent")
    assert parse_task_spec(build(silent, {}).env_init()).actions.stated is False
    assert build(silent, {"task_spec": "VERSION mine"}).env_init() == "VERSION mine"


def test_same_numbers_in_processes_and_by_a_plan_in_one(here: Path) -> None:
    pair = ("--env", "rlglue:andnp.py:Grid", "--agent", "rlglue:andnp.py:Wanderer", "--seed", "3")
    (here / "in").mkdir()
    (here / "in/plan.toml").write_text(
        'episodes = 5\nseed = 3\n[environments.Grid]\nclass = "rlglue:../andnp.py:Grid"\n'
        '[agents.Wanderer]\nclass = "rlglue:../andnp.py:Wanderer"\n'
    )
    returns: list[list[float]] = []
    for words in ([*pair, "--episodes", "5"], ["--plan", "in/plan.toml", "--in-process"]):
        name = f"run-{len(returns)}"
        done = forked.run("glue-experiment", *words, "--out", name, cwd=here)
        assert done.returncode == 0, done.stderr
        assert "has no agent_seed" not in done.stderr
        assert any("andnp.py" in path.name for path in (here / name / "sources").rglob("*")), name
        returns.append(load_run(here / name)["return"].tolist())
    assert returns[0] == returns[1]


def test_adapters_keep_the_contract(here: Path) -> None:
    line, grid = (find(Role.ENVIRONMENT, f"rlglue:{name}") for name in ("codec.py:Line", "andnp.py:Grid"))
    check_environment(line, action=lambda rng: Action(rng.integers(2, size=1), chars=b"x"))
    check_environment(grid, action=lambda rng: Action(rng.integers(4, size=1)))
    seen = Observation([1])
    check_agent(find(Role.AGENT, "rlglue:andnp.py:Wanderer"), "VERSION any", observation=lambda rng: seen)


def test_constructor_s_keywords_are_options_but_for_the_seed(here: Path) -> None:
    grid = find(Role.ENVIRONMENT, "rlglue:andnp.py:Grid")
    assert {n: p.default for n, p in parameters(grid).items()} == {"size": 5, "form": "int", "task_spec": ""}
    assert hasattr(grid, "env_seed")
    assert not hasattr(find(Role.ENVIRONMENT, "rlglue:codec.py:Line"), "env_seed")
    stated = build(grid, {"task_spec": "VERSION mine"})
    assert stated.env_init() == "VERSION mine"


def test_truncation_ends_an_episode(here: Path) -> None:
    agent, environment = players("andnp.py:Ends", "andnp.py:Wanderer")
    with local(agent, environment) as glue:
        glue.rl_init()
        assert (glue.rl_episode(), glue.rl_num_steps()) == (False, 2)


def test_mistakes_are_named(here: Path) -> None:
    for role, name, message in (
        (Role.AGENT, "andnp.py:Needy", "Needy: constructor parameter observations has no default: derive"),
        (Role.AGENT, "andnp.py:Neither", "is no agent of either package called rlglue: it has neither"),
        (Role.ENVIRONMENT, "codec.py:Walker", "neither env_start and env_step nor start and step"),
        (Role.AGENT, "none.py:A", "there is no file none.py"),
        (Role.AGENT, "", "is not complete: write rlglue:NAME"),
    ):
        with pytest.raises(ConfigError, match=message):
            find(role, f"rlglue:{name}")
    (here / "old.py").write_text("print 'of Python 2'\n")
    with pytest.raises(ConfigError, match=r"old\.py cannot be imported"):
        find(Role.AGENT, "rlglue:old.py:A")


def test_codec_s_own_loader_names_the_command(here: Path) -> None:
    provide()
    with pytest.raises(ConfigError, match=r"run it with glue-agent rlglue:FILE\.py:Walker"):
        runpy.run_path("codec.py", run_name="__main__")
    with pytest.raises(ConfigError, match=r"--agent rlglue:FILE\.py:str --env rlglue:FILE\.py:int"):
        importlib.import_module("RlGlue").RlGlue("agent", 7)


class Strange:
    """A player or environment whose answers are all `answer`."""

    answer: Any = None

    def start(self, *_: object) -> Any:
        return self.answer

    def step(self, *_: object) -> Any:
        return self.answer, 0.0, False, False, {}

    def env_init(self) -> str:
        return "VERSION none"

    env_start = start


@pytest.mark.parametrize("answer", ["text", None, {"a": 1}, [1, "b"], [[1], [2, 3]], 1j, 2**40])
def test_observations_that_cannot_cross_the_wire_are_named(
    answer: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Strange, "answer", answer)
    from glue.rlglue.adapters import AndnpAgent, AndnpEnvironment, adapted

    environment: Any = adapted(AndnpEnvironment, Strange)()
    environment.env_init()
    with pytest.raises(LocalProtocolError):
        environment.env_start()
    agent: Any = adapted(AndnpAgent, Strange)()
    agent.agent_init("")
    if answer != 2**40:
        with pytest.raises(LocalProtocolError, match="an action of rlglue-andnp is an int"):
            agent.agent_start(Observation([1]))


def test_several_kinds_of_numbers_arrive_as_a_dictionary(here: Path) -> None:
    agent, _ = players("andnp.py:Grid", "andnp.py:Wanderer")
    agent.agent_init("")
    agent.agent_start(Observation([1, 2], [0.5], b"ab"))
    (kinds,) = agent._made.log
    found = {name: values.tolist() for name, values in kinds.items()}
    assert found == {"ints": [1, 2], "doubles": [0.5], "chars": [97, 98]}


def test_provided_types_have_the_codec_s_methods() -> None:
    provide()
    from rlglue.types import Action as Theirs
    from rlglue.types import Observation as Seen

    first = Theirs(2, 1, 0)
    assert (first.intArray, first.doubleArray, first.charArray) == ([0, 0], [0.0], [])
    copy = Seen.fromAbstractType(first)
    assert isinstance(copy, Seen)
    assert copy.sameAs(first)
    copy.intArray[0] = 1
    assert not copy.sameAs(first)
    assert first.intArray == [0, 0]


def test_codec_s_parser_answers_by_its_names() -> None:
    spec = TaskSpecParser(
        "VERSION RL-Glue-3.0 PROBLEMTYPE continuing DISCOUNTFACTOR .5 OBSERVATIONS INTS (2 0 3) DOUBLES "
        "(NEGINF 1.5) CHARCOUNT 4 ACTIONS INTS (0 1) REWARDS (UNSPEC POSINF) EXTRA who"
    )
    assert (spec.getVersion(), spec.getProblemType()) == ("RL-Glue-3.0", "continuing")
    assert spec.getDiscountFactor() == 0.5
    assert (spec.getIntObservations(), spec.getDoubleObservations()) == ([[0, 3], [0, 3]], [["NEGINF", 1.5]])
    assert (spec.getCharCountObservations(), spec.getCharCountActions()) == (4, 0)
    assert (spec.getIntActions(), spec.getDoubleActions()) == ([[0, 1]], [])
    assert (spec.getRewardRange(), spec.getExtra()) == ([["UNSPEC", "POSINF"]], "who")
    assert spec.isSpecial(spec.getRewardRange()[0][0])
    assert spec.Validate()
    assert not TaskSpecParser("VERSION RL-Glue-3.0 PROBLEMTYPE").Validate()


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("mario", ""),
        ("a.b:C", ""),
        ("x/y.py:C", "x/y.py"),
        ("rlglue:x/y.py:C", "x/y.py"),
        ("rlglue:a.b:C", ""),
        ("gymnasium:CartPole-v1", ""),
    ],
)
def test_files_in_names(name: str, file: str) -> None:
    assert file_in(name) == file
    assert located(name, Path("/plans")) == name.replace(file, f"/plans/{file}" if file else file)

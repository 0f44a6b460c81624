"""Forks: players that fork helpers of their own, and a connection that a forked process inherits."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from glue import LocalProtocolError, connect, load_run
from tests.forked import run
from tests.hubs import hub_with
from tests.players import ScriptedAgent, ScriptedEnvironment

PLAYERS = """
import multiprocessing, signal, time
from agents.baselines import SkeletonAgent
from env_server.toys import SkeletonEnvironment
from glue import Action

fork = multiprocessing.get_context("fork")


class Pooling(SkeletonAgent):
    def agent_start(self, observation):
        with fork.Pool(2) as pool:
            return Action([max(pool.map(abs, [0, -1]))])


class Helped(SkeletonEnvironment):
    def env_start(self):
        ready = fork.Event()
        helper = fork.Process(target=lambda: (ready.set(), time.sleep(600)))
        helper.start()
        ready.wait()
        helper.terminate()
        helper.join()
        assert helper.exitcode == -signal.SIGTERM
        return super().env_start()
"""


def test_helpers_that_players_fork_end_when_they_are_told_to(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(PLAYERS)
    players = ("--env", "mine.py:Helped", "--agent", "mine.py:Pooling")
    done = run("glue-experiment", *players, "--episodes", "2", "--inside=agent", "--out", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(load_run(tmp_path / "run")["return"]) == 2


def test_a_connection_in_a_forked_process_is_refused_there_and_goes_on_in_its_own() -> None:
    with hub_with(ScriptedAgent(), ScriptedEnvironment()) as hub, connect(hub) as glue:
        glue.rl_init()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # from 3.12 on: there are threads
            child = os.fork()
        if not child:
            status = 1
            try:
                glue.rl_episode(0)
            except LocalProtocolError as error:
                status = 42 if "connect in each process" in str(error) else 2
                glue.close()  # says no goodbye to the hub
            finally:
                os._exit(status)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 42
        assert glue.rl_episode(0)
        assert glue.rl_num_episodes() == 1

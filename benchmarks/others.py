"""Environments of other projects, each in an interpreter that has it; GLUE_OTHERS names more interpreters.

    GLUE_OTHERS=/one/bin/python:/two/bin/python python -m benchmarks gym

Started as a program, with the name of a case, this file imports nothing of ours: for each line that it reads,
it makes a number of steps and answers with a line.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


def _envpool(name: str, games: int, calls: int) -> tuple[Callable[[], None], int]:
    import numpy as np

    envpool: Any = importlib.import_module("envpool")
    pool = envpool.make(name, env_type="gymnasium", num_envs=games, num_threads=1)
    pool.reset()
    actions = np.ones(games, int)

    def play() -> None:
        for _ in range(calls):
            pool.step(actions)

    return play, games * calls


def _super_mario(steps: int) -> tuple[Callable[[], None], int]:
    mario: Any = importlib.import_module("gym_super_mario_bros")
    env = mario.make("SuperMarioBros-v0").unwrapped
    env.reset()

    def play() -> None:
        for _ in range(steps):
            if env.step(1)[2]:
                env.reset()

    return play, steps


_CASES: dict[str, tuple[str, Callable[[], tuple[Callable[[], None], int]]]] = {
    "EnvPool's CartPole-v1, 64 games, one thread": ("envpool", lambda: _envpool("CartPole-v1", 64, 500)),
    "EnvPool's CartPole-v1, 1,024 games, one thread": ("envpool", lambda: _envpool("CartPole-v1", 1024, 60)),
    "EnvPool's Pong-v5, 64 games, one thread": ("envpool", lambda: _envpool("Pong-v5", 64, 20)),
    "gym-super-mario-bros": ("gym_super_mario_bros", lambda: _super_mario(300)),
}
"""By name: the required package, and a function that returns the work and its number of steps."""


@contextmanager
def other_environments() -> Iterator[dict[str, tuple[Callable[[], None], int, int]]]:
    """Yield the cases whose package some interpreter has: the work, its number of steps, and the process."""
    interpreters = [sys.executable, *filter(None, os.environ.get("GLUE_OTHERS", "").split(":"))]
    started: list[subprocess.Popen[str]] = []
    found: dict[str, tuple[Callable[[], None], int, int]] = {}
    for name, (package, _) in _CASES.items():
        having = [one for one in interpreters if _has(one, package)]
        if having:
            process = subprocess.Popen(
                [having[0], "-P", "-W", "ignore", __file__, name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            started.append(process)
            found[name] = _asking(process), int(_read(process)), process.pid
    try:
        yield found
    finally:
        for process in started:
            with process:
                process.terminate()


def _has(interpreter: str, package: str) -> bool:
    """Return whether an interpreter has a package, without importing it, which may take long."""
    look = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({package!r}) is None)"
    return subprocess.run([interpreter, "-c", look], check=False).returncode == 0


def _asking(process: subprocess.Popen[str]) -> Callable[[], None]:
    def ask() -> None:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
        _read(process)

    return ask


def _read(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"{process.args!r} ended")
    return line


def _serve(name: str) -> None:
    play, steps = _CASES[name][1]()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # the output of other packages is no answer
    print(steps, file=answers, flush=True)
    for _ in sys.stdin:
        play()
        print("done", file=answers, flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1])

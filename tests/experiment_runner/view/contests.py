"""A small competition of trusted programs that waits for a file before its trials end."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.forked import run

TITLE = "<script>alert(1)</script> spring"
ENTRANTS = ("walker", "thrower")
MATCHES = 8

_AGENT = """\
import os, sys, time
from glue import Action, serve_agent

class Agent:
    steps = 0
    def agent_init(self, task_spec):
        while not os.path.exists("go"):
            time.sleep(0.01)
    def agent_start(self, observation): return self.act()
    def agent_step(self, reward, observation): return self.act()
    def agent_end(self, reward): pass
    def agent_cleanup(self): pass
    def agent_message(self, message): return ""
    def act(self):
        self.steps += 1
        if sys.argv[1] == "thrower" and self.steps == 25:
            raise ValueError("<script>alert(2)</script>")
        moves = (1, 1, 0, 1) if sys.argv[1] == "walker" else (1, 0)
        return Action(ints=[moves[self.steps % len(moves)]])

serve_agent(Agent(), os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])
"""
_FILE = f"""\
name = "{TITLE}"
trials = 2
seed_file = "secret.txt"
[limits]
start_seconds = 120
[tasks.mines]
env = "mines"
options = {{ random_start = true }}
steps = 200
[tasks.walk]
env = "skeleton"
episodes = 4
"""


def write_competition(folder: Path) -> Path:
    """Write a competition into a folder, and return its file; its entrants wait for a file `go` there."""
    (folder / "agent.py").write_text(_AGENT)
    secret = folder / "secret.txt"
    secret.touch(0o600)
    secret.write_text("only a test")
    entrants = [
        f'[entrants.{name}]\ncommand = ["{sys.executable}", "agent.py", "{name}"]\n' for name in ENTRANTS
    ]
    file = folder / "spring.toml"
    file.write_text(_FILE + "".join(entrants))
    return file


def hold(folder: Path) -> None:
    """Hold the competition in a folder, as the run `held`, and verify it."""
    file = write_competition(folder)
    (folder / "go").touch()
    for command in (("run", file.name, "--out", "held", "--workers", "2"), ("verify", "held")):
        done = run("glue-compete", *command, cwd=folder)
        assert done.returncode == 0, done.stderr

"""A small competition of trusted programs, which end in all possible ways."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tests import forked

AGENT = """\
import os, sys, time
from contextlib import suppress
from glue import Action, serve_agent

class Walker:
    steps = ends = 0
    def agent_init(self, task_spec): self.mines = "(0 3)" in task_spec
    def agent_start(self, observation): return self.act()
    def agent_step(self, reward, observation): return self.act()
    def agent_end(self, reward):
        self.ends += 1
        if self.ends == 2 and not self.mines:
            if kind == "raise": babble()
            if kind != "walk": os._exit(8)
    def act(self):
        self.steps += 1
        if self.steps == 25 and self.mines:
            if kind == "crash": os._exit(7)
            if kind == "raise": raise ValueError("<script>alert(1)</script>")
        return Action(ints=[(1, 1, 0, 1)[self.steps % 4]])

def babble():
    for descriptor in range(3, 100):
        with suppress(OSError): os.write(descriptor, b"garbage" * 100)

kind = sys.argv[1]
while not os.path.exists("go"): time.sleep(0.01)
print("I am", kind, sorted(name for name in os.environ if name.startswith(("GLUE", "SECRET"))), flush=True)
print("x" * 100_000, flush=True)
serve_agent(Walker(), os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])
"""

ENTRANT = f'[entrants.{{name}}]\ncommand = ["{sys.executable}", "agent.py", "{{kind}}"]\n'
FILE = """\
name = "<b>spring</b>"
trials = 1
seed_env = "SECRET"
limits = { start_seconds = 300, log = "2k" }
tasks.mines = { env = "mines", options.random_start = true, steps = 200 }
tasks.walk = { env = "skeleton", episodes = 4 }
""" + "".join(ENTRANT.format(name=name, kind=name) for name in ("walk", "crash", "raise"))


def compete(folder: Path, *arguments: str, secret: str = "xyzzy", status: int = 0) -> str:
    """Run `glue-compete` in a folder, which ends with this exit status; return all that it prints."""
    environment = {**os.environ, "SECRET": secret}
    done = forked.run("glue-compete", *arguments, cwd=folder, env=environment, timeout=300, status=status)
    return done.stdout + done.stderr


def write(folder: Path, text: str = FILE, go: bool = True) -> None:
    """Write a competition into a folder, and the program of its entrants, which waits for the file `go`."""
    (folder / "agent.py").write_text(AGENT)
    (folder / "spring.toml").write_text(text)
    if go:
        (folder / "go").touch()

"""Run a command, as in `python -m glue_rl experiment --json`, or one of our modules, as `python -m` does.

Unlike `python -m MODULE` it finds ours where another distribution has a package of that name.
"""

import runpy
import sys

from glue.cli.entry import start
from glue_rl.commands import COMMANDS

if __name__ == "__main__":
    del sys.argv[0]
    if sys.argv[0] in COMMANDS:
        start(COMMANDS[sys.argv[0]], sys.argv[0])
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)

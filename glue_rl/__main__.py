"""Run one of our modules, as `python -m MODULE` does: `python -m glue_rl MODULE ARGUMENT...`.

Unlike `python -m MODULE` it finds ours where another distribution has a package of that name.
"""

import runpy
import sys

if __name__ == "__main__":
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)

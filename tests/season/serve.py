"""`glue-compete serve` on a calendar of its own, on which a day takes `DAY` seconds.

    python -m tests.season.serve BEGAN ARGUMENTS...

The calendar agrees with the clock at BEGAN, in seconds since 1970, however often the server is killed.
"""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from typing import Final

from experiment_runner.cli.compete import compete
from experiment_runner.competition.season.server import Server
from glue.cli.shared import run

DAY: Final = 20.0


def main() -> None:
    """Run the command with the arguments after the first."""
    began = float(sys.argv.pop(1))

    def now() -> datetime:
        return datetime.fromtimestamp(began + (time.time() - began) * 86_400 / DAY, UTC)

    assert Server.__init__.__kwdefaults__ is not None
    Server.__init__.__kwdefaults__["now"] = now
    run(compete)


if __name__ == "__main__":
    main()

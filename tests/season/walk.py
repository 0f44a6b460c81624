"""The program of an entrant who walks."""

from __future__ import annotations

import os

from glue import serve_agent
from tests.experiment_runner.competition.players import Walker

if __name__ == "__main__":
    serve_agent(Walker(), os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])

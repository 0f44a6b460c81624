"""Notebooks: serve a cell's players to a hub in the background, and draw a run's curve below its cell.

from glue.notebook import run_live, serve

with serve(agent=MyAgent()), serve(environment=MyEnvironment()), glue.connect() as experiment:
    returns = run_live(experiment, episodes=200, max_steps=1000)
"""

from __future__ import annotations

from glue.notebook.curve import draw_curve, run_live
from glue.notebook.serving import Served, serve

__all__ = ["Served", "draw_curve", "run_live", "serve"]

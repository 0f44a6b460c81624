"""Options that several agents for Infinite Mario have: how Mohan (2010) learns, and the seed."""

from __future__ import annotations

from typing import Annotated

from glue.options import Option

__all__ = ["Discount", "Epsilon", "Reduction", "Seed", "StepSize"]

StepSize = Annotated[float, Option("step size of SARSA (Mohan 2010: 0.3)", low=0, high=1)]
Discount = Annotated[float, Option("discount of SARSA (Mohan 2010: 0.9)", low=0, high=1)]
Epsilon = Annotated[float, Option("chance to explore, at first (Mohan 2010: 0.1)", low=0, high=1)]
Reduction = Annotated[
    float, Option("what every decision cycle multiplies epsilon by (Mohan 2010: 0.9999)", low=0, high=1)
]
Seed = Annotated[int | None, Option("random seed; the experiment's if not given", low=0)]

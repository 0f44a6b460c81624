"""Options of several agents for Infinite Mario: the learning parameters of Mohan (2010), and the seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from glue.options import Option

Seed = Annotated[int | None, Option("random seed; the experiment's if not given", low=0)]


@dataclass(frozen=True, kw_only=True)
class SarsaOptions:
    """The hyper-parameters of SARSA, with the values of Mohan (2010) as defaults."""

    step_size: Annotated[float, Option("step size of SARSA (Mohan 2010: 0.3)", low=0, high=1)] = 0.3
    discount: Annotated[float, Option("discount of SARSA (Mohan 2010: 0.9)", low=0, high=1)] = 0.9
    epsilon: Annotated[float, Option("initial chance to explore (Mohan 2010: 0.1)", low=0, high=1)] = 0.1
    reduction: Annotated[
        float, Option("factor of epsilon per decision cycle (Mohan 2010: 0.9999)", low=0, high=1)
    ] = 0.9999
    seed: Seed = None

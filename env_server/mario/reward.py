"""Events to reward.

An ordinary reward is the difference of two running totals, not a sum of increments: the last bits
of the two differ. A terminal reward is paid instead of the earnings of the unfinished step.
Source: RL-Competition 2009, Infinite Mario's check-in and its ends of an episode.
"""

from __future__ import annotations

from env_server.mario.sim.state import World
from glue.compiled.jit import jit


@jit
def ordinary_reward(world: World) -> float:
    """Return the reward earned since the last check-in, and note it as paid."""
    total = (
        world.reward_step * (world.steps - 1) + world.reward_coin * world.coins
    ) + world.reward_kill * world.kills
    reward = total - world.paid
    world.paid = total
    return reward


@jit
def terminal_reward(world: World) -> float:
    """Return the reward of an episode's last step. Winning takes precedence over dying."""
    return world.reward_goal if world.win_timer > 0 else world.reward_death

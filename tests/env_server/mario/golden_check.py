"""Play the recordings of the original against the simulator, and list every difference.

Also a program: `python golden_check.py TICKS STEPS` takes two lists of run names, separated by commas: the
first to compare the inner state at every tick, the second every step. It runs the rules uncompiled
(NUMBA_DISABLE_JIT=1), and prints the counts and the differences as JSON.
"""

from __future__ import annotations

import gzip
import json
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from env_server.mario.game import Game, ordinary_reward, terminal_reward
from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.parameters import Parameters, resolve
from env_server.mario.sim.state import FIREBALL, FLOWER, MUSHROOM, PLANT, SHELL, Actor, World
from env_server.mario.sim.step import draw, is_over, press_buttons, reset, tick
from glue.types import Observation

Line = dict[str, Any]
GOLDEN = Path(__file__).parents[2] / "golden" / "mario"
DIGESTS: dict[str, list[Line]] = json.loads((GOLDEN / "digests.json").read_text("utf-8"))
_SETTINGS = (
    *("level_seed", "level_type", "level_difficulty"),
    *("render", "alpha", "start_ticks", "velocity"),
)


class Checked(NamedTuple):
    """The number of steps or ticks compared, and the places where they differ."""

    compared: int
    differences: list[str]


def lines(name: str) -> Iterator[Line]:
    with gzip.open(GOLDEN / f"{name}.jsonl.gz", "rt", encoding="utf-8") as file:
        for line in file:
            yield json.loads(line)


def parameters_of(run: Line) -> Parameters:
    return resolve(run["params"] | {name: run[name] for name in _SETTINGS})


def check_runs(
    name: str,
    only: frozenset[str] | None = None,
    play: Callable[[Parameters], Any] = Game,
    most: float = math.inf,
) -> Checked:
    """Compare the runs of a file, each up to its first difference.

    Args:
        name: name of the file.
        only: the names of the runs; None for all.
        play: makes a game with these parameters, which is started and stepped as a `Game`.
        most: number of steps after which no other run begins.
    """
    compared, differences = 0, []
    game: Any = None
    where, lost = "", True
    for line in lines(name):
        kind = line["kind"]
        if kind == "run":
            if compared >= most:
                break
            game, where = play(parameters_of(line)), line["id"]
            lost = only is not None and where not in only
        if lost or kind not in ("start", "step"):
            continue
        reward, observation, ended, *_ = (
            (0.0, game.start(), False) if kind == "start" else game.step(*line["a"])
        )
        compared += kind == "step"
        if not same(line, reward, observation, ended):
            differences.append(f"{name} {where} at step {compared} of the file")
            lost = True
    return Checked(compared, differences)


def same(line: Line, reward: float, observation: Observation, ended: bool) -> bool:
    """Return whether a step equals the recorded one to the last bit."""
    return (
        observation == Observation(line["i"], line["d"], line["c"].encode("latin-1"))
        and (line["kind"] == "start" or reward.hex() == float(line["r"]).hex())
        and (line["kind"] == "start" or ended == line["end"])
    )


def check_ticks(name: str, only: frozenset[str]) -> Checked:
    """Compare the state after every tick, and every observation, of the named runs."""
    compared, differences = 0, []
    ticks: list[Line] = []
    game, where, lost = None, "", True
    observation = Observation()
    body = np.zeros(BODY_SIZE, np.uint8)
    for line in lines(name):
        kind = line["kind"]
        if kind == "run":
            game, where, ticks = Game(parameters_of(line)), line["id"], []
            lost = where not in only
        if kind == "tick":
            ticks.append(line)
        if lost or kind not in ("start", "step"):
            continue
        assert game is not None
        world, level = game.world, game.level_map
        if kind == "start":
            reset(world, level)
        else:
            world.steps += 1
            world.direction, world.jump, world.run = line["a"]
            draw(world, level)
        wrong = ""
        for i, recorded in enumerate(ticks):
            tick(world, level)
            press_buttons(world, i > 0)
            wrong = wrong or difference(recorded, state_of(world))
            if i < 4:
                draw(world, level)
            compared += 1
        ended = is_over(world) and len(ticks) < 5
        if ended:
            reward = terminal_reward(world)
        else:
            reward = ordinary_reward(world)
            observation = Observation.from_body(body[: encode(world, level, body)].tobytes())
        if not wrong and not same(line, float(reward), observation, ended):
            wrong = f"{kind} line"
        if wrong:
            differences.append(f"{name} {where} tick {world.tick_count}: {wrong}")
            lost = True
        ticks = []
    return Checked(compared, differences)


def difference(recorded: Line, ours: Line) -> str:
    """Return the first difference in a tick's state, or an empty string."""
    for name, value in ours.items():
        expected = recorded[name]
        if name == "sprites":
            continue
        if isinstance(value, dict):
            inner = difference(expected, value)
            if inner:
                return f"{name}.{inner}"
        elif value != (np.float32(expected) if isinstance(expected, float) else expected):
            return f"{name} is {value}, recorded {expected}"
    sprites = ours.get("sprites", [])
    if len(sprites) != len(recorded.get("sprites", [])):
        return f"{len(sprites)} sprites, recorded {recorded['sprites']}"
    for i, sprite in enumerate(sprites):
        inner = difference(recorded["sprites"][i], sprite)
        if inner:
            return f"sprites[{i}].{inner}"
    return ""


def state_of(world: World) -> Line:
    mario = world.actors[0]
    return {
        "tick": world.tick_count,
        "paused": world.frozen,
        "scene_xCam": world.camera,
        "layer_xCam": world.drawn_camera,
        "fireballsOnScreen": world.fireballs_seen,
        "coins": world.coins,
        "kills": world.kills,
        "large": world.large,
        "fire": world.fire,
        "keys": [world.button_left, world.button_right, world.button_jump, world.button_run],
        "mario": {
            **_place(mario),
            "onGround": mario.grounded,
            "wasOnGround": world.was_grounded,
            "mayJump": world.may_jump,
            "sliding": world.wall_slide,
            "jumpTime": world.jump_count,
            "xJumpSpeed": world.jump_vx,
            "yJumpSpeed": world.jump_vy,
            "canShoot": world.may_fire,
            "facing": mario.facing,
            "height": mario.height,
            "powerUpTime": world.change_timer,
            "invulnerableTime": world.safe_timer,
            "deathTime": world.death_timer,
            "winTime": world.win_timer,
            "carrying": world.carrying > 0,
        },
        "sprites": [_sprite(world.actors[slot]) for slot in world.order[: world.listed]],
    }


def _place(actor: Actor) -> Line:
    return {"x": actor.x, "y": actor.y, "xa": actor.vx, "ya": actor.vy}


def _sprite(actor: Actor) -> Line:
    walker = {"onGround": actor.grounded, "facing": actor.facing}
    mortal = {**walker, "deadTime": actor.dead_timer}
    enemy = {**mortal, "type": actor.kind - 1, "flyDeath": actor.flung, "winged": actor.winged}
    if actor.kind < PLANT:
        own = {"cls": "Enemy", **enemy}
    else:
        own = {
            PLANT: {"cls": "FlowerEnemy", **enemy, "jumpTime": actor.age, "yStart": 16 * int(actor.row) + 24},
            MUSHROOM: {"cls": "Mushroom", **walker, "life": actor.age},
            FLOWER: {"cls": "FireFlower", "life": actor.age},
            FIREBALL: {"cls": "Fireball", **mortal, "dead": actor.dead},
            SHELL: {"cls": "Shell", **mortal, "dead": actor.dead, "carried": actor.carried},
        }[actor.kind]
    return _place(actor) | own


def main() -> None:
    ticks, steps = (frozenset(runs.split(",")) for runs in sys.argv[1:])
    result = {"ticks": check_ticks("ticks", ticks), "steps": check_runs("episodes", steps)}
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()

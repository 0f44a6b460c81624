"""Every field of a game, with its unit. A game is a record of `WORLD` and the level that it is played on.

Play never changes a level, a record of `LEVEL`, so games may share one. Used blocks, taken coins and dead
enemies are in the game's record, one bit for each cell. Copying the record copies the game.

`World`, `LevelMap` and `Actor` name the fields and their types, once, for the type checker and for the layout
of the records. The rules take records; compiled or not, `world.coins` reads and writes their memory.

Units: pixels (16 to a tile; x to the right, y downwards), pixels per tick, ticks (5 to a step).
"""

from __future__ import annotations

import typing
from typing import Annotated, Any, Final, Protocol, SupportsIndex

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import jit

COLUMNS: Final = 2050
"""The widest level, in tiles."""
ROWS: Final = 15
"""The height of every level, in tiles."""
ACTORS: Final = 256
"""Maximum number of actors, including Mario. The original has no such bound; see `add_actor`."""
TICKS_PER_ACTION: Final = 5

# Kinds of actors, as in observations, except Mario, whose number there depends on his size.
FREE: Final = 0
RED_KOOPA: Final = 1
GREEN_KOOPA: Final = 2
GOOMBA: Final = 3
SPIKY: Final = 4
PLANT: Final = 5
MUSHROOM: Final = 6
FLOWER: Final = 7
FIREBALL: Final = 8
SHELL: Final = 9
MARIO: Final = 10

# A spawn point: the kind of its enemy, and a bit.
SPAWN_KIND: Final = 7
SPAWN_WINGED: Final = 8

Flag = Annotated[bool, np.int8]
Tiny = Annotated[int, np.int8]
Short = Annotated[int, np.int16]
Int = Annotated[int, np.int32]
Long = Annotated[int, np.int64]
Single = Annotated[np.float32, np.float32]
Double = Annotated[float, np.float64]


class Actor:
    """Mario, an enemy, an item, a shell or a fireball."""

    kind: Tiny
    x: Single  # of the middle of its feet
    y: Single  # of its feet
    vx: Single
    vy: Single
    old_x: Single  # its position before the last update
    old_y: Single
    facing: Tiny  # -1 left, 1 right, 0 a shell at rest
    height: Tiny  # pixels
    grounded: Flag
    winged: Flag
    flung: Flag  # dead, and flying off
    dead: Flag  # of a shell or fireball
    carried: Flag  # of a shell
    dead_timer: Tiny  # ticks until it is removed
    age: Short  # of an item: pixels risen; of a plant: ticks in its pipe, 32767 for more
    column: Short  # its spawn point
    row: Tiny
    queued: Flag  # a shell or fireball to be tested against the others in this tick
    leaving: Flag  # to be removed at the end of this tick


class Actors(Protocol):
    """An array of actors."""

    def __getitem__(self, slot: SupportsIndex) -> Actor: ...

    def __len__(self) -> int: ...


class LevelMap:
    """A level as it was generated, and its parameters."""

    seed: Long
    type: Int
    difficulty: Int
    columns: Int  # tiles
    exit_x: Int  # the column that Mario must pass
    exit_y: Int  # the row of the ground there
    tiles: Annotated[npt.NDArray[np.uint8], np.uint8, (COLUMNS, ROWS)]  # write them with `set_tile`
    cells: Annotated[npt.NDArray[np.int64], np.int64, (COLUMNS,)]  # four bits for each row: see `cells_at`
    bumpable: Annotated[npt.NDArray[np.uint16], np.uint16, (COLUMNS,)]  # a bit for each row, as in `changed`
    spawns: Annotated[npt.NDArray[np.uint8], np.uint8, (COLUMNS, ROWS)]  # then call `write_cells`
    spawning: Annotated[npt.NDArray[np.uint16], np.uint16, (COLUMNS,)]  # a bit for each row with a spawn


class World:
    """A game: the task, the state kept between episodes, and the episode."""

    # The task. Units and ranges are given with the options of env_server.mario.environment.
    level_seed: Long
    level_type: Int
    level_difficulty: Int
    level_width: Int
    max_trial_steps: Int
    reward_goal: Double
    reward_death: Double
    reward_step: Double
    reward_coin: Double
    reward_kill: Double
    speed_walk: Double
    speed_run: Double
    speed_jump: Double
    speed_slidejump: Double
    accel_fall: Double
    jump_time: Int
    slidejump_time: Int
    start_ticks: Int
    alpha: Single
    draws_at_checkins: Flag  # instead of after every tick
    velocity_of_jar: Flag

    # Kept between episodes.
    button_left: Flag
    button_right: Flag
    button_jump: Flag
    button_run: Flag
    started: Flag  # whether an episode has begun before

    # The changes of the level in play: for each column, a bit for each row, the lowest for the highest row.
    changed: Annotated[npt.NDArray[np.uint16], np.uint16, (COLUMNS,)]  # tiles
    dead: Annotated[npt.NDArray[np.uint16], np.uint16, (COLUMNS,)]  # spawn points whose enemy is dead

    # The episode.
    playing: Flag
    steps: Int
    coins: Int
    kills: Int
    paid: Double  # the total of all rewards up to the last check-in
    direction: Int  # the current action
    jump: Int
    run: Int
    drawn_camera: Int  # pixels; of the last draw
    camera: Single
    tick_count: Int  # ticks that were not frozen
    frozen: Flag
    scanned_from: Int  # the columns whose spawn points were in sight in the last unfrozen tick,
    scanned_to: Int  # ends included
    fireballs_seen: Int

    # Mario's own fields.
    large: Flag
    fire: Flag
    new_large: Flag  # after the size change under way
    new_fire: Flag
    last_large: Flag  # before that change
    last_fire: Flag
    was_grounded: Flag
    wall_slide: Flag
    may_jump: Flag
    may_fire: Flag
    jump_count: Int
    jump_vx: Single
    jump_vy: Single
    change_timer: Int  # ticks; negative while shrinking
    safe_timer: Int
    death_timer: Int
    win_timer: Int
    carrying: Int  # the slot of a shell, or 0

    # The actors: Mario in slot 0, the others in any slot; the list has their order.
    actors: Annotated[Actors, "Actor", (ACTORS + 1,)]
    listed: Int  # length of the list, without Mario, who always comes last
    order: Annotated[npt.NDArray[np.uint8], np.uint8, (ACTORS,)]  # slots
    added: Int  # number of actors to be listed at the end of the tick
    waiting: Annotated[npt.NDArray[np.uint8], np.uint8, (ACTORS,)]  # slots


Worlds = npt.NDArray[np.void]
"""Games, shape (N,), of dtype `WORLD`."""
Levels = npt.NDArray[np.void]
"""Levels, shape (N,), of dtype `LEVEL`."""


def _record(fields: type) -> np.dtype[np.void]:
    """Return the record layout of an annotated class.

    Single numbers come after the actors and before the long arrays, so that those of a step share a few cache
    lines; the widest come first, so that all are aligned.
    """
    layout: list[tuple[Any, ...]] = []
    for name, hint in typing.get_type_hints(fields, include_extras=True).items():
        kind, *shape = hint.__metadata__
        layout.append((name, _ACTOR if kind == "Actor" else np.dtype(kind), *shape))
    layout.sort(key=lambda field: (field[1].fields is None, len(field), -_width(field[1])))
    return np.dtype((np.record, np.dtype(layout, align=True)))


def _width(dtype: np.dtype[Any]) -> int:
    """Return the size of the widest number in `dtype`, in bytes."""
    return max(_width(part) for part, *_ in dtype.fields.values()) if dtype.fields else dtype.itemsize


_ACTOR: Final = _record(Actor)
LEVEL: Final = _record(LevelMap)
WORLD: Final = _record(World)


@jit
def add_actor(world: World, kind: int, x: np.float32, y: np.float32, facing: int, height: int) -> Actor:
    """Return a new actor, which is put in front of the list at the end of the tick.

    If all slots are in use, the actor gets a spare one and is never listed. No level seen so far needs a
    quarter of the slots.
    """
    slot = 1
    while slot < ACTORS and world.actors[slot].kind != FREE:
        slot += 1
    if slot < ACTORS:
        world.waiting[world.added] = slot
        world.added += 1
    actor = world.actors[slot]
    fill_actor(actor, kind, x, y, facing, height)
    return actor


@jit
def fill_actor(actor: Actor, kind: int, x: np.float32, y: np.float32, facing: int, height: int) -> None:
    """Write every field of a new actor, at rest."""
    actor.kind = kind
    actor.x = x
    actor.y = y
    actor.vx = np.float32(0)
    actor.vy = np.float32(0)
    actor.old_x = x
    actor.old_y = y
    actor.facing = facing
    actor.height = height
    actor.grounded = False
    actor.winged = False
    actor.flung = False
    actor.dead = False
    actor.carried = False
    actor.dead_timer = 0
    actor.age = 0
    actor.column = -1
    actor.row = -1
    actor.queued = False
    actor.leaving = False

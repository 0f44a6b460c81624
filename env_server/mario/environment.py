"""Infinite Mario of the RL-Competition 2009 as an RL-Glue environment.

An action is three ints: direction (-1 left, 0 neither, 1 right), jump and run (0 or 1). It holds for
five ticks of the game. The observation is described in `env_server.mario.observation`.

Messages that `env_message` answers:

    parameters                       every parameter in force, as JSON
    level                            level_seed=121 level_type=0 level_difficulty=0
    level level_seed=7 level_type=1  change these from the next episode on; answers like `level`

A level that is read from a file cannot be changed, and `level` answers level_digest=SHA-256.

With the option `extras`, each observation has extras, which agents do not see:

    coins, kills   since the beginning of the episode
    distance       of Mario from the left end of the level, in tiles
    death          enemy, fall or time (of the step limit); empty while he lives, and at the goal
    mode           small, large or fire

docs/mario.md is for authors of agents.
Source: RL-Competition 2009; Mohan (2010), appendix A.

The state of Infinite Mario that outlives an episode, as `env_save` returns it.

It consists of the level, the four buttons at the end of the last episode, and whether an episode has begun.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from decimal import Decimal
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from env_server.mario import parameters as tasks
from env_server.mario.game import Game
from env_server.mario.parameters import Parameters, resolve
from env_server.mario.pictures import read_picture, write_picture
from env_server.mario.sim.state import ROWS
from glue.console import did_you_mean
from glue.errors import ConfigError, SaveError, SimulatorError
from glue.options import Value, parameters, parse_assignments
from glue.roles import Environment
from glue.saves import Arrays, Saved, is_packed, pack, unpack
from glue.types import Action, Observation, Step

_NAME: Final = "mario"

# Earlier versions saved this record and a CRC-32 of it.
_OLD: Final = struct.Struct("<8sqii5?")
_OLD_CHECKSUM: Final = struct.Struct("<I")
_OLD_MAGIC: Final = b"mario\0\0\1"


class State(NamedTuple):
    """The level's seed, type and difficulty; left, right, jump and run; whether an episode has begun."""

    level: tuple[int, ...]
    buttons: tuple[bool, ...]
    started: bool


def pack_state(state: State) -> bytes:
    """Return `state` as bytes."""
    arrays: Arrays = {"level": np.array(state.level, np.int64), "buttons": np.array(state.buttons, np.int8)}
    return pack(Saved(_NAME, {}, {"started": int(state.started)}, arrays))


def unpack_state(data: bytes) -> State:
    """Return the state that `pack_state` packed; the level's numbers are not checked yet.

    Raises:
        SaveError: `data` is damaged, of another environment or of another version.
    """
    return _unpack(data) if is_packed(data) else _unpack_old(data)


def _unpack(data: bytes) -> State:
    saved = unpack(data, _NAME, {})
    level, buttons = saved.array("level", np.int64), saved.array("buttons", np.int8, low=0, high=1)
    if len(level) != 3 or len(buttons) != 4:
        raise SaveError(f"saved {_NAME}: a level is 3 numbers and there are 4 buttons")
    started = saved.number("started", high=1)
    return State(tuple(level.tolist()), tuple(map(bool, buttons)), bool(started))


def _unpack_old(data: bytes) -> State:
    record, checksum = data[: _OLD.size], data[_OLD.size :]
    if len(record) != _OLD.size or checksum != _OLD_CHECKSUM.pack(zlib.crc32(record)):
        raise SaveError(f"these {len(data)} bytes are not a whole save of {_NAME}")
    magic, seed, kind, difficulty, *buttons, started = _OLD.unpack(record)
    if magic != _OLD_MAGIC:
        raise SaveError(f"this is not a save of {_NAME}: it is marked {magic!r}")
    return State((seed, kind, difficulty), tuple(buttons), started)


_LEVEL: Final = ("level_seed", "level_type", "level_difficulty")
_IN_A_FILE: Final = (*_LEVEL, "level_width")
_BUTTONS: Final = ("button_left", "button_right", "button_jump", "button_run")
_ACTIONS: Final = {Action(ints=buttons).body: buttons for buttons in product((-1, 0, 1), (0, 1), (0, 1))}
"""Every legal action, by its bytes; looking up an action also checks it."""
_TILE: Final = 16  # pixels
_FIELDS: Final = [
    "coins", "kills", "large", "fire", "steps", "max_trial_steps", "death_timer", "win_timer",
]  # fmt: skip
_DIMENSIONS: Final = (("direction", -1, 1), ("jump", 0, 1), ("run", 0, 1))


class InfiniteMario(Environment):
    """Infinite Mario of the RL-Competition 2009.

    The task is a published instance or MDP; explicit parameters override its own. docs/mario.md and
    `glue-env mario --help` list the options, which are the fields of `Options`. A small session:

        mario = InfiniteMario(level_seed=7, level_difficulty=1)
        task_spec = mario.env_init()
        observation = mario.env_start()
        step = mario.env_step(Action(ints=[1, 0, 1]))

    Raises:
        SimulatorError: an option is unknown or out of bounds, or two contradict each other.
        ConfigError: the file of a level holds none.
    """

    Options: ClassVar[type] = tasks.Options

    def __init__(self, **options: Value | None) -> None:
        self.env_extras: bool = _check({"extras": options.pop("extras", None) or False})["extras"]
        self._task = check_parameters(options)
        self._parameters = self._task
        self._game: Game | None = None

    @property
    def parameters(self) -> Parameters:
        """Every parameter in force; those of the level are for the next episode."""
        return self._parameters

    @property
    def game(self) -> Game:
        """The game being played, for inspection or cloning.

        Raises:
            SimulatorError: env_init has not been called yet.
        """
        if self._game is None:
            raise SimulatorError("there is no game yet: call env_init first")
        return self._game

    @property
    def buttons(self) -> tuple[bool, ...]:
        """Whether left, right, jump and run are held when the next episode's first tick begins.

        They stay as the last episode left them; in a fresh game none is held.

        Raises:
            SimulatorError: env_init has not been called yet.
        """
        world = self.game.world
        return tuple(bool(getattr(world, name)) for name in _BUTTONS)

    @buttons.setter
    def buttons(self, held: tuple[bool, ...]) -> None:
        for name, is_held in zip(_BUTTONS, held, strict=True):
            setattr(self.game.world, name, is_held)

    def env_init(self) -> str:
        """Make a fresh game; return the task spec."""
        self._game = Game(self._parameters)
        low, high = map(_java_double, self._parameters.rewards)
        return (
            "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
            f"ACTIONS INTS (-1 1) (2 0 1)  REWARDS ({low} {high})"
        )

    def env_start(self) -> Observation:
        """Rebuild the level and return the first observation.

        Raises:
            SimulatorError: env_init has not been called yet.
        """
        return self._shown(self.game.start())

    def env_step(self, action: Action) -> Step:
        """Hold the buttons of `action` for five ticks.

        Raises:
            SimulatorError: the action is out of bounds or misshapen, or no episode is being played.
        """
        reward, observation, terminal = self.game.step(*self.buttons_of(action))
        return Step(reward, self._shown(observation), terminal)

    @staticmethod
    def buttons_of(action: Action) -> tuple[int, int, int]:
        """Return direction, jump and run of an action.

        Raises:
            SimulatorError: `action` is out of bounds or misshapen.
        """
        buttons = _ACTIONS.get(action.body)
        if buttons is None:
            raise SimulatorError(_what_is_wrong_with(action))
        return buttons

    def env_cleanup(self) -> None:
        """Release the game, and any level that a message asked for."""
        self._game = None
        self._parameters = self._task

    def env_message(self, message: str) -> str:
        """Answer one of the messages at the top of this module; otherwise list them."""
        question, *assignments = message.split() or [""]
        picture = self._parameters.level
        if question == "parameters" and not assignments:
            return json.dumps(asdict(self._parameters) | {"level": picture and picture.sha256})
        if question == "level":
            try:
                level = parse_assignments(InfiniteMario, assignments)
                if other := next((name for name in level if name not in _LEVEL), None):
                    known = ", ".join(_LEVEL)
                    return f"refused: a message changes {known}; {other} is fixed when Mario is made"
                self._change_level(level)
            except ConfigError as error:
                return f"refused: {error}"
            if picture is not None:
                return f"level_digest={picture.sha256}"
            return " ".join(f"{name}={getattr(self._parameters, name)}" for name in _LEVEL)
        return (
            f"refused: {message!r} is not a message of Mario's; these are: parameters, level, "
            "level level_seed=N level_type=N level_difficulty=N"
        )

    def env_save(self) -> bytes:
        """Return the state on which later episodes depend: level, last buttons, and whether any began."""
        return pack_state(State(self._level, self.buttons, bool(self.game.world.started)))

    def env_load(self, data: bytes) -> None:
        """Continue from a state that `env_save` returned.

        Raises:
            SaveError: `data` is damaged, of another environment or of another version.
        """
        state = unpack_state(data)
        level = dict(zip(_LEVEL, state.level, strict=True))
        if state.level != self._level:
            try:
                self._change_level(_check(level))
            except (ConfigError, SimulatorError) as error:
                raise SaveError(f"saved mario: {error}") from None
        self.buttons = state.buttons
        self.game.world.started = state.started

    def level_template(self, seed: int) -> str:
        """Return the level of a seed, with the other options of this environment, as a text picture.

        Raises:
            SimulatorError: the seed is out of bounds, or the level is that of a file.
        """
        if self._task.level is not None:
            raise SimulatorError("a template is made from a seed: leave out the file of a level")
        game = Game(replace(self._task, **_check({"level_seed": seed})))
        game.start()
        return write_picture(game.level_map)

    def _shown(self, observation: Observation) -> Observation:
        if not self.env_extras:
            return observation
        parts = observation.ints, observation.doubles, observation.chars
        return Observation(*parts, extras=_extras(self.game.world))

    @property
    def _level(self) -> tuple[int, ...]:
        return tuple(getattr(self._parameters, name) for name in _LEVEL)

    def _change_level(self, level: dict[str, Any]) -> None:
        if level and self._parameters.level is not None:
            raise ConfigError("the level is that of a file, which is fixed when Mario is made")
        self._parameters = replace(self._parameters, **level)
        if self._game is not None:
            self._game.set_task(self._parameters)


def check_parameters(options: Mapping[str, Any]) -> Parameters:
    """Return the task that options of `InfiniteMario`, given by name, describe.

    Raises:
        SimulatorError: an option is unknown or out of bounds, or two contradict each other.
        ConfigError: the file of a level holds none.
    """
    given = _check({name: value for name, value in options.items() if value is not None})
    if "extras" in given:
        raise SimulatorError("only the environment mario itself has extras: leave out extras")
    instance, mdp = given.pop("instance", 0), given.pop("mdp", None)
    if instance and mdp:
        raise SimulatorError(f"instance {instance} and mdp {mdp} are two tasks: leave out one")
    path, digest = given.pop("level", None), given.pop("level_digest", None)
    if path is not None:
        for name in _IN_A_FILE:
            if name in given:
                raise SimulatorError(f"level {path} is a whole level: leave out {name}")
        picture = read_picture(Path(path), digest)
        given |= {"level": picture, **picture.parameters}
    elif digest is not None:
        raise SimulatorError("level_digest is of the file of a level: give level, too")
    return resolve(given, instance=instance, mdp=mdp)


def _check(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters by name, each within its bounds."""
    known = parameters(InfiniteMario)
    for name in values:
        if name not in known:
            raise SimulatorError(f"InfiniteMario has no option {name}{did_you_mean(name, known)}")
    try:
        checked = {name: known[name].check(value) for name, value in values.items()}
    except ConfigError as error:
        raise SimulatorError(str(error)) from None
    if checked.get("start_ticks", 5) not in (5, 10):
        raise SimulatorError(f"option start_ticks must be 5 or 10 ticks, not {checked['start_ticks']}")
    return checked


def _extras(world: Any) -> dict[str, int | float | str]:
    # Many fields at once: one by one, as attributes of the record, they take five times as long.
    coins, kills, large, fire, steps, limit, dying, winning = world[_FIELDS].item()
    mario = world["actors"][0]
    death = ""
    if dying and not winning:
        fallen = mario["y"] > _TILE * (ROWS + 1)
        death = "time" if steps >= limit else "fall" if fallen else "enemy"
    return {
        "coins": coins,
        "kills": kills,
        "distance": float(mario["x"]) / _TILE,
        "death": death,
        "mode": "fire" if fire else "large" if large else "small",
    }


def _what_is_wrong_with(action: Action) -> str:
    ints, doubles, chars = action.counts
    if (ints, doubles, chars) != (3, 0, 0):
        return (
            "an action of Mario's is 3 ints (direction, jump, run), no doubles and no chars; "
            f"received {ints} ints, {doubles} doubles and {chars} chars"
        )
    return "; ".join(
        f"{name} must be from {low} to {high}, not {value}"
        for (name, low, high), value in zip(_DIMENSIONS, action.ints.tolist(), strict=True)
        if not low <= value <= high
    )


def _java_double(value: float) -> str:
    """Return `value` as Java prints a double: with an exponent below 0.001 and from ten million on."""
    if value == 0 or 1e-3 <= abs(value) < 1e7:
        return repr(value)
    sign, digits, exponent = Decimal(repr(value)).normalize().as_tuple()
    first, *others = map(str, digits)
    return f"{'-' * sign}{first}.{''.join(others) or '0'}E{int(exponent) + len(others)}"

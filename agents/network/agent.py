"""The agent that plays only by a network, in NumPy, from the current observation.

`studies/ppo.py` and `studies/imitation.py` in the repository write its files.

The inputs of a network: the tiles around Mario, the nearest sprites, Mario and his last actions.

They are made from the view `tiles` of docs/gymnasium.md.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import ACTIONS, NUM_ACTIONS, MarioAgent, legal_actions
from agents.mario.observation import COLUMNS, ROWS, decode
from glue.compiled.jit import entry
from glue.errors import ConfigError
from glue.files import open_regular
from glue.options import Option
from glue.saves import pack_generator, unpack_generator
from glue.types import Action, Observation

Reals = npt.NDArray[np.float32]

RECENT: Final = 5
"""Number of the last actions among the inputs; they tell how long the buttons have been held."""
NONE: Final = NUM_ACTIONS
"""The number of a missing action, at the beginning of an episode."""

_MIDDLE: Final = 10  # Mario's column when he cannot be seen: above the screen
_HEIGHT: Final = 16  # rows around Mario
_ABOVE: Final = 9  # of them above him
_WIDTH: Final = 15  # columns around Mario
_BEHIND: Final = 3  # of them behind him
_LOWEST: Final = 14  # rows below it are a pit, or show the lowest row again
_GOAL_ROW: Final = 1  # the goal's column is shown in all rows
_OTHERS: Final = 6
_KINDS: Final = 9
_NUMBERS: Final = 4  # of a sprite: place and velocity
_LARGE: Final = 10  # Mario's kinds
_WITH_FIRE: Final = 11
_NEAR: Final = np.float32(0.2)  # 1 / tiles

_MOST_BYTES: Final = 2**28  # of a file, and of what it unpacks to

_SOLID: Final = np.isin(np.arange(11), [2, 4, 5, 6, 7])
_LEDGE: Final = np.isin(np.arange(11), [1, 3])
_GOAL: Final = 9

_AT_LEDGES: Final = _HEIGHT * _WIDTH
_AT_GOAL: Final = 2 * _AT_LEDGES
_AT_ROW: Final = _AT_GOAL + _WIDTH
_AT_PITS: Final = _AT_ROW + ROWS
_AT_KINDS: Final = _AT_PITS + _HEIGHT
_AT_FLAGS: Final = _AT_KINDS + _OTHERS * _KINDS  # present, winged
_AT_OTHERS: Final = _AT_FLAGS + _OTHERS * 2
_AT_MARIO: Final = _AT_OTHERS + _OTHERS * _NUMBERS
_AT_ACTIONS: Final = _AT_MARIO + 2 + _NUMBERS

FEATURES: Final = _AT_ACTIONS + RECENT * NUM_ACTIONS
"""The number of inputs."""
MARIO: Final = 10
"""The number of the tile where Mario is."""
_CODES: Final = np.zeros(256, np.uint8)


def features(tiles: npt.NDArray[np.uint8], sprites: Reals, recent: npt.NDArray[np.int64]) -> Reals:
    """Return the network's input, shape (N, FEATURES).

    Args:
        tiles, sprites: the view `tiles` of N games, shapes (N, 16, 21) and (N, 16, 7).
        recent: the numbers of the last actions, the newest first, shape (N, RECENT).
    """
    seen = np.zeros((len(tiles), FEATURES), np.float32)
    _write(tiles, sprites, recent, seen)
    return seen


@entry
def _write(tiles: npt.NDArray[np.uint8], sprites: Reals, recent: npt.NDArray[np.int64], seen: Reals) -> None:
    """Write the inputs of N games to `seen`, which holds zeros."""
    for game in range(len(tiles)):
        to = seen[game]
        row, column = 0, _MIDDLE
        for cell in range(ROWS * COLUMNS):
            if tiles[game, cell // COLUMNS, cell % COLUMNS] == MARIO:
                row, column = cell // COLUMNS, cell % COLUMNS
                break
        to[_AT_ROW + row] = 1
        for i in range(_HEIGHT):
            from_row = row + i - _ABOVE
            to[_AT_PITS + i] = from_row > _LOWEST
            for j in range(_WIDTH if 0 <= from_row < ROWS else 0):
                tile = tiles[game, from_row, min(max(column + j - _BEHIND, 0), COLUMNS - 1)]
                to[i * _WIDTH + j] = _SOLID[tile]
                to[_AT_LEDGES + i * _WIDTH + j] = _LEDGE[tile]
        for j in range(_WIDTH):
            tile = tiles[game, _GOAL_ROW, min(max(column + j - _BEHIND, 0), COLUMNS - 1)]
            to[_AT_GOAL + j] = tile == _GOAL
        for j in range(_OTHERS):
            sprite = sprites[game, 1 + j]
            if 1 <= sprite[1] <= _KINDS:
                to[_AT_KINDS + j * _KINDS + int(sprite[1]) - 1] = 1
            to[_AT_FLAGS + 2 * j] = sprite[0]
            to[_AT_FLAGS + 2 * j + 1] = sprite[2]
            for k in range(_NUMBERS):
                to[_AT_OTHERS + j * _NUMBERS + k] = sprite[3 + k] * _NEAR
        mario = sprites[game, 0]
        to[_AT_MARIO] = mario[1] == _LARGE
        to[_AT_MARIO + 1] = mario[1] == _WITH_FIRE
        to[_AT_MARIO + 2 : _AT_ACTIONS] = mario[3:]
        for j in range(RECENT):
            if recent[game, j] != NONE:
                to[_AT_ACTIONS + j * NUM_ACTIONS + recent[game, j]] = 1


def remember(recent: npt.NDArray[np.int64], actions: npt.NDArray[np.int64] | int) -> None:
    """Make `actions`, one for each of N games, the newest in `recent`, shape (N, RECENT)."""
    recent[:, 1:] = recent[:, :-1].copy()
    recent[:, 0] = actions


_CODES[list(b" 1237b?|$!M")] = np.arange(11)


def tiles_and_sprites(observation: Observation) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Return the tiles, shape (1, 16, 21), and the sprites, shape (1, 16, 7).

    Raises:
        RemoteProtocolError: the observation is not one of Infinite Mario.
    """
    seen = decode(observation)
    tiles = _CODES[np.frombuffer(seen.chars, np.uint8)].reshape(1, ROWS, COLUMNS + 1)[:, :, :COLUMNS]
    places = np.array(seen.doubles).reshape(-1, 4)
    rows: Any = np.column_stack([np.ones(len(places)), seen.kinds, seen.winged, places])
    rows[0, 3:5] -= np.floor(rows[0, 3:5])
    rows[1:, 3:5] -= places[0, :2]
    nearest = np.argsort(np.hypot(rows[1:, 3], rows[1:, 4]), kind="stable")
    rows[1:] = rows[1:][nearest]
    sprites = np.zeros((1, 16, 7), np.float32)
    sprites[0, : len(rows)] = rows[:16]
    return tiles, sprites


_SHIPPED: Final = str(Path(__file__).with_name("policy.npz"))
WIDTHS: Final = (256, 128)
"""Widths of the hidden layers of a network in training."""
LAYERS: Final = len(WIDTHS) + 1


class NetworkAgent(MarioAgent):
    """A trained network: each action is drawn from the softmax of its preferences.

    Args:
        policy: the file of the network; by default the installed one, whose training docs/generalisation.md
            describes.
        greedy: whether to take the preferred action instead.

    Raises:
        ConfigError: the file is missing, or holds no such network.
    """

    name: ClassVar[str] = "network"
    agent_masks = True

    def __init__(
        self,
        *,
        policy: Annotated[str, Option("file of the network, instead of the one that is installed")] = "",
        greedy: Annotated[bool, Option("take the preferred action, instead of drawing one")] = False,
    ) -> None:
        super().__init__(None)
        self._network = load(policy or _SHIPPED)
        self._greedy = greedy
        self._reset()

    def _reset(self) -> None:
        self._recent = np.full((1, RECENT), NONE, np.int64)
        self._generator = np.random.default_rng(self._seed)

    def agent_start(self, observation: Observation) -> Action:
        self._recent[:] = NONE
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def agent_save(self) -> bytes:
        """Return the state of the generator; the network does not change."""
        return pack_generator(self.name, self._generator)

    def agent_load(self, data: bytes) -> None:
        """Continue with the draws of a saved agent.

        Raises:
            SaveError: `data` is damaged, or of another agent.
        """
        self._generator = unpack_generator(data, self.name)

    def _act(self, observation: Observation) -> Action:
        seen = features(*tiles_and_sprites(observation), self._recent)
        preferred = preferences(self._network, seen)[0]
        if not self._greedy:
            # The largest after adding Gumbel noise is a draw from the softmax.
            preferred = preferred + self._generator.gumbel(size=NUM_ACTIONS)
        if observation.packed_mask:
            preferred = np.where(legal_actions(observation), preferred, -np.inf)
        action = int(preferred.argmax())
        remember(self._recent, action)
        return ACTIONS[action]


Network = Mapping[str, Reals]
"""The weights (inputs, outputs) and biases (outputs,) of each layer: `weight0`, `bias0`, and so on."""


def preferences(network: Network, seen: Reals) -> Reals:
    """Return the preference of each action, shape (N, 12), for the inputs `seen`, shape (N, FEATURES)."""
    for layer in range(LAYERS):
        seen = seen @ network[f"weight{layer}"] + network[f"bias{layer}"]
        if layer < LAYERS - 1:
            seen = np.maximum(seen, 0)
    return seen


def save(network: Network, path: str) -> None:
    """Write a network in half precision; nothing in the file is executed when it is read."""
    halves: dict[str, Any] = {name: weights.astype(np.float16) for name, weights in network.items()}
    np.savez_compressed(path, **halves)


def load(path: str) -> Network:
    """Read a network.

    Raises:
        ConfigError: the file is missing, or holds no such network.
    """
    network: dict[str, Reals] = {}
    try:
        with open_regular(Path(path), most=_MOST_BYTES, follow=True) as file:
            if (size := sum(member.file_size for member in zipfile.ZipFile(file).infolist())) > _MOST_BYTES:
                raise ValueError(f"it unpacks to {size:,} bytes, and a network has at most {_MOST_BYTES:,}")
            file.seek(0)
            saved = np.load(file, allow_pickle=False)
            width = FEATURES
            for layer in range(LAYERS):
                weight, bias = _checked(saved[f"weight{layer}"]), _checked(saved[f"bias{layer}"])
                if weight.shape != (width, len(bias)):
                    raise ValueError(f"layer {layer} has weights {weight.shape}, not {(width, len(bias))}")
                network |= {f"weight{layer}": weight, f"bias{layer}": bias}
                width = len(bias)
        if width != NUM_ACTIONS:
            raise ValueError(f"it has {width} outputs, not {NUM_ACTIONS}")
    except Exception as error:  # of any kind: NumPy and zipfile raise many for a damaged file
        raise ConfigError(
            f"policy is not the file of a network for the agent network: {path!r}: {error}"
        ) from None
    return network


def _checked(array: npt.NDArray[np.float32]) -> Reals:
    if array.dtype not in (np.float16, np.float32) or not np.isfinite(array).all():
        raise ValueError("its numbers are not finite single or half precision")
    return array.astype(np.float32)

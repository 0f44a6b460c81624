"""Infinite Mario on the input link: Mario, the monsters, and the tiles in their columns.

    (<input-link> ^mario <m> ^monster <n> ... ^column <c> ...)
    (<m> ^type small ^column 12 ^row 3 ^x 12.4 ^y 3.0 ^speed-x 0.6 ^speed-y 0.0)
    (<n> ^id 7 ^place 0 ^type goomba ^winged no ^x 15.1 ^y 3.0 ^speed-x -0.35 ^speed-y 0.0)
    (<c> ^number 15 ^left <b> ^tile <t> ...)     the column to the left, if in view
    (<t> ^type coin ^row 5)                      blanks are left out, and so is the tile that Mario hides

Positions and rows are those of `agents.mario.observation`, including Mario's column and row. A
monster is any sprite except Mario. It keeps its id as long as the sprites up to its place in the
observation are of the same kinds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from agents.mario import observation as mario
from agents.mario.agent import ACTIONS, LEFT, RIGHT, STAY, action_number
from agents.soar.kernel import Element, Kernel, SoarError, SoarLink
from glue.taskspec import TaskSpec
from glue.types import Action, Observation

SPRITES: Final = {
    0: "small",
    10: "big",
    11: "fiery",
    mario.RED_KOOPA: "red-koopa",
    mario.GREEN_KOOPA: "green-koopa",
    mario.GOOMBA: "goomba",
    mario.SPIKEY: "spikey",
    mario.PLANT: "piranha-plant",
    mario.MUSHROOM: "mushroom",
    mario.FIRE_FLOWER: "fire-flower",
    mario.FIREBALL: "fireball",
    mario.SHELL: "shell",
}
"""The names of the kinds of sprites."""

_TILES: Final = {
    mario.COIN: "coin",
    mario.QUESTION: "question",
    mario.BRICK: "brick",
    mario.PIPE: "pipe",
    mario.LEDGE: "ledge",
    mario.SOLID: "solid",
    mario.FINISH: "finish",
}
_YES_NO: Final = ("no", "yes")
_MOTION: Final = ("x", "y", "speed-x", "speed-y")

_DIRECTIONS: Final = {"left": LEFT, "stay": STAY, "right": RIGHT}
_JUMPS: Final = {"no": False, "yes": True}
_SPEEDS: Final = {"low": False, "high": True}
_EMPTY: Final = bytes([mario.BLANK]) * mario.ROWS


@dataclass(slots=True)
class _Sprite:
    """A sprite on the input link: its kind, its numbers, and the elements that may change."""

    element: Element
    kind: int
    winged: bool
    winged_element: Element
    numbers: Sequence[float]
    elements: Sequence[Element]


@dataclass(slots=True)
class _Column:
    """A column on the input link: its link to the left, its tiles from top to bottom, and their elements."""

    element: Element
    left: Element | None
    tiles: bytes
    elements: dict[int, Element]


class MarioLink(SoarLink):
    """Observations of Infinite Mario for Soar, and Soar's keystrokes as actions."""

    def __init__(self, kernel: Kernel, task: TaskSpec) -> None:
        super().__init__(kernel, task)
        self._mario: _Sprite | None = None
        self._square = (0, 0)
        self._square_elements: tuple[Element, Element] | None = None
        self._mario_type: Element = None
        self._monsters: list[_Sprite] = []
        self._columns: dict[int, _Column] = {}
        self._ids = 0

    def action(self, name: str, parameters: Mapping[str, str]) -> Action:
        """Return the action of a command ^keystroke with ^direction, ^jump and ^speed."""
        direction = _DIRECTIONS.get(parameters.get("direction", ""))
        jump = _JUMPS.get(parameters.get("jump", ""))
        fast = _SPEEDS.get(parameters.get("speed", ""))
        if name != "keystroke" or direction is None or jump is None or fast is None:
            shown = " ".join(f"^{key} {value}" for key, value in parameters.items())
            raise SoarError(
                "the output link takes ^keystroke with ^direction left, stay or right, ^jump yes or no and "
                f"^speed high or low; the agent sent ^{name} with {shown or 'nothing'}"
            )
        return ACTIONS[action_number(direction, jump, fast)]

    def _forget(self) -> None:
        self._drop_monsters(0)

    def _put(self, observation: Observation) -> None:
        seen = mario.decode(observation)
        self._put_mario(seen)
        self._put_monsters(seen)
        self._put_columns(seen)

    # Sprites

    def _put_mario(self, seen: mario.Seen) -> None:
        kernel = self._kernel
        numbers = seen.doubles[:4]
        square = int(numbers[0]), int(numbers[1])
        kind = seen.kinds[0]
        if self._mario is None or self._square_elements is None:
            element = kernel.add_identifier(kernel.input, "mario")
            self._mario_type = kernel.add_text(element, "type", SPRITES.get(kind, str(kind)))
            self._square_elements = (
                kernel.add_int(element, "column", square[0]),
                kernel.add_int(element, "row", square[1]),
            )
            self._mario = _Sprite(element, kind, False, None, numbers, self._add_numbers(element, numbers))
        else:
            if kind != self._mario.kind:
                kernel.update(self._mario_type, SPRITES.get(kind, str(kind)))
                self._mario.kind = kind
            for element, now, before in zip(self._square_elements, square, self._square, strict=True):
                if now != before:
                    kernel.update(element, now)
            self._move(self._mario, numbers)
        self._square = square

    def _put_monsters(self, seen: mario.Seen) -> None:
        kinds = seen.kinds[1:]
        known = 0
        while known < min(len(kinds), len(self._monsters)) and kinds[known] == self._monsters[known].kind:
            known += 1
        self._drop_monsters(known)
        for place, kind in enumerate(kinds):
            winged, numbers = seen.winged[place + 1], seen.doubles[4 * place + 4 : 4 * place + 8]
            if place == len(self._monsters):
                self._monsters.append(self._add_monster(place, kind, winged, numbers))
            monster = self._monsters[place]
            self._move(monster, numbers)
            if winged != monster.winged:
                self._kernel.update(monster.winged_element, _YES_NO[winged])
                monster.winged = winged

    def _add_monster(self, place: int, kind: int, winged: bool, numbers: Sequence[float]) -> _Sprite:
        kernel = self._kernel
        self._ids += 1
        element = kernel.add_identifier(kernel.input, "monster")
        kernel.add_int(element, "id", self._ids)
        kernel.add_int(element, "place", place)
        kernel.add_text(element, "type", SPRITES.get(kind, str(kind)))
        wings = kernel.add_text(element, "winged", _YES_NO[winged])
        return _Sprite(element, kind, winged, wings, numbers, self._add_numbers(element, numbers))

    def _drop_monsters(self, first: int) -> None:
        for monster in self._monsters[first:]:
            self._kernel.remove(monster.element)
        del self._monsters[first:]

    def _add_numbers(self, element: Element, numbers: Sequence[float]) -> list[Element]:
        add = self._kernel.add_float
        return [add(element, name, number) for name, number in zip(_MOTION, numbers, strict=True)]

    def _move(self, sprite: _Sprite, numbers: Sequence[float]) -> None:
        for element, now, before in zip(sprite.elements, numbers, sprite.numbers, strict=True):
            if now != before:
                self._kernel.update(element, now)
        sprite.numbers = numbers

    # Tiles

    def _put_columns(self, seen: mario.Seen) -> None:
        first = seen.camera
        for number in [n for n in self._columns if not first <= n < first + mario.COLUMNS]:
            self._drop_column(number)
        for k in range(mario.COLUMNS):
            column = self._columns.get(first + k) or self._add_column(first + k)
            tiles = seen.chars[k :: mario.COLUMNS + 1].replace(bytes([mario.MARIO]), bytes([mario.BLANK]))
            if tiles != column.tiles:
                self._put_tiles(column, tiles)

    def _add_column(self, number: int) -> _Column:
        kernel = self._kernel
        column = _Column(kernel.add_identifier(kernel.input, "column"), None, _EMPTY, {})
        kernel.add_int(column.element, "number", number)
        self._columns[number] = column
        for right in (number, number + 1):
            if right in self._columns and right - 1 in self._columns:
                self._columns[right].left = kernel.add_link(
                    self._columns[right].element, "left", self._columns[right - 1].element
                )
        return column

    def _drop_column(self, number: int) -> None:
        kernel = self._kernel
        right = self._columns.get(number + 1)
        if right is not None and right.left is not None:  # Soar would keep the link, and with it the column
            kernel.remove(right.left)
            right.left = None
        kernel.remove(self._columns.pop(number).element)

    def _put_tiles(self, column: _Column, tiles: bytes) -> None:
        kernel = self._kernel
        for i in range(mario.ROWS):
            if tiles[i] == column.tiles[i]:
                continue
            row = mario.ROWS - 1 - i
            if row in column.elements:
                kernel.remove(column.elements.pop(row))
            if tiles[i] != mario.BLANK:
                element = kernel.add_identifier(column.element, "tile")
                kernel.add_text(element, "type", _TILES.get(tiles[i], str(tiles[i])))
                kernel.add_int(element, "row", row)
                column.elements[row] = element
        column.tiles = tiles

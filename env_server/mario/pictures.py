"""Levels as text pictures: a character for each tile and monster; docs/mario.md describes the notations.

A picture of at most 14 rows that uses only characters of the Video Game Level Corpus is read as one of its
levels; any other in the notation of the Mario AI Framework, with a few more characters for what else the
levels of seeds have. What follows an empty line adds to the picture: `type 1`, or `COLUMN ROW CHARACTER` to
put something into a cell that is taken.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from env_server.mario.sim import state
from env_server.mario.sim import tiles as tile
from env_server.mario.sim.levels import EXTRA_COLUMNS, GROUND_CODES, finish
from glue.compiled.jit import entry
from glue.errors import ConfigError
from glue.files import read_regular

MOST_BYTES: Final = 2**18
"""Maximum size of a file, in bytes."""
_LEAST_COLUMNS: Final = 20  # the window of an observation
_MOST_MONSTERS: Final = 200  # in so many columns, as the simulator has room for 256 actors
_CROWD: Final = 40
_CORPUS_ROWS: Final = 14
_START: Final = 8  # columns in which the start may be marked

_MONSTERS: Final = {
    "r": state.RED_KOOPA,
    "k": state.GREEN_KOOPA,
    "g": state.GOOMBA,
    "E": state.GOOMBA,
    "y": state.SPIKY,
    "P": state.PLANT,
    "R": state.RED_KOOPA | state.SPAWN_WINGED,
    "K": state.GREEN_KOOPA | state.SPAWN_WINGED,
    "G": state.GOOMBA | state.SPAWN_WINGED,
    "Y": state.SPIKY | state.SPAWN_WINGED,
}
_TILES: Final = {
    "-": tile.EMPTY,
    "X": tile.GROUND,
    "#": tile.STAIR,
    "S": tile.BRICK,
    "C": tile.BRICK_WITH_COIN,
    "U": tile.BRICK_WITH_POWER_UP,
    "Q": tile.QUESTION_WITH_COIN,
    "!": tile.QUESTION_WITH_COIN,
    "?": tile.QUESTION_WITH_POWER_UP,
    "@": tile.QUESTION_WITH_POWER_UP,
    "2": tile.HIDDEN_BLOCK,
    "D": tile.USED_BLOCK,
    "o": tile.COIN,
    "<": tile.PIPE_MOUTH,
    ">": tile.PIPE_MOUTH + 1,
    "[": tile.PIPE_SHAFT,
    "]": tile.PIPE_SHAFT + 1,
    "%": tile.HILL_TOP_LEFT + 1,
    "|": tile.HILL_TOP_LEFT + 17,
    # Ours: the ends of hills, above and below, and the ends of tops that another hill overlaps.
    "{": tile.HILL_TOP_LEFT,
    "}": tile.HILL_TOP_RIGHT,
    "(": tile.HILL_TOP_LEFT + 16,
    ")": tile.HILL_TOP_RIGHT + 16,
    "/": tile.OVERLAPPED_LEFT,
    "\\": tile.OVERLAPPED_RIGHT,
}
_CORPUS: Final = {character: _TILES[character] for character in "-XSo<>[]"} | {
    "?": tile.QUESTION_WITH_COIN,
    "Q": tile.USED_BLOCK,
}
_CANNON: Final = "a cannon, and the competition of 2009 had none"
_LACKING: Final = {
    "B": f"{_CANNON} (in older files of the framework a brick, which is S)",
    "b": _CANNON,
    "*": _CANNON,
    "1": "a hidden mushroom that gives a life, which the engine of 2009 does not have",
    "L": "a brick with a mushroom that gives a life, which the engine of 2009 does not have",
}
"""Things that the engine of 2009 lacks, by their character in either notation."""
_PIPE: Final = "tT"
_PIPES: Final = re.compile(f"[{_PIPE}]+")
_MARKS: Final = "MF"  # the start and the goal
_ADDITION: Final = re.compile(r"(\d{1,4}) +(\d{1,2}) +(\S)")
_TYPE: Final = re.compile(r"type +([012])")
_CHARACTERS: Final = {code: character for character, code in reversed(_TILES.items())} | dict.fromkeys(
    GROUND_CODES, "X"
)
_LETTERS: Final = {code: letter for letter, code in reversed(_MONSTERS.items())}


class Picture(NamedTuple):
    """A level that was read from a file.

    Attributes:
        sha256: digest of the file, in hexadecimal.
        type: 0 overground, 1 underground, 2 castle: the look of its ground.
        columns: width in tiles, 20 to 2050.
        goal: the column to pass, and the row of the ground there.
        tiles: the codes of its tiles before its ground gets its look, column by column from the top down.
        spawns: its spawn points, likewise.
    """

    sha256: str
    type: int
    columns: int
    goal: tuple[int, int]
    tiles: bytes
    spawns: bytes

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that stand for this level in a world: no level of a seed has them."""
        seed = int(self.sha256[:15], 16) | 1 << 60
        width = self.columns - EXTRA_COLUMNS
        return {"level_seed": seed, "level_type": self.type, "level_difficulty": 0, "level_width": width}

    def levels(self) -> state.Levels:
        """Return the level as the simulator plays it, shape (1,)."""
        levels = np.zeros(1, state.LEVEL)
        level: state.LevelMap = levels[0]
        level.seed, level.type = self.parameters["level_seed"], self.type
        level.columns, (level.exit_x, level.exit_y) = self.columns, self.goal
        for there, ours in ((level.tiles, self.tiles), (level.spawns, self.spawns)):
            there[: self.columns] = np.frombuffer(ours, np.uint8).reshape(-1, state.ROWS)
        _finish(levels)
        return levels


@entry
def _finish(levels: state.Levels) -> None:
    finish(levels[0])


def read_picture(path: Path, sha256: str | None = None) -> Picture:
    """Return the level in a file.

    Args:
        path: of the file.
        sha256: digest that the file must have; None for any.

    Raises:
        ConfigError: the file cannot be read, has another digest, or holds no level; the message names line
            and column, and what was expected.
    """
    data, found = _contents(path)
    if sha256 not in (None, found):
        raise ConfigError(f"the level {path} has changed: its SHA-256 is {found}, not {sha256}")
    return _Reader(path, data, found).picture()


def digest_of(path: Path) -> str:
    """Return the SHA-256 of the file of a level, in hexadecimal.

    Raises:
        ConfigError: the file cannot be read.
    """
    return _contents(path)[1]


def _contents(path: Path) -> tuple[bytes, str]:
    try:
        data = read_regular(path, MOST_BYTES, follow=True)
    except OSError as error:
        raise ConfigError(f"cannot read the level {path}: {error.strerror or error}") from None
    return data, hashlib.sha256(data).hexdigest()


def write_picture(level: state.LevelMap) -> str:
    """Return a picture of a level, from which `read_picture` returns that level."""
    exit_x, exit_y = int(level.exit_x), int(level.exit_y)
    rows = [["-"] * level.columns for _ in range(state.ROWS)]
    added = [f"type {level.type}"] if level.type else []

    def put(column: int, row: int, character: str) -> None:
        if rows[row][column] == "-":
            rows[row][column] = character
        else:
            added.append(f"{column} {row} {character}")

    for column, row in np.argwhere(level.tiles[: level.columns]).tolist():
        put(column, row, _CHARACTERS[int(level.tiles[column, row])])
    for column, row in np.argwhere(level.spawns[: level.columns]).tolist():
        if level.spawns[column, row] == state.PLANT and rows[row][column] == "<":
            rows[row][column] = "T"
        else:
            put(column, row, _LETTERS[int(level.spawns[column, row])])
    put(exit_x, exit_y - 1, "F")
    picture = ["".join(row) for row in rows]
    return "\n".join([*picture, *([""] if added else []), *added]) + "\n"


def _thin(ground: Any) -> Any:
    """Return which cells of ground belong to no square of four: in the simulator, nothing can stand on them.

    Ground gets its look by such squares, and a tile without that look stops nothing. Beyond its edges a level
    continues as it is there.
    """
    across = np.pad(ground, 1, "edge")
    across = across[1:] & across[:-1]
    squares = across[:, 1:] & across[:, :-1]
    return ground & ~(squares[1:, 1:] | squares[1:, :-1] | squares[:-1, 1:] | squares[:-1, :-1])


class _Reader:
    """Reads one picture; every error names the place."""

    def __init__(self, path: Path, data: bytes, sha256: str) -> None:
        self._path = path
        self._sha256 = sha256
        text = data.decode("utf-8-sig", "replace")
        self._lines = [line.rstrip() for line in text.rstrip().split("\n")]
        self._rows = self._lines[: self._lines.index("") if "" in self._lines else None]
        self._columns = len(self._rows[0]) if self._rows else 0
        before, nul, _ = text.partition("\0")
        if nul:
            column = len(before) - before.rfind("\n") - 1
            raise self._wrong(before.count("\n"), column, "expected plain text, not UTF-16 or the like")
        self._check_size()
        # The cells are made now that their number is checked.
        self._tiles = np.zeros((self._columns, state.ROWS), np.uint8)
        self._spawns = np.zeros((self._columns, state.ROWS), np.uint8)
        self._goal: tuple[int, int] | None = None
        # The columns of parts side by side that lack no half, and begin in an even or odd column.
        self._whole_pipes = np.zeros((2, self._columns), np.bool_)
        for row in self._rows[-state.ROWS :]:
            for parts in _PIPES.finditer(row):
                begin, end = parts.span()
                self._whole_pipes[begin % 2, begin:end] |= (end - begin) % 2 == 0
        added = [match[3] for line in self._lines if (match := _ADDITION.fullmatch(line))]
        used = "".join([*self._rows, *added])
        is_corpus = len(self._rows) <= _CORPUS_ROWS and {*_CORPUS, *"EBb"}.issuperset(used)
        self._notation = "the Video Game Level Corpus" if is_corpus else "the Mario AI Framework"
        self._known_tiles = _CORPUS if is_corpus else _TILES
        self._known = {*_CORPUS, "E"} if is_corpus else {*_TILES, *_MONSTERS, *_PIPE, *_MARKS}

    def picture(self) -> Picture:
        above = len(self._rows) - state.ROWS  # rows above the level; negative: of the level above the picture
        for line, row in enumerate(self._rows):
            for column, character in enumerate(row):
                self._check(line, column, character)
                if line >= above:
                    self._put(line, column, (column, line - above), character)
                elif character != "-":
                    raise self._wrong(line, column, f"expected - in a row above the lowest {state.ROWS}")
        level_type = self._additions()
        self._check_pipes()
        crowds = np.convolve(self._spawns.astype(bool).sum(1), np.ones(_CROWD, np.int64))
        if crowds.max() > _MOST_MONSTERS:
            last = min(int(crowds.argmax()), self._columns - 1)
            most = f"at most {_MOST_MONSTERS} monsters in {_CROWD} columns"
            raise self._wrong(len(self._rows) - 1, last, f"expected {most}, not {crowds.max()}")
        goal = self._goal or (self._columns - 1, state.ROWS - 1)
        self._tiles[_thin(self._tiles == tile.GROUND)] = tile.STAIR
        cells = self._tiles.tobytes(), self._spawns.tobytes()
        return Picture(self._sha256, level_type, self._columns, goal, *cells)

    def _check_size(self) -> None:
        if not _LEAST_COLUMNS <= self._columns <= state.COLUMNS:
            expected = f"expected a picture of {_LEAST_COLUMNS} to {state.COLUMNS} columns"
            blank = "" if self._rows else ": this line is blank, and an empty cell is -"
            raise self._wrong(0, self._columns, f"{expected}, not {self._columns}{blank}")
        for line, row in enumerate(self._rows):
            if len(row) != self._columns:
                column = min(len(row), self._columns)
                raise self._wrong(line, column, f"expected {self._columns} columns, not {len(row)}")

    def _check(self, line: int, column: int, character: str) -> None:
        """Check that the notation has a character, and the engine what it stands for."""
        if character in self._known:
            return
        if character in _LACKING:
            raise self._wrong(line, column, f"{character} is {_LACKING[character]}")
        known = "".join(sorted(self._known))
        raise self._wrong(line, column, f"expected one of {known} ({self._notation}), not {character!r}")

    def _put(self, line: int, column: int, cell: tuple[int, int], character: str) -> None:
        """Put a character into a cell; `line` and `column` are its place in the file."""
        if character == "M":
            if cell[0] >= _START:
                where = f"expected M in the first {_START} columns"
                raise self._wrong(line, column, f"{where}: Mario falls into the third, wherever M stands")
        elif character == "F":
            if self._goal is not None:
                raise self._wrong(line, column, "expected one F, the goal, and this is the second")
            self._goal = cell[0], cell[1] + 1
        elif character in _MONSTERS:
            self._spawns[cell] = _MONSTERS[character]
        elif character in _PIPE:
            self._tiles[cell] = code = self._part(line, column, cell)
            if character == "T" and code == tile.PIPE_MOUTH:
                self._spawns[cell] = state.PLANT
        else:
            self._tiles[cell] = self._known_tiles[character]

    def _part(self, line: int, column: int, cell: tuple[int, int]) -> int:
        """Return the tile of a part of a pipe; parts that stand side by side are pipes of two columns."""
        if column > 0 and self._rows[line][column - 1] in _PIPE:
            is_right = self._tiles[cell[0] - 1, cell[1]] % 2 == 0
        else:
            is_right = self._begins_right(line, column)
        is_shaft = line > 0 and self._rows[line - 1][column] in _PIPE
        return (tile.PIPE_SHAFT if is_shaft else tile.PIPE_MOUTH) + int(is_right)

    def _begins_right(self, line: int, begin: int) -> bool:
        """Return whether parts side by side begin with the right half of a pipe.

        An odd number of them lack a half at one end, where a monster or the goal may stand: at which, the
        pipes in the same columns tell.
        """
        row = self._rows[line]
        end = len(row) - len(row[begin:].lstrip(_PIPE))
        if (end - begin) % 2 == 0 or row[end : end + 1] == ">":
            return False
        even, odd = (bool(columns[begin:end].any()) for columns in self._whole_pipes)
        return even and not odd if begin % 2 else odd and not even

    def _check_pipes(self) -> None:
        """Check that each half of a pipe stands in two columns that have a whole part of one."""
        left, right = (np.isin(self._tiles, (tile.PIPE_MOUTH + i, tile.PIPE_SHAFT + i)) for i in (0, 1))
        whole = np.pad((left[:-1] & right[1:]).any(1, keepdims=True), ((1, 1), (0, 0)))
        for row, column in np.argwhere((left & ~whole[1:] | right & ~whole[:-1]).T)[:1].tolist():
            line = max(row + len(self._rows) - state.ROWS, 0)
            raise self._wrong(line, column, "expected pipes of two columns, and this is half of one")

    def _additions(self) -> int:
        """Read what follows the picture; return the level's type."""
        level_type = 0
        for line, text in enumerate(self._lines[len(self._rows) :], len(self._rows)):
            if match := _TYPE.fullmatch(text):
                level_type = int(match[1])
            elif match := _ADDITION.fullmatch(text):
                cell, character, column = (int(match[1]), int(match[2])), match[3], match.start(3)
                if cell[0] >= self._columns or cell[1] >= state.ROWS:
                    cells = f"column 0 to {self._columns - 1} and row 0 to {state.ROWS - 1}"
                    raise self._wrong(line, 0, f"expected {cells}, not {cell[0]} and {cell[1]}")
                if character in _PIPE:
                    raise self._wrong(line, column, "expected a part of a pipe as one of <>[]")
                self._check(line, column, character)
                self._put(line, column, cell, character)
            elif text:
                expected = "expected type 0, 1 or 2, or COLUMN ROW CHARACTER"
                raise self._wrong(line, 0, f"{expected}, not {text!r:.40}")
        return level_type

    def _wrong(self, line: int, column: int, what: str) -> ConfigError:
        return ConfigError(f"{self._path}, line {line + 1}, column {column + 1}: {what}")

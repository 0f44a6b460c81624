"""Levels in files: pictures in two notations, what is refused and where, and that they play as others do."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from env_server.cli.environment import environment as glue_env
from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.many.games import DISABLED, Games
from env_server.mario.many.views import BODY, View
from env_server.mario.observation import BODY_SIZE
from env_server.mario.pictures import MOST_BYTES, digest_of, read_picture, write_picture
from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import GOOMBA, PLANT, ROWS, SPAWN_WINGED, LevelMap
from glue import Action, ConfigError, Observation, SaveError, SimulatorError, local, make_agent
from tests.env_server.mario.drawing import draw_picture
from tests.env_server.mario.golden_check import DIGESTS
from tests.proof import size

GROUND = "X" * 20
PLAIN = f"{'-' * 20}\n{GROUND}\n"
JUMP, RUN = Action(ints=[1, 1, 1]), Action(ints=[1, 0, 1])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "level.txt"


def level_of(file: Path, text: str) -> LevelMap:
    file.write_text(text)
    level: LevelMap = read_picture(file).levels()[0]
    return level


def restarted(game: Game) -> Observation:
    """Return the first observation of an episode in which no button is held any more."""
    for button in ("left", "right", "jump", "run"):
        setattr(game.world, f"button_{button}", False)
    return game.start()


def cells(level: LevelMap) -> dict[str, bytes]:
    return {
        name: getattr(level, name)[: level.columns].tobytes()
        for name in ("tiles", "spawns", "cells", "bumpable", "spawning")
    } | {name: bytes([getattr(level, name) % 256]) for name in ("columns", "type", "exit_x", "exit_y")}


@pytest.mark.parametrize("known", DIGESTS["levels"][:: size(4, 1)], ids=lambda known: str(known["options"]))
def test_the_level_of_a_seed_written_and_read_back_is_that_level(known: dict[str, Any], file: Path) -> None:
    game = Game(InfiniteMario(**known["options"]).parameters)
    game.start()
    read = level_of(file, write_picture(game.level_map))
    assert cells(read) == cells(game.level_map)
    whole = hashlib.sha256(read.tiles[: read.columns].tobytes()).hexdigest()
    assert whole.startswith(known["tiles"]), "the original's"


def test_the_command_prints_a_level(file: Path) -> None:
    arguments = ["mario", "--level-width", "0", "--level-template", "0"]
    done = CliRunner().invoke(glue_env, arguments, catch_exceptions=False)
    assert (done.exit_code, done.stdout) == (0, InfiniteMario(level_width=0).level_template(0))


FRAMEWORK = """
--------------------
-M------g-------K---
------------P-------
--SCU?Q!@2Do-----F--
--{%}-------TT--tt<>
--(|)-------TT--tt[]
XXXXX#/\\XXXXXXXXXXXX

type 2
7 5 G
"""
CORPUS = """
--------------------
---E-----?QSo---<>--
----------------[]--
XXXXXXXXXXXXXXXXXXXX
"""


@pytest.mark.parametrize("thin", [["-" * 12 + "X" + "-" * 7] * 13, ["-" * 20] * 7 + ["----XXXXXX----------"]])
def test_ground_stops_mario_however_thin_it_is(thin: list[str], file: Path) -> None:
    """A wall of one column up to the top; and a floor of one row in the air, seen with all of the level."""
    level_of(file, "\n".join([*thin, *["-" * 20] * (13 - len(thin)), GROUND, GROUND]) + "\n")
    mario = InfiniteMario(level=str(file))
    mario.env_init()
    shown = mario.env_start().chars.decode().splitlines()
    picture = file.read_text().splitlines()
    walls = [(row, column) for row in range(13) for column in range(20) if picture[row][column] == "X"]
    assert {shown[row][column] for row, column in walls} == {"7"}
    if len(thin) == 13:
        assert max(mario.env_step(RUN).observation.doubles[0] for _ in range(30)) < 12


def test_what_the_characters_stand_for(file: Path) -> None:
    """Golden codes: of the framework's notation, then of the corpus's."""
    level = level_of(file, FRAMEWORK[1:])
    rows = [level.tiles[:20, row].tolist() for row in range(ROWS)]
    blocks = [16, 17, 18, tile.QUESTION_WITH_POWER_UP, 21, 21, 22, tile.HIDDEN_BLOCK, tile.USED_BLOCK, 34]
    assert rows[11][2:12] == blocks
    assert rows[12] == [0, 0, 132, 133, 134, *[0] * 7, 10, 11, 0, 0, 10, 11, 10, 11]
    assert rows[13] == [0, 0, 148, 149, 150, *[0] * 7, 26, 27, 0, 0, 26, 27, 26, 27]
    assert rows[14][5:8] == [tile.STAIR, tile.OVERLAPPED_LEFT, tile.OVERLAPPED_RIGHT]
    assert (rows[14][10], level.type) == (137, 2), "a castle's"
    found = {(x, y): int(level.spawns[x, y]) for x, y in np.argwhere(level.spawns).tolist()}
    winged = GOOMBA | SPAWN_WINGED
    assert found == {
        (8, 9): GOOMBA,
        (16, 9): 2 | SPAWN_WINGED,
        (12, 10): PLANT,
        (12, 12): PLANT,
        (7, 5): winged,
    }
    assert (level.exit_x, level.exit_y) == (17, 12)

    level = level_of(file, CORPUS[1:])
    assert level.tiles[9:13, 12].tolist() == [tile.QUESTION_WITH_COIN, tile.USED_BLOCK, 16, 34]
    assert level.tiles[16:18, 12:14].T.tolist() == [[10, 11], [26, 27]]
    assert (level.spawns[3, 12], level.exit_x) == (GOOMBA, 19)
    tall = level_of(file, "-" * 20 + "\n" + CORPUS[1:] + 11 * (GROUND + "\n"))
    assert tall.tiles[9:11, 1].tolist() == [22, 21], "of 16 rows: the framework's; the top one is dropped"


@pytest.mark.parametrize(
    ("pipe", "codes"),
    [
        (["-tt-", "-tg-", "-t#-", "-tt-"], [[10, 11], [26, 0], [26, 9], [26, 11]]),
        (["-Tt-", "-gt-", "-tt-"], [[10, 11], [0, 27], [10, 27]]),
        (["-gT-", "-tt-"], [[0, 11], [10, 27]]),
        (["ttg-", "tttF", "tttt"], [[11, 0], [27, 10], [27, 26]]),
        (["gttt", "tttt"], [[11, 10], [27, 26]]),
        (["-T>-", "-[g-"], [[10, 11], [26, 0]]),
    ],
)
def test_half_of_a_pipe_is_that_of_the_pipe_in_its_columns(
    pipe: list[str], codes: list[list[int]], file: Path
) -> None:
    """Monsters, blocks and the goal of generated levels replace parts of pipes."""
    level = level_of(file, "\n".join(f"-----{row}{'-' * 11}" for row in pipe))
    assert level.tiles[6:8, ROWS - len(pipe) : ROWS].T.tolist() == codes


@pytest.mark.parametrize(
    ("text", "line", "column", "expected"),
    [
        ("", 1, 1, "expected a picture of 20 to 2050 columns, not 0"),
        (f"{' ' * 20}\n{PLAIN}", 1, 1, "not 0: this line is blank, and an empty cell is -"),
        ("-" * 2051, 1, 2052, "expected a picture of 20 to 2050 columns, not 2051"),
        (f"{PLAIN}XX", 3, 3, "expected 20 columns, not 2"),
        (f"{PLAIN}{'-' * 21}", 3, 21, "expected 20 columns, not 21"),
        (f"{GROUND}\n" * 16, 1, 1, "expected - in a row above the lowest 15"),
        (PLAIN + "XXé" + "X" * 17, 3, 3, "not 'é'"),
        (PLAIN + "XX\0" + "X" * 16, 3, 3, "expected plain text, not UTF-16"),
        (PLAIN + "F" + "-z" + "X" * 17, 3, 3, "not 'z'"),
        (PLAIN + "XB" + "X" * 18, 3, 2, "B is a cannon, and the competition of 2009 had none"),
        (PLAIN + "1" + "X" * 19, 3, 1, "a hidden mushroom that gives a life"),
        (PLAIN + "ttt" + "X" * 17, 3, 3, "expected pipes of two columns, and this is half of one"),
        (f"t{'-' * 19}\n" * 3, 1, 1, "this is half of one"),
        (f"tt{'-' * 18}\nttt{'-' * 17}\n-tt{'-' * 17}", 2, 3, "this is half of one"),
        (f"{PLAIN}-<{'-' * 18}\n-[{'-' * 18}", 3, 2, "this is half of one"),
        (f"{PLAIN}->{'-' * 18}", 3, 2, "this is half of one"),
        (PLAIN + "-" * 10 + "M" + "-" * 9, 3, 11, "expected M in the first 8 columns"),
        (PLAIN + "FF" + "-" * 18, 3, 2, "expected one F"),
        (f"{PLAIN}\ntype 3", 4, 1, "expected type 0, 1 or 2, or COLUMN ROW CHARACTER, not 'type 3'"),
        (f"{PLAIN}F{GROUND[1:]}\n\n20 3 g", 5, 1, "expected column 0 to 19 and row 0 to 14, not 20 and 3"),
        (f"{PLAIN}F{GROUND[1:]}\n\n9 3 t", 5, 5, "expected a part of a pipe as one of <>[]"),
        (f"{'g' * 20}\n" * 15, 15, 20, "expected at most 200 monsters in 40 columns, not 300"),
    ],
)
def test_what_is_refused_and_where(text: str, line: int, column: int, expected: str, file: Path) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        InfiniteMario(level=str(file))
    message = str(caught.value)
    assert message.startswith(f"{file}, line {line}, column {column}: ")
    assert expected in message


def test_what_editors_add_is_no_part_of_a_picture(file: Path) -> None:
    expected = cells(level_of(file, f"{PLAIN}\ntype 1\n9 3 g\n"))  # the goomba makes the notation ours
    file.write_bytes(f"\ufeff{PLAIN}\ntype 1 \n9 3 g".replace("\n", "\r\n").encode())
    assert cells(read_picture(file).levels()[0]) == expected


def test_files_that_are_not_read(file: Path) -> None:
    for path, why in ((file, "No such file"), (file.parent, "Is a directory")):
        with pytest.raises(ConfigError, match=why):
            read_picture(path)
    file.write_bytes(b"-" * (MOST_BYTES + 1))
    with pytest.raises(ConfigError, match="more than 262,144 bytes"):
        read_picture(file)
    file.write_text(PLAIN)
    sha256 = digest_of(file)
    assert read_picture(file, sha256).sha256 == sha256
    file.write_text(f"{PLAIN}{GROUND}\n")
    with pytest.raises(
        ConfigError, match=f"{file} has changed: its SHA-256 is {digest_of(file)}, not {sha256}"
    ):
        InfiniteMario(level=str(file), level_digest=sha256)


def test_a_level_of_a_file_is_whole_and_fixed(file: Path) -> None:
    file.write_text(PLAIN)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"level": str(file), "level_seed": 1}, "leave out level_seed"),
        ({"level_digest": "00"}, "give level, too"),
    ]
    for options, why in wrong:
        with pytest.raises(SimulatorError, match=why):
            InfiniteMario(**options)
    mario = InfiniteMario(level=str(file), mdp="proving-6")
    assert json.loads(mario.env_message("parameters"))["level"] == digest_of(file)
    assert json.loads(mario.env_message("parameters"))["jump_time"] == 10, "the MDP's, but for its level"
    assert mario.env_message("level") == f"level_digest={digest_of(file)}"
    assert mario.env_message("level level_seed=1").startswith("refused: the level is that of a file")
    mario.env_init()
    mario.env_start()
    saved = mario.env_save()
    mario.env_load(saved)
    others = InfiniteMario()
    others.env_init()
    with pytest.raises(SaveError):
        others.env_load(saved)
    with pytest.raises(SaveError, match="that of a file"):
        mario.env_load(others.env_save())
    with pytest.raises(SimulatorError, match="leave out the file"):
        mario.level_template(1)


def test_games_on_the_level_of_a_file_are_equal(file: Path) -> None:
    """Alone, as a clone, again, after another task, and among many games."""
    file.write_text(draw_picture(np.random.default_rng(5), 50))
    task, other = InfiniteMario(level=str(file)).parameters, InfiniteMario(level_width=0).parameters
    game = Game(task)
    first = game.start()
    clone = game.clone()
    steps = [game.step(1, 1, 0) for _ in range(5)]
    assert [clone.step(1, 1, 0) for _ in range(5)] == steps
    with Games([other, task, task], View(BODY, BODY_SIZE, 0), DISABLED) as games:
        games.reset()
        assert games.observation(2) == first != games.observation(0)
        for _ in steps:
            games.step(np.tile(np.array([2, 1, 0]), (3, 1)), np.array([3, 2, 2]))
        assert games.observation(1) == steps[-1][1]
        with pytest.raises(SimulatorError, match="fixed when games are made"):
            games.set_tasks([task, task, other])
        games.set_tasks([other, task, other])
        games.reset()
        assert games.observation(2) == games.observation(0)
    clone.set_task(other)
    assert restarted(clone) == Game(other).start()
    clone.set_task(task)
    assert restarted(clone) == restarted(game) == first


def test_the_planner_reaches_the_goals_of_drawn_levels(file: Path) -> None:
    solved = []
    rng = np.random.default_rng(1)
    for _ in range(4):
        file.write_text(draw_picture(rng, 50))
        with local(make_agent("planner"), InfiniteMario(level=str(file), max_trial_steps=120)) as glue:
            glue.rl_init(seed=1)
            glue.rl_episode()
            solved.append(glue.rl_return() > 50)
    assert solved.count(True) >= 2


def test_whatever_a_file_holds_it_is_a_level_or_refused(file: Path) -> None:
    rng = np.random.default_rng(3)
    for _ in range(size(50, 5000)):
        data = bytearray(draw_picture(rng, 24).encode())
        for place in rng.integers(0, len(data), 3).tolist():
            data[place] = int(rng.integers(256))
        file.write_bytes(data)
        with suppress(ConfigError):
            read_picture(file).levels()

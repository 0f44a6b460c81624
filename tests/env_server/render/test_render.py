"""Drawings of Infinite Mario: as text, live in a terminal, as PNG and as GIF."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from env_server.render.artwork import PALETTE, SPRITES, TILES
from env_server.render.drawing import HEIGHT, WIDTH, Picture, draw, save_gif, save_mp4, save_png
from env_server.render.scene import KINDS, Sprite, between, buried_cells, is_scene, outlined, read_scene
from env_server.render.text import draw_text
from glue import ConfigError, Observation, SimulatorError
from glue.cli.screen import TerminalScreen, has_color
from tests.clock import Clock
from tests.proof import size

SCREEN = """
                     
                     
                     
                     
                     
                     
       bb??          
                     
      M        $$    
                     
   1111        ||    
               ||    
77777      7777777777
    7      7         
    7      7         
    7      7         
"""  # noqa: W291, W293 - the blanks are air


AIR = " " * 21 + "\n"


def screen(*sprites: Sprite, tiles: str = SCREEN, column: int = 0) -> Observation:
    """Return the observation that shows `tiles` and `sprites`: by default Mario in flight at column 6."""
    if not sprites or sprites[0].kind not in (0, 10, 11):
        sprites = (Sprite(0, False, column + 6.5, 7.5, 0.25, 0.0), *sprites)
    ints = [column]
    for sprite in sprites:
        ints += [sprite.kind, sprite.winged]
    return Observation(ints, [value for sprite in sprites for value in sprite[2:]], tiles[1:].encode())


def goomba(x: float, height: float, speed_x: float = -0.5, winged: bool = False) -> Sprite:
    return Sprite(3, winged, x, height, speed_x, 0.0)


def test_scene_is_what_the_observation_shows() -> None:
    scene = read_scene(screen(goomba(14.25, 4.0, winged=True), column=3))
    assert scene.column == 3
    assert len(scene.rows) == 16
    assert scene.rows[6] == "       bb??          "
    assert scene.sprites == (Sprite(0, False, 9.5, 7.5, 0.25, 0.0), goomba(14.25, 4.0, winged=True))
    assert scene.sprites[1].cell == (11, 14)


@pytest.mark.parametrize(
    "strange",
    [
        Observation(),
        Observation([0, 0], [0.0] * 4, bytes(352)),
        Observation([0, 0, 0], [0.0] * 5, bytes(352)),
        Observation([0, 0, 0], [0.0] * 4, bytes(351)),
        Observation([0], [], bytes(352)),
    ],
)
def test_other_observations_are_told_apart(strange: Observation) -> None:
    assert not is_scene(strange)
    with pytest.raises(SimulatorError, match="4n doubles and 352 chars"):
        read_scene(strange)


@pytest.mark.parametrize(
    ("sprites", "complaint"),
    [
        *(([goomba(place, 4.0)], "less than 1e") for place in (float("nan"), float("inf"), -1e300)),
        ([goomba(1.0, 1.0)] * 1000, "at most 1000 sprites"),
    ],
)
def test_what_is_out_of_bounds_is_refused(sprites: list[Sprite], complaint: str) -> None:
    with pytest.raises(SimulatorError, match=complaint):
        read_scene(screen(*sprites))


def test_inside_of_the_ground_is_told_from_air() -> None:
    buried = buried_cells(read_scene(screen()))
    left = {(row, column) for row in (13, 14, 15) for column in range(4)}
    right = {(row, column) for row in (13, 14, 15) for column in range(12, 21)}
    assert buried == left | right


def test_ground_behind_the_goal_is_ground() -> None:
    tiles = "\n" + "            !        \n" * 12 + "777777777777!77777777\n" + "            !        \n" * 3
    scene = outlined(read_scene(screen(tiles=tiles)))
    assert scene.rows[11] == "            !        "
    assert scene.rows[12] == "7" * 21
    assert scene.rows[13] == "#" * 21


def test_text_shows_tiles_and_names_monsters() -> None:
    hidden = goomba(6.5, 7.5)  # behind Mario
    lines = draw_text(screen(goomba(9.5, 4.0), goomba(1.5, 4.0, winged=True), goomba(40.0, 4.0), hidden))
    assert lines == [
        *[" " * 42] * 6,
        "              [][]????                    ",
        " " * 42,
        "            mm                ()()        ",
        " " * 42,
        "      ========                ||||        ",
        "  g^              gg          ||||        ",
        "##########            ####################",
        *["::::::::##            ##::::::::::::::::::"] * 3,
        "mm Mario  gg goomba  g^ winged goomba  speed +0.25 +0.00 tiles/step",
    ]


def test_text_with_color_is_the_same_text() -> None:
    observation = screen(goomba(9.5, 4.0))
    plain, colored = draw_text(observation), draw_text(observation, color=True)
    assert [re.sub(r"\x1b\[[^m]*m", "", line) for line in colored] == plain
    assert "\x1b[" in colored[0]


def test_text_of_another_task_is_its_numbers() -> None:
    assert draw_text(Observation([3], [0.5])) == ["Observation(ints=[3], doubles=[0.5])"]


def test_text_lets_no_control_character_through() -> None:
    tiles = "\n" + ("\x1b]0;\x07\xff" + " " * 16 + "\n") * 16
    observation = screen(tiles="\n")
    observation = Observation(observation.ints, observation.doubles, tiles[1:].encode("latin-1"))
    assert all(line.isprintable() for line in draw_text(observation))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[TextIO, int]]:
    """A terminal of 60 columns and 20 lines: the stream to draw to, and the descriptor to read from.

    Nothing is drawn in color.
    """
    monkeypatch.setenv("NO_COLOR", "1")
    looking, drawing = pty.openpty()
    set_size(drawing, 20, 60)
    with os.fdopen(drawing, "w", encoding="ascii", newline="") as stream:
        yield stream, looking
    os.close(looking)


def set_size(descriptor: int, lines: int, columns: int) -> None:
    fcntl.ioctl(descriptor, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))


def seen(terminal: tuple[TextIO, int]) -> str:
    """Return the text drawn since the last call."""
    stream, looking = terminal
    # Everything written before the mark arrives before the mark.
    stream.write("\0")
    stream.flush()
    drawn = b""
    while not drawn.endswith(b"\0"):
        drawn += os.read(looking, 2**16)
    return drawn[:-1].decode()


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"TERM": "xterm"}, True),
        ({"TERM": "xterm", "NO_COLOR": ""}, True),
        ({"TERM": "xterm", "NO_COLOR": "1"}, False),
        ({"TERM": "dumb"}, False),
    ],
)
def test_color_where_the_terminal_has_it_and_nobody_objects(
    terminal: tuple[TextIO, int], monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], expected: bool
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert has_color(terminal[0]) is expected
    assert not has_color(io.StringIO())
    with TerminalScreen(terminal[0], draw_text) as drawing:
        drawing.show(screen(), 0.0, 0, 0.0)
    assert ("48;5;" in seen(terminal)) is expected


def test_screen_draws_over_the_last_drawing(terminal: tuple[TextIO, int]) -> None:
    clock = Clock()
    drawing = TerminalScreen(terminal[0], draw_text, clock=clock)
    drawing.show(screen(), -0.01, 7, 12.5, "level 3")
    first = seen(terminal)
    assert first.startswith("\x1b[?25l\x1b[2J\x1b[H")
    assert "speed +0.25 +0.00 tiles/step" in first
    assert "step 7  reward -0.01  return 12.50" in first
    assert "level 3" in first
    assert first.count("\n") == 18
    clock.now = 1.0
    drawing.show(screen(), -0.01, 8, 12.5)
    second = seen(terminal)
    assert second.startswith("\x1b[H")
    assert "\x1b[2J" not in second
    drawing.close()
    assert seen(terminal) == "\x1b[?25h\r\n"


def test_screen_is_not_drawn_faster_than_its_rate_but_ends_on_the_last(terminal: tuple[TextIO, int]) -> None:
    clock = Clock()
    with TerminalScreen(terminal[0], draw_text, rate=10, clock=clock) as drawing:
        for step in range(6):
            clock.now = step * 0.05
            drawing.show(screen(), 0.0, step, 0.0)
    drawn = seen(terminal)
    assert [step for step in range(6) if f"step {step} " in drawn] == [0, 2, 4, 5]


def test_screen_smaller_than_the_drawing_keeps_the_lower_lines(terminal: tuple[TextIO, int]) -> None:
    set_size(terminal[0].fileno(), 8, 60)
    with TerminalScreen(terminal[0], draw_text) as drawing:
        drawing.show(screen(), 0.0, 3, 0.0, "title")
    drawn = seen(terminal)
    assert drawn.count("\n") == 8  # the last line follows the last newline
    assert "####" in drawn
    assert "title" in drawn


def test_pictures_are_drawn_in_known_colors() -> None:
    for name, tile in TILES.items():
        assert [len(line) for line in tile] == [16] * 16, name
    assert set(SPRITES) == set(KINDS)
    for lines in [*TILES.values(), *SPRITES.values()]:
        assert len({len(line) for line in lines}) == 1, lines
        assert set("".join(lines)) <= {*PALETTE, "."}, lines


def test_every_kind_of_sprite_looks_different() -> None:
    pictures = {draw(screen(Sprite(kind, False, 9.5, 6.0, 0.0, 0.0))).tobytes() for kind in KINDS}
    winged = draw(screen(goomba(9.5, 6.0, winged=True))).tobytes()
    facing = draw(screen(goomba(9.5, 6.0, speed_x=0.5))).tobytes()
    assert len(pictures | {winged, facing}) == len(KINDS) + 1  # a goomba faces either side


def test_picture_puts_things_where_they_are() -> None:
    picture = draw(screen(goomba(9.5, 4.0)))
    assert picture.shape == (HEIGHT, WIDTH)
    empty = draw(screen())
    changed = np.argwhere(picture != empty)
    (top, left), (bottom, right) = changed.min(0), changed.max(0)
    assert bottom == 16 * 12  # its feet, at the position that its height gives
    assert top >= bottom - 16
    assert 144 <= left < right < 160


def test_picture_follows_mario_in_its_window() -> None:
    picture = draw(screen(Sprite(0, False, 13.6, 7.5, 0.0, 0.0), column=3))
    exact = draw(screen(Sprite(0, False, 13.0, 7.5, 0.0, 0.0), column=3))
    assert _brick_column(picture) == _brick_column(exact) - round(0.6 * 16)


CEILING = "\n" + "777".ljust(21) + "\n" + AIR * 4 + "      7".ljust(21) + "\n" + AIR * 10
CUT_PIPE = "\n" + AIR * 8 + ("|  ||".ljust(21) + "\n") * 8


@pytest.mark.parametrize(
    ("tiles", "mario", "shown"),
    [
        (SCREEN, (6.5, 7.5), {(6, 7): "brick", (6, 9): "question", (12, 0): "grass", (13, 0): "earth"}),
        (SCREEN, (6.5, 7.5), {(10, 3): "ledge", (10, 15): "mouth left", (10, 16): "mouth right"}),
        (SCREEN, (6.5, 7.5), {(11, 15): "shaft left"}),
        (CEILING, (9.5, 3.0), {(5, 6): "stone", (0, 1): "earth"}),
        (CUT_PIPE, (9.5, 8.5), {(9, 0): "shaft right", (9, 3): "shaft left", (8, 4): "mouth right"}),
    ],
)
def test_tiles_are_drawn_by_their_kind_and_their_neighbours(
    tiles: str, mario: tuple[float, float], shown: dict[tuple[int, int], str]
) -> None:
    picture = draw(screen(Sprite(0, False, *mario, 0.0, 0.0), tiles=tiles))
    for (row, column), name in shown.items():
        assert _shows(picture, row, column, name), name


def test_scene_between_is_on_the_curve_of_places_and_speeds() -> None:
    before = read_scene(screen(Sprite(0, False, 6.0, 4.0, 1.0, 4.0), goomba(12.0, 4.0)))
    after = read_scene(screen(Sprite(0, False, 7.0, 4.0, 1.0, -4.0), goomba(11.5, 4.0)))
    assert between(before, after, 0.0).sprites == before.sprites
    middle = between(before, after, 0.5)
    assert middle.sprites[0][2:4] == (6.5, 5.0)  # the top of a parabola: higher by a quarter of the speed
    assert middle.sprites[1].x == 11.75


def test_scene_between_does_not_sink_into_the_ground() -> None:
    before = read_scene(screen(Sprite(0, False, 6.0, 4.5, 0.0, -5.0)))
    after = read_scene(screen(Sprite(0, False, 6.0, 4.0, 0.0, -0.0)))
    heights = [between(before, after, time / 10).sprites[0].height for time in range(10)]
    assert min(heights) >= 4.0


def test_scene_between_shows_both_windows_and_what_mario_hides() -> None:
    before = read_scene(screen())
    moved = "".join(line[2:] + "xy\n" for line in SCREEN[1:].splitlines())
    after = read_scene(screen(tiles="\n" + moved.replace("M", "b"), column=2))
    scene = between(before, after, 0.25)
    assert (scene.column, len(scene.rows[0])) == (0, 23)
    assert scene.rows[8] == "      b        $$    xy"
    assert between(after, before, 0.75).rows[8][6] == "b"


def test_scene_between_keeps_what_is_in_one_of_them_for_half_of_the_time() -> None:
    before = read_scene(screen(goomba(12.0, 4.0)))
    after = read_scene(screen(Sprite(9, False, 11.0, 4.0, 0.0, 0.0)))
    assert [len(between(before, after, time).sprites) for time in (0.4, 0.6)] == [2, 2]
    assert [between(before, after, time).sprites[1].kind for time in (0.4, 0.6)] == [3, 9]


def test_repeated_observation_stands_still() -> None:
    scene = read_scene(screen())
    assert between(scene, scene, 0.3) == scene


def test_png_is_the_picture(tmp_path: Path) -> None:
    save_png(tmp_path / "a.png", screen(), scale=3)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (3 * WIDTH, 3 * HEIGHT)
        pixels = np.asarray(image)
    assert (pixels[::3, ::3] == draw(screen())).all()
    assert (pixels[1::3, 2::3] == draw(screen())).all()


def test_gif_has_the_pictures_at_their_times(tmp_path: Path) -> None:
    steps = [screen(goomba(12.0 - step / 2, 4.0)) for step in range(5)]
    save_gif(tmp_path / "a.gif", steps, steps_per_second=10)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.size == (WIDTH, HEIGHT)
        frames = []
        for number in range(getattr(image, "n_frames", 1)):
            image.seek(number)
            frames.append((np.asarray(image.convert("RGB")), image.info["duration"]))
    # 4 steps of 0.1 s, rounded up to whole pictures, and the duration of the last picture
    assert sum(duration for _, duration in frames) == 7 * 70
    assert (frames[0][0] == _colors(draw(steps[0]))).all()
    assert (frames[-1][0] == _colors(draw(steps[-1]))).all()


def test_film_has_the_pictures_at_their_times(tmp_path: Path) -> None:
    from imageio_ffmpeg import get_ffmpeg_exe  # type: ignore[import-untyped]  # it has no types

    steps = [screen(goomba(12.0 - step / 2, 4.0)) for step in range(5)]
    save_mp4(tmp_path / "a.mp4", steps, steps_per_second=10)
    decode = [get_ffmpeg_exe(), "-i", tmp_path / "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(decode, capture_output=True, check=True)
    assert b"25 fps" in done.stderr
    frames = np.frombuffer(done.stdout, np.uint8).reshape(-1, 2 * HEIGHT, 2 * WIDTH, 3)
    assert len(frames) == 11  # 4 steps of 0.1 s, and the last picture
    for frame, step in ((frames[0], steps[0]), (frames[-1], steps[-1])):
        assert np.abs(frame[::2, ::2].astype(int) - _colors(draw(step))).mean() < 10  # it is compressed


def test_files_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot write"):
        save_mp4(tmp_path / "nowhere" / "a.mp4", [screen()])
    with pytest.raises(ConfigError, match=r"cannot write .*nowhere.a\.png: No such file"):
        save_png(tmp_path / "nowhere" / "a.png", screen())
    with pytest.raises(ConfigError, match="at least one"):
        save_gif(tmp_path / "a.gif", [])


def test_missing_pillow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ConfigError, match=r"pip install 'glue-rl\[render\]'"):
        save_png(tmp_path / "a.png", screen())


@pytest.mark.proof
@settings(deadline=None, max_examples=size(25, 200))
@given(data=st.data())
def test_any_observation_of_the_right_shape_is_drawn_or_refused(data: st.DataObject) -> None:
    def strange() -> Observation:
        count = data.draw(st.integers(1, 5))
        number = st.integers(-(2**31), 2**31 - 1)
        kinds = data.draw(st.lists(number | st.integers(0, 12), min_size=2 * count, max_size=2 * count))
        column = data.draw(number | st.integers(0, 30))
        place = st.floats() | st.floats(-5, 40)
        places = data.draw(st.lists(place, min_size=4 * count, max_size=4 * count))
        tiles = data.draw(st.lists(st.sampled_from(b" 7|!1b?$M\n\xff"), min_size=352, max_size=352))
        return Observation([column, *kinds], places, bytes(tiles))

    first, second = strange(), strange()
    try:
        before, after = outlined(read_scene(first)), outlined(read_scene(second))
    except SimulatorError:
        return
    assert len(draw_text(first)) == 17
    assert draw(first).shape == (HEIGHT, WIDTH)
    between(before, after, 0.3)


def _colors(picture: Picture) -> Any:
    return np.array([*PALETTE.values()], np.uint8)[picture]


def _letters(name: str) -> Picture:
    places = {letter: place for place, letter in enumerate(PALETTE)}
    return np.array([[places.get(letter, 255) for letter in line] for line in TILES[name]], np.uint8)


def _shows(picture: Picture, row: int, column: int, name: str) -> bool:
    """Return whether a cell of the picture, whose window begins at its border, shows a tile."""
    tile = _letters(name)
    cell = picture[16 * row : 16 * row + 16, 16 * column : 16 * column + 16]
    return bool((cell == tile)[tile != 255].all())


def _brick_column(picture: Picture) -> int:
    """Return the column of pixels at which the bricks begin."""
    brick = _letters("brick")
    return next(x for x in range(WIDTH - 16) if (picture[96:112, x : x + 16] == brick).all())


def test_marks_are_drawn_where_they_are(tmp_path: Path) -> None:
    observation, marks = screen(column=3), ((5.5, 12.5), (100.0, 3.0), (4.0, -7.0))
    changed = [
        (row, column)
        for row, lines in enumerate(
            zip(draw_text(observation), draw_text(observation, False, marks), strict=True)
        )
        for column, (without, mark) in enumerate(zip(*lines, strict=True))
        if without != mark
    ]
    assert changed == [(3, 4), (3, 5)]
    assert (draw(observation, marks) != draw(observation)).sum() == 13  # of the one mark in view
    save_gif(tmp_path / "a.gif", [observation], marks=[marks])
    with Image.open(tmp_path / "a.gif") as image:
        rows, columns = (np.asarray(image.convert("RGB")) != _colors(draw(observation))).any(-1).nonzero()
    assert np.ptp(rows) == np.ptp(columns) == 4
    assert rows.mean() == HEIGHT + 16 - 12.5 * 16

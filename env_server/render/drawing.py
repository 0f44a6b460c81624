"""Draw Infinite Mario as pictures: an observation as PNG, an episode as an animated GIF or MP4.

A picture is what the original shows, 20 by 15 tiles of 16 by 16 pixels, in the colors of
`artwork.PALETTE`. Files need Pillow and imageio-ffmpeg, the extra `render`.
"""

from __future__ import annotations

import math
import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import chain, repeat
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from env_server.render.artwork import CLOUD, MARK, PALETTE, SPRITES, TILES, WING, Lines
from env_server.render.scene import Scene, Sprite, between, outlined, read_scene
from glue.cli.screen import Marks
from glue.errors import ConfigError
from glue.installed import needing
from glue.types import Observation

if TYPE_CHECKING:
    from PIL.Image import Image

Picture = npt.NDArray[np.uint8]
"""Indices into the palette, shape (height, width); 255 is transparent."""

WIDTH: Final = 320
HEIGHT: Final = 240
_TILE: Final = 16
CLEAR: Final = 255
_LETTERS: Final = {letter: place for place, letter in enumerate(PALETTE)} | {".": CLEAR}
_BESIDE: Final = WIDTH / 2 / _TILE  # tiles from the picture's border to Mario
_GIF_FRAME: Final = 7
"""Duration of a picture in hundredths of a second: at 25 pictures per second a file is 1.7 times as large."""
_MP4_RATE: Final = 25
"""Pictures per second."""
_PLANT: Final = 5
SKY: Final = "123456"
MOUNTAINS: Final = "78"
_SOLID: Final = "7#"
_NAMES: Final = {"1": "ledge", "3": "ledge", "b": "brick", "?": "question", "$": "coin"}


def draw(observation: Observation, marks: Marks = ()) -> Picture:
    """Return a picture of an observation and of marks, x and height in tiles; shape (240, 320).

    Raises:
        SimulatorError: it is not an observation of Infinite Mario.
    """
    return _draw(outlined(read_scene(observation)._replace(marks=marks)))


def save_png(path: str | os.PathLike[str] | IO[bytes], observation: Observation, scale: int = 2) -> None:
    """Write a picture of `observation` to a path or an open file, each pixel `scale` pixels wide and high.

    Raises:
        ConfigError: the file cannot be written, or Pillow is missing.
        SimulatorError: it is not an observation of Infinite Mario.
    """
    _save(path, _image(draw(observation).repeat(scale, 0).repeat(scale, 1)), "PNG")


def save_gif(
    path: str | os.PathLike[str],
    observations: Sequence[Observation],
    steps_per_second: float = 10.0,
    marks: Sequence[Marks] = (),
) -> None:
    """Write an animation of `observations`, one per step, at 14 pictures per second.

    Args:
        path: of the file.
        observations: of consecutive steps.
        steps_per_second: pace of the film.
        marks: marks of each observation, or nothing.

    Raises:
        ConfigError: there are no observations, the file cannot be written, or Pillow is missing.
        SimulatorError: one is not an observation of Infinite Mario.
    """
    pictures = _film(observations, steps_per_second * _GIF_FRAME / 100, marks)
    first, *others = map(_image, pictures)
    _save(path, first, "GIF", save_all=True, append_images=others, duration=10 * _GIF_FRAME, loop=0)


def save_mp4(
    path: str | os.PathLike[str],
    observations: Sequence[Observation],
    steps_per_second: float = 10.0,
    scale: int = 2,
) -> None:
    """Write a film of `observations`, one per step, at 25 pictures per second.

    Args:
        path: of the file.
        observations: of consecutive steps.
        steps_per_second: pace of the film.
        scale: width and height of each pixel.

    Raises:
        ConfigError: there are no observations, the file cannot be written, or imageio-ffmpeg is missing.
        SimulatorError: one is not an observation of Infinite Mario.
    """
    with needing("render", "films need imageio-ffmpeg"):
        from imageio_ffmpeg import get_ffmpeg_exe  # type: ignore[import-untyped]  # it has no types
    colors = np.array([*PALETTE.values()], np.uint8)
    pictures = _film(observations, steps_per_second / _MP4_RATE)
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{WIDTH}x{HEIGHT}", "-r", str(_MP4_RATE), "-i", "-"]
    film = ["-vf", f"scale=iw*{scale}:ih*{scale}:flags=neighbor", "-c:v", "libx264", "-pix_fmt", "yuv420p"]
    command = [get_ffmpeg_exe(), "-loglevel", "error", *raw, *film, "-f", "mp4", "-y", f"file:{path}"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        with suppress(BrokenPipeError):
            for picture in pictures:
                encoder.stdin.write(colors[picture].tobytes())
            encoder.stdin.close()
        reason = encoder.stderr.read().decode("utf-8", "replace").strip()
    if encoder.returncode:
        raise ConfigError(f"cannot write {path}: {reason.partition(chr(10))[0]}")


def _film(observations: Sequence[Observation], pace: float, marks: Sequence[Marks] = ()) -> Iterator[Picture]:
    """Yield the pictures of an animation that advances by `pace` steps per picture.

    Raises:
        ConfigError: there are no observations.
        SimulatorError: one is not an observation of Infinite Mario.
    """
    if not observations:
        raise ConfigError("an animation needs at least one observation")
    scenes = [
        outlined(read_scene(observation)._replace(marks=marked))
        for observation, marked in zip(observations, chain(marks, repeat(())), strict=False)
    ]
    last = len(scenes) - 1
    for number in range(math.ceil(last / pace) + 1):
        step = min(int(number * pace), last)
        yield _draw(between(scenes[step], scenes[min(step + 1, last)], number * pace - step))


def _draw(scene: Scene) -> Picture:
    """Return a picture of an outlined scene."""
    right = scene.column + len(scene.rows[0]) - WIDTH / _TILE
    camera = round(min(max(scene.sprites[0].x - _BESIDE, scene.column), right) * _TILE)
    picture = _background(camera)
    # Plants rise out of pipes, which are therefore drawn over them.
    for shown in scene.sprites:
        if shown.kind == _PLANT:
            _draw_sprite(picture, shown, camera)
    for row in range(HEIGHT // _TILE):
        for column in range(len(scene.rows[row])):
            for name in _tiles(scene.rows, row, column):
                _paste(picture, drawn(TILES[name]), (scene.column + column) * _TILE - camera, row * _TILE)
    for x, height in scene.marks:
        left, top = round(x * _TILE) - camera, round(HEIGHT + _TILE - height * _TILE)
        _paste(picture, drawn(MARK), left - len(MARK) // 2, top - len(MARK) // 2)
    for shown in reversed(scene.sprites):
        if shown.kind != _PLANT:
            _draw_sprite(picture, shown, camera)
    return picture


def _background(camera: int) -> Picture:
    """Return sky, clouds and mountains; distant layers move less than the camera."""
    rows = np.arange(HEIGHT)[:, np.newaxis]
    columns = np.arange(WIDTH)
    sky = np.array([_LETTERS[letter] for letter in SKY], np.uint8)
    picture = np.repeat(sky[np.minimum(rows // 28, len(sky) - 1)], WIDTH, axis=1)
    for letter, top, nearness in zip(MOUNTAINS, (110, 150), (0.2, 0.35), strict=True):
        far = columns + camera * nearness
        crest = top - 22 * np.sin(far / 53) - 11 * np.sin(far / 23 + 1)
        picture[rows >= crest] = _LETTERS[letter]
    for number, height in enumerate((26, 58, 14, 44)):
        _paste(picture, drawn(CLOUD), int(130 * number - camera * 0.12) % 520 - 100, height)
    return picture


def _tiles(rows: tuple[str, ...], row: int, column: int) -> Iterator[str]:
    """Yield the names of the tiles that a cell is drawn with, from back to front."""
    cell = rows[row][column]
    if cell not in _SOLID and _on_hill(rows, row, column):
        yield "hill"
    if cell == "#":
        yield "earth"
    elif cell == "7":
        yield _solid_tile(rows, row, column)
    elif cell == "|":
        yield _pipe_tile(rows, row, column)
    elif cell == "!" and row > 2:
        yield {3: "pole top", 4: "flag"}.get(row, "pole")
    elif cell in _NAMES:
        yield _NAMES[cell]


def _on_hill(rows: tuple[str, ...], row: int, column: int) -> bool:
    """Return whether a ledge above makes this cell part of a hill."""
    above = "".join(line[column] for line in rows[:row])
    return above.rfind("1") > max(map(above.rfind, _SOLID))


def _solid_tile(rows: tuple[str, ...], row: int, column: int) -> str:
    """Return the tile of a solid cell: ground and blocks on it, ceiling, or a block in the air."""
    line = "".join(line[column] for line in rows)
    if not line[row:].strip(_SOLID):
        return "earth" if row and line[row - 1] in _SOLID else "grass"
    return "stone" if line[:row].strip(_SOLID) else "earth"


def _pipe_tile(rows: tuple[str, ...], row: int, column: int) -> str:
    line = rows[row]
    start = len(line[:column].rstrip("|"))
    end = len(line) - len(line[column:].lstrip("|"))
    # Pipes are two tiles wide; the window's left border may cut one.
    cut = start == 0 and (end - start) % 2
    side = ("left", "right")[(column - start + cut) % 2]
    mouth = row == 0 or rows[row - 1][column] != "|"
    return f"{'mouth' if mouth else 'shaft'} {side}"


def _draw_sprite(picture: Picture, shown: Sprite, camera: int) -> None:
    if shown.kind not in SPRITES:
        return
    image = sprite(shown.kind, shown.speed_x < 0, shown.winged)
    height, width = image.shape
    feet = round(HEIGHT + _TILE - shown.height * _TILE) + 1
    _paste(picture, image, round(shown.x * _TILE) - camera - width // 2, feet - height)


@cache
def sprite(kind: int, to_the_left: bool, winged: bool) -> Picture:
    """Return a picture of Mario or a monster, by its number in observations."""
    image = drawn(SPRITES[kind])
    if winged:
        space = np.full((image.shape[0] + 4, image.shape[1] + 8), CLEAR, np.uint8)
        _paste(space, image, 4, 4)
        _paste(space, drawn(WING), 0, max(0, image.shape[0] - 18))
        image = space
    return image[:, ::-1] if to_the_left else image


@cache
def drawn(lines: Lines) -> Picture:
    """Return a picture of `env_server.render.artwork`."""
    return np.array([[_LETTERS[letter] for letter in line] for line in lines], np.uint8)


def _paste(picture: Picture, image: Picture, left: int, top: int) -> None:
    """Draw `image` onto `picture`, clipped to it."""
    height, width = image.shape
    if not (-height < top < picture.shape[0] and -width < left < picture.shape[1]):
        return
    place = picture[max(0, top) : top + height, max(0, left) : left + width]
    part = image[max(0, -top) :, max(0, -left) :][: place.shape[0], : place.shape[1]]
    np.copyto(place, part, where=part != CLEAR)


def pillow() -> Any:
    """Return the module `PIL.Image`.

    Raises:
        ConfigError: Pillow is missing.
    """
    with needing("render", "pictures need Pillow"):
        from PIL import Image
    return Image


def _image(picture: Picture) -> Image:
    height, width = picture.shape
    image: Image = pillow().frombytes("P", (width, height), picture.tobytes())
    image.putpalette([part for color in PALETTE.values() for part in color])
    return image


def _save(path: str | os.PathLike[str] | IO[bytes], image: Image, kind: str, **options: Any) -> None:
    try:
        image.save(path, kind, **options)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from None

"""Gymnasium's render modes of Infinite Mario: an array of pixels, text, or a window."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from env_server.render.artwork import PALETTE
from env_server.render.drawing import HEIGHT, WIDTH, draw
from env_server.render.text import draw_text
from glue.errors import ConfigError
from glue.types import Observation

RENDER_MODES: Final = ("rgb_array", "ansi", "human")
FPS: Final = 10
"""Steps, of five ticks each, per second: about twice the speed of the original game."""

_COLORS: Final = np.array([*PALETTE.values()], np.uint8)
_SCALE: Final = 2


def usable_modes() -> list[str]:
    """Return the render modes that work here: `human` needs Tk and a screen."""
    has_screen = sys.platform in ("darwin", "win32") or "DISPLAY" in os.environ
    window = has_screen and find_spec("tkinter") is not None
    return [mode for mode in RENDER_MODES if window or mode != "human"]


class Renderer:
    """Shows observations in one render mode.

    Raises:
        ConfigError: there is no such mode.
    """

    def __init__(self, mode: str | None) -> None:
        if mode is not None and mode not in RENDER_MODES:
            raise ConfigError(f"render_mode is one of {', '.join(RENDER_MODES)}, not {mode!r:.80}")
        self._mode = mode
        self._window: _Window | None = None

    def show(self, observation: Observation) -> npt.NDArray[np.uint8] | str | None:
        """Return pixels of shape (240, 320, 3), or a text; with `human` show a window and return None.

        Raises:
            ConfigError: no window can be opened.
        """
        if self._mode == "ansi":
            return "\n".join(draw_text(observation)) + "\n"
        pixels: npt.NDArray[np.uint8] = _COLORS[draw(observation)]
        if self._mode == "rgb_array":
            return pixels
        self._window = self._window or _Window()
        self._window.show(pixels)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


class _Window:
    """A window with one picture, made with Tk, which comes with Python."""

    def __init__(self) -> None:
        try:
            import tkinter
        except ImportError:
            raise ConfigError(
                "render_mode='human' needs Tk: install python3-tk, or use render_mode='rgb_array'"
            ) from None
        try:
            self._root: Any = tkinter.Tk()
        except tkinter.TclError as error:
            raise ConfigError(
                f"render_mode='human' needs a screen ({error}): use render_mode='rgb_array' without one"
            ) from None
        self._photo_image = tkinter.PhotoImage
        self._root.title("Infinite Mario")
        self._label: Any = tkinter.Label(self._root, width=WIDTH * _SCALE, height=HEIGHT * _SCALE)
        self._label.pack()

    def show(self, pixels: npt.NDArray[np.uint8]) -> None:
        """Show a picture for the duration of a step."""
        data = b"P6 %d %d 255 " % (WIDTH, HEIGHT) + pixels.tobytes()
        self._image: Any = self._photo_image(data=data, format="PPM").zoom(_SCALE)
        self._label.configure(image=self._image)
        self._root.update()
        self._root.after(1000 // FPS)

    def close(self) -> None:
        self._root.destroy()

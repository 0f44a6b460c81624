"""Our environments in words; see `glue.plugins.words`."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from itertools import product
from typing import Final

from glue.plugins.words import Words
from glue.taskspec import Range, Ranges, Space
from glue.types import Action, Observation


def _png(observation: Observation) -> bytes:
    from env_server.render.drawing import save_png  # Pillow is an extra

    file = BytesIO()
    save_png(file, observation)
    return file.getvalue()


def _buttons() -> Iterator[tuple[str, Action]]:
    """Yield Mario's twelve actions, each with the buttons that it holds."""
    for (direction, x), jump, run in product((("", 0), ("right", 1), ("left", -1)), (0, 1), (0, 1)):
        name = "+".join(filter(None, (direction, "jump" * jump, "run" * run)))
        yield name or "stay", Action(ints=(x, jump, run))


MARIO: Final = Words(
    """\
You are Mario in a level that scrolls from left to right; the goal is at its right end. Each action holds \
buttons for five ticks of the game; run makes you faster, and jumps longer. Falling into a gap and \
touching an enemy from the side or below kills you and ends the episode; landing on most enemies kills \
them. After 1,000 steps you die, too. A step usually pays -0.01, a coin and a killed enemy 1, death -10 and \
the goal 100; a task may have another limit and pay otherwise.
The picture has 16 rows of 21 tiles, two characters to a tile: ## solid, == solid from above, [] a brick, \
?? a question block, () a coin, || a pipe, !> the column of the goal. Two equal letters are Mario or \
somebody else, as the line below the picture says; ^ after a letter is a wing.""",
    dict(_buttons()),
    _png,
)

MINES: Final = Words(
    """\
You are @ on a grid of 6 rows and 18 columns. Reach the goal G, which pays 10 and ends the episode; a mine \
* costs 100 and ends it, too, any other step costs 1. A step into a wall does not move you.""",
    {name: Action(ints=(number,)) for number, name in enumerate(("up", "down", "left", "right"))},
    observations=Space(Ranges.of(Range(0, 107))),
)

SKELETON: Final = Words(
    """\
You are @ on a line of 21 states, at first in the middle. The left end pays -1, the right end 1, and \
either ends the episode; no other step is rewarded.""",
    {"left": Action(ints=(0,)), "right": Action(ints=(1,))},
    observations=Space(Ranges.of(Range(0, 20))),
)

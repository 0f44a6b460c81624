"""The pace of an environment that does not wait for its agent.

With a rate, the environment makes a step whenever its time has come, with the newest action of the agent. An
agent that is late is given, when it has answered, the newest observation and the sum of the rewards since the
one that it answered. With a delay, each action is carried out a number of steps later than it would be,
without a clock: results depend on seeds alone. `glue.engine.pacer` has the rules.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Final

from glue.errors import ConfigError

if TYPE_CHECKING:  # NumPy is not needed for a command's help
    from glue.types import Action

REPEAT: Final = "repeat"
"""The late action is the last one, again."""

MAX_RATE: Final = 1000.0
"""Steps per second; a hub's clock has a resolution of a millisecond."""

MAX_DELAY: Final = 1000


@dataclass(frozen=True, slots=True)
class Pace:
    """When an agent's actions are carried out; by default, an environment waits for each of them.

    Args:
        rate: steps of the environment per second; 0 to wait for the agent.
        late: what is carried out while the agent is late: `repeat` for its last action, or the numbers of
            an action, whole ones for its ints and decimals for its doubles, as in `0,1,0` or `0.0,-0.5`.
        delay: number of steps by which each action is carried out later, the first one excepted.

    Raises:
        ConfigError: a number is out of range or of another type, or `late` is neither.
    """

    rate: float = 0.0
    late: str = REPEAT
    delay: int = 0

    def __post_init__(self) -> None:
        if not (_is(Real, self.rate) and (self.rate == 0 or 0.001 <= self.rate <= MAX_RATE)):
            raise ConfigError(
                f"a rate is from 0.001 to {MAX_RATE:g} steps per second, or 0 to wait for the agent, "
                f"not {self.rate!r:.80}",
                settings=("rate",),
            )
        if not (_is(Integral, self.delay) and 0 <= self.delay <= MAX_DELAY):
            raise ConfigError(
                f"a delay is from 0 to {MAX_DELAY} steps, not {self.delay!r:.80}", settings=("delay",)
            )
        # NumPy's numbers would round the times that are computed with them.
        object.__setattr__(self, "rate", float(self.rate))
        object.__setattr__(self, "delay", int(self.delay))
        numbers = _numbers(self.late)
        if numbers and not self:
            raise ConfigError(
                "an agent is never late where the environment waits for it: give a rate or a delay, too",
                settings=("rate", "delay"),
            )

    def __bool__(self) -> bool:
        """Whether an action is carried out at another time than it would be otherwise."""
        return bool(self.rate or self.delay)

    def __str__(self) -> str:
        """The pace as the end of a sentence, with a comma before it; empty if the environment waits."""
        rate = f", {self.rate:g} steps per second" if self.rate else ""
        delay = f", actions delayed by {self.delay} steps" if self.delay else ""
        late = f", in place of late ones {self.late}" if self.late != REPEAT else ""
        return f"{rate}{delay}{late}"

    @property
    def action(self) -> Action | None:
        """The action that is carried out while the agent is late; None for its last one."""
        if self.late == REPEAT:
            return None
        from glue.types import Action

        numbers = _numbers(self.late)
        ints = [number for number in numbers if isinstance(number, int)]
        return Action(ints, [number for number in numbers if isinstance(number, float)])


def _is(kind: type, number: object) -> bool:
    return isinstance(number, kind) and not isinstance(number, bool)


def _numbers(late: object) -> list[int | float]:
    """Return the numbers of an action; none for the last one.

    Raises:
        ConfigError: it is neither.
    """
    if late == REPEAT:
        return []
    numbers: list[int | float] = []
    if isinstance(late, str) and "_" not in late:  # which Python allows between digits
        with suppress(ValueError):
            numbers = [float(text) if "." in text else int(text) for text in late.split(",")]
    if not numbers or any(not -(2**31) <= number < 2**31 for number in numbers if isinstance(number, int)):
        raise ConfigError(
            f"late is `{REPEAT}`, or the numbers of an action, as in 0,1,0 or 0.0,-0.5; not {late!r:.80}",
            settings=("late",),
        )
    return numbers

"""The page of a run that is starting: `--view`.

A separate process serves it at a lower priority, and only reads the run's files, so it can neither slow the
run down nor break it. That process ends with the one that started it.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from glue.errors import ConfigError

COMMAND: Final = "view"
_STANDARD_STREAMS: Final = (0, 1, 2)

_REST_SECONDS: Final = 10.0
"""Time after which the page of a season that has exited is started again."""


def check_view(setting: str = "view") -> None:
    """Check, before anything is written, that the page can be served.

    Args:
        setting: that asks for it.

    Raises:
        ConfigError: Starlette or uvicorn is not installed.
    """
    if any(find_spec(name) is None for name in ("starlette", "uvicorn")):
        raise ConfigError(
            "the page needs Starlette and uvicorn: pip install 'glue-rl[web]'", settings=(setting,)
        )


@contextlib.contextmanager
def viewed(directory: Path, say: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """Show a run on a page; yield a function that waits, after the run, until the page is ended by Ctrl-C.

    Without a terminal the function does not wait, since a script would wait forever.

    Raises:
        ExperimentError: the page's process cannot be started.
    """
    from experiment_runner.processes import children

    process = children.start(COMMAND, [str(directory), "--stderr"])

    def wait() -> None:
        if process.poll() is None and any(map(os.isatty, _STANDARD_STREAMS)):
            say("the run is over; its page stays until Ctrl-C")
            with contextlib.suppress(KeyboardInterrupt):
                process.wait()
        say(f"to see the run again: glue-view {shlex.quote(str(directory))}")

    try:
        yield wait
    finally:
        process.kill()  # it only reads, so nothing is lost
        children.end(process)


@contextlib.contextmanager
def season_viewed(
    directory: Path, options: Mapping[str, object], say: Callable[[str], None]
) -> Iterator[None]:
    """Show a season on its page until the context ends; the page is started again however it ends.

    Args:
        directory: of the season.
        options: of `glue-compete page`, by name; those that are None, empty or False are left out.
        say: shows a line; called from any thread.

    Raises:
        ExperimentError: the page's process cannot be started.
    """
    from experiment_runner.processes.children import KeptAlive

    arguments = ["page", str(directory)]
    for name, value in options.items():
        if value:
            arguments += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
    with KeptAlive(
        "page of the season",
        "compete",
        arguments,
        say=say,
        progress=itertools.count().__next__,  # it may be killed any number of times in weeks
        give_up=lambda why: say(f"{why}: glue-compete page {shlex.quote(str(directory))} starts it again"),
        dismissed=False,
        rest=_REST_SECONDS,
    ):
        yield

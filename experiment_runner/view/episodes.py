"""The recorded episodes of a run, and the steps of one of them, for the page to show.

A recording is a file `*.traj` in the run's folder. It may come from anywhere, so it is read by
`glue.trajectory.TrajectoryReader`, whose memory is bounded, and the browser's request is
looked up among the files that were found.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from experiment_runner.view.catalog import Catalog
from experiment_runner.view.stream import Cache, Reader, as_json, json_response
from glue.errors import ExperimentError, TaskSpecError
from glue.taskspec import Bound, Ranges, parse_task_spec
from glue.trajectory import Answer, Episode, TrajectoryError, TrajectoryReader
from glue.types import Action

_SUFFIX: Final = ".traj"
_MOST_FILES: Final = 50
_MOST_EPISODES: Final = 10_000  # of a recording, that are listed
_MOST_STEPS: Final = 3_000_000  # of a recording, that are read to list it
_MOST_SENT_STEPS: Final = 100_000  # of an episode
_MOST_SENT_BYTES: Final = 64 * 2**20
_MOST_ANSWER_BYTES: Final = 8 * 2**20  # of all answers of an agent in an episode
_MOST_RUNS: Final = 500  # of equal ranges, of a task spec
_MOST_TEXT: Final = 2000

_ANSWER_BYTES: Final = 20  # of an answer in JSON, about, apart from its texts

_EPISODE: Final = re.compile(r"(?:([0-9a-f]{8})-)?([1-9][0-9]{0,8})")
_LENGTH: Final = struct.Struct("<I")
_REWARD: Final = struct.Struct("<d")


def routes(catalog: Catalog, read: Reader) -> list[BaseRoute]:
    """Return the routes of recordings.

    `/api/recordings/RUN` lists them as JSON. `/api/episodes/RUN/EPISODE` is an episode: the length of a JSON
    object (uint32, little-endian), the object, and for the start and each step the reward (float64), the
    action and the observation, both as `glue.types` has them; the start has an empty action.
    """

    async def recordings(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        return json_response(
            await read(lambda: [_listed(*item, cache) for item in _found(directory).items()])
        )

    async def episode(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        wanted = _EPISODE.fullmatch(request.path_params["episode"])
        if wanted is None:
            raise HTTPException(404, "there is no such episode")
        name, count = wanted[1] or "", int(wanted[2])
        return Response(
            await read(lambda: _found_episode(directory, name, count)), media_type="application/octet-stream"
        )

    cache = Cache()
    return [Route("/api/recordings/{run}", recordings), Route("/api/episodes/{run}/{episode}", episode)]


def described(task_spec: str) -> dict[str, Any]:
    """Return the observations and actions of a task spec as JSON: runs of equal ranges, each with its
    length, for ints and doubles, and the number of chars. `extra` is its free text."""
    try:
        spec = parse_task_spec(task_spec)
    except TaskSpecError:
        return {"text": task_spec[:_MOST_TEXT], "extra": ""}
    spaces = {"observation": spec.observations, "action": spec.actions}
    return {
        "text": task_spec[:_MOST_TEXT],
        "extra": spec.extra[:_MOST_TEXT],
        **{
            name: {"ints": _ranges(space.ints), "doubles": _ranges(space.doubles), "chars": space.chars}
            for name, space in spaces.items()
        },
    }


def _answers(episode: Episode) -> list[Answer]:
    """Return the beginning of each answer of the agent; only the first answers if there are too many."""
    shown: list[Answer] = []
    room = _MOST_ANSWER_BYTES
    for step, message, answer in episode.answers:
        shown.append(Answer(step, message[:_MOST_TEXT], answer[:_MOST_TEXT]))
        room -= len(shown[-1].message) + len(shown[-1].answer) + _ANSWER_BYTES
        if room < 0:
            return shown[:-1]
    return shown


def _ranges(ranges: Ranges) -> list[tuple[int, str]]:
    return [
        (repeat, f"{_bound(range_.low)} to {_bound(range_.high)}")
        for repeat, range_ in ranges.runs[:_MOST_RUNS]
    ]


def _bound(bound: Bound) -> str:
    if bound is None:
        return "not stated"
    return "no limit" if math.isinf(bound) else str(bound).removesuffix(".0")


def _found(directory: Path) -> dict[str, Path]:
    """Return the recordings of a run by their ids on the page: empty for the first."""
    try:
        with os.scandir(directory) as entries:
            # A run may come from elsewhere: no link is followed.
            files = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
    except OSError as error:
        raise ExperimentError(f"cannot read {directory}: {error.strerror}") from None
    names = sorted(name for name in files if name.endswith(_SUFFIX))[:_MOST_FILES]
    return {
        hashlib.sha256(os.fsencode(name)).hexdigest()[:8] if place else "": directory / name
        for place, name in enumerate(names)
    }


def _listed(name: str, path: Path, cache: Cache) -> dict[str, Any]:
    try:
        status = path.lstat()
    except OSError as error:
        return {"id": name, "name": path.name, "episodes": [], "error": str(error.strerror)}
    found: dict[str, Any] = cache.get(path, (status.st_mtime_ns, status.st_size), lambda: episodes_in(path))
    return {"id": name, "name": path.name, **found}


def episodes_in(path: Path) -> dict[str, Any]:
    """Return the episodes of a recording as JSON: number of steps, return and ending of each."""
    found: list[tuple[int, float | str, str]] = []
    steps = 0
    more = False
    error = None
    try:
        for episode in TrajectoryReader(path):
            if len(found) == _MOST_EPISODES or steps > _MOST_STEPS:
                more = True
                break
            steps += len(episode.steps)
            found.append((len(episode.steps), number(episode.episode_return), episode.ending.value))
    except TrajectoryError as wrong:
        error = str(wrong)
    return {"episodes": found, "more": more, "error": error}


def _found_episode(directory: Path, name: str, wanted: int) -> bytes:
    path = _found(directory).get(name)
    if path is None:
        raise HTTPException(404, "there is no such recording")
    for count, episode in enumerate(TrajectoryReader(path), 1):
        if count == wanted:
            return packed(path.name, count, episode)
    raise HTTPException(404, f"the recording has no episode {wanted}")


def packed(recording: str, count: int, episode: Episode) -> bytes:
    """Return an episode as the page plays it: see `routes`.

    Args:
        recording: its name, for display.
        count: the number of the episode in it, from 1.
        episode: with its observations.

    Raises:
        ExperimentError: it has none, or is too long for the page.
    """
    return b"".join(_pieces(recording, count, episode))


def _pieces(recording: str, count: int, episode: Episode) -> Iterator[bytes]:
    if episode.start is None:
        raise ExperimentError(f"{recording} has no observations: glue-replay shows it with its environment")
    size = len(episode.steps)
    header: Mapping[str, Any] = {
        "recording": recording,
        "episode": count,
        "steps": size,
        "ending": episode.ending.value,
        "environment": episode.run.environment[:_MOST_TEXT],
        "spec": described(episode.run.task_spec),
        "answers": _answers(episode),
    }
    encoded = as_json(header).encode()
    yield _LENGTH.pack(len(encoded)) + encoded
    yield _REWARD.pack(0.0) + Action().body + episode.start.body
    sent = 0
    for step in episode.steps:
        assert step.observation is not None  # as the start has one
        piece = _REWARD.pack(step.reward) + step.action.body + step.observation.body
        sent += len(piece)
        if size > _MOST_SENT_STEPS or sent > _MOST_SENT_BYTES:
            raise ExperimentError(
                f"episode {count} of {recording} has {size} steps: the page shows at most "
                f"{_MOST_SENT_STEPS} steps and {_MOST_SENT_BYTES >> 20} MiB of an episode: use glue-replay"
            )
        yield piece


def number(value: float) -> float | str:
    """Return a number for JSON, or a word that JavaScript reads as a number that JSON lacks."""
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"

"""A competition as its organiser describes it, and its TOML file; docs/competition.md describes both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_type_hints
from zoneinfo import ZoneInfo

import msgspec
from msgspec import Meta

from experiment_runner.competition.records.record import NAMES, is_name
from experiment_runner.plan.toml import SettingError, converted, is_option, naming_lines, parse, read, shown
from glue.errors import ConfigError, ExperimentError
from glue.hub.config import TimeLimits
from glue.pace import REPEAT, Pace
from glue.plugins.loading import located

_MEBIBYTE: Final = 2**20

_SIZE: Final = re.compile(r"(\d{1,12})([kmg]?)")
_UNITS: Final = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30}
_SIZES: Final = ("memory", "tmp", "shm", "log")
_LEAST_MEMORY: Final = 6 * _MEBIBYTE  # of Docker's containers

_Count = Annotated[int, Meta(ge=1, lt=2**31)]


@dataclass(frozen=True, slots=True)
class Limits(TimeLimits):
    """Limits of an entrant in each trial of a task: its time, and the rest, which holds only for containers;
    a trusted command may use all of this machine.

    Args:
        memory: bytes, swap included.
        cpus: cores; the least is Docker's.
        pids: processes and threads, the container's init among them.
        tmp: bytes of files in /tmp.
        shm: bytes of shared memory.
        log: bytes of its output that are kept.
    """

    memory: int = 1024 * _MEBIBYTE
    cpus: Annotated[float, Meta(ge=0.01, le=1024)] = 1.0
    pids: Annotated[int, Meta(ge=2, lt=2**22)] = 128
    tmp: int = 64 * _MEBIBYTE
    shm: int = 64 * _MEBIBYTE
    log: int = _MEBIBYTE


@dataclass(frozen=True, slots=True)
class Task:
    """An environment, and the number of episodes or steps to play.

    Args:
        name: unique among the tasks.
        env: the environment's name, `module:Class` or `path/file.py:Class`.
        options: its constructor options, as in the file, without those drawn from the secret seed.
        episodes: number of episodes; 0 if `steps` limits the task.
        steps: number of steps, over as many episodes as it takes; 0 if `episodes` limits the task.
        max_steps: the step limit of an episode, see `Experiment.rl_episode`; 0 for none. RL_num_steps is 1
            before the first step, so the least limit is 2.
        levels: files of the levels of its trials, the first again after the last; none if a seed is drawn.
        rate: steps per second of an environment that does not wait for its agent; 0 if it does.
        late: what is carried out while the agent is late, see `glue.pace.Pace`.
        phase: `proving` if it is played in the season, `testing` if afterwards.
        hidden: whether its scores are told only when the season is closed; of a proving task.
    """

    name: str
    env: str
    options: Mapping[str, Any] = field(default_factory=dict)
    episodes: _Count = 0
    steps: _Count = 0
    max_steps: Annotated[int, Meta(ge=2, lt=2**31)] = 0
    levels: tuple[Path, ...] = ()
    rate: float = 0.0
    late: str = REPEAT
    phase: Literal["proving", "testing"] = "testing"
    hidden: bool = False

    @property
    def pace(self) -> Pace:
        """The pace of its environment."""
        return Pace(self.rate, self.late)


@dataclass(frozen=True, slots=True)
class Entrant:
    """An entrant, and how it is started: exactly one of image, command, key and folder is given.

    Args:
        name: unique among the entrants.
        image: a container image.
        command: a trusted program on this machine, and its arguments.
        key: the file of the public key of an entrant that connects from elsewhere.
        folder: a folder for programs that another tool starts, such as compose: one program for each trial,
            which finds the socket `hub` in the subfolder `TASK-TRIAL`.
        id: what the name stood for when the entrant was admitted, and stands for throughout the run: the id
            of its image, or its public key. Empty for others, and before that.
    """

    name: str
    image: str | None = None
    command: tuple[str, ...] = ()
    key: Path | None = None
    folder: Path | None = None
    id: str = ""

    @property
    def player(self) -> str:
        """The player, for display: image, command, folder, or file of the key."""
        if self.image is not None:
            return self.image
        if self.folder is not None:
            return str(self.folder)
        return " ".join(self.command) if self.key is None else self.key.name


@dataclass(frozen=True, slots=True)
class Gate:
    """The address at which entrants from elsewhere connect.

    Args:
        bind: URL that the hub listens on for them.
        keys: the directory with the hub's own pair of keys, see `glue.keys.allowed`.
    """

    bind: str
    keys: Path


@dataclass(frozen=True, slots=True)
class Season:
    """The rules of a season, in which entrants come, and play the proving tasks as often as they may.

    Args:
        opens: from when attempts can be asked for, with its time zone.
        closes: until when; those that wait then are still played.
        freeze: from when the public board no longer changes, until it is thawed or closed; None for never.
        zone: name of the time zone of times without one, and of the days of `attempts_per_day`.
        attempts_per_day: of each entrant.
        parallel: number of attempts that are played at once.
        enrol: `code` for those who know the code, `open` for everyone, `closed` for no one.
        code_file: the file of the code; None if it is in an environment variable.
        code_env: the environment variable of the code; None if it is in a file.
        count: which attempts count: each entrant's best, its last, or the mean of all.
        names: whether the public board shows pseudonyms or the entrants' own names.
        teams: whether entrants may name a team.
        images: whether entrants may submit images.
        failures: number of forfeited attempts in a row after which an entrant is paused.
        most_entrants: number of entrants that can enrol.
        most_waiting: number of attempts of one entrant that can wait at once.
        most_bytes: of an image.
    """

    opens: datetime
    closes: datetime
    freeze: datetime | None = None
    zone: str = "UTC"
    attempts_per_day: _Count = 5
    parallel: Annotated[int, Meta(ge=1, le=1000)] = 1
    enrol: Literal["code", "open", "closed"] = "code"
    code_file: Path | None = None
    code_env: str | None = None
    count: Literal["best", "last", "mean"] = "best"
    names: Literal["pseudonyms", "own"] = "pseudonyms"
    teams: bool = False
    images: bool = False
    failures: _Count = 3
    most_entrants: _Count = 1000
    most_waiting: _Count = 10
    most_bytes: int = 2048 * _MEBIBYTE

    @property
    def days(self) -> ZoneInfo:
        """The time zone `zone`."""
        return ZoneInfo(self.zone)


@dataclass(frozen=True, slots=True)
class Competition:
    """A competition.

    Args:
        name: for display.
        trials: number of times that every entrant plays every task.
        tasks: in the order of the file.
        entrants: in the order of the file.
        limits: the same for all.
        seed_file: the file of the secret seed; None if it is in an environment variable.
        seed_env: the environment variable of the secret seed; None if it is in a file.
        season: in which the proving tasks are played; None if there are none.
    """

    name: str = ""
    trials: Annotated[int, Meta(ge=1, le=1000)] = 1
    tasks: tuple[Task, ...] = ()
    entrants: tuple[Entrant, ...] = ()
    limits: Limits = field(default_factory=Limits)
    seed_file: Path | None = None
    seed_env: str | None = None
    season: Season | None = None

    @property
    def proving(self) -> tuple[Task, ...]:
        """The tasks of the season."""
        return tuple(task for task in self.tasks if task.phase == "proving")

    @property
    def testing(self) -> tuple[Task, ...]:
        """The tasks that every entrant plays once, after the season if there is one."""
        return tuple(task for task in self.tasks if task.phase == "testing")


def load_competition(path: Path, *, follow: bool = True) -> Competition:
    """Return the competition that a TOML file describes.

    Raises:
        ConfigError: the file cannot be read or describes no competition; the message names file and line.
    """
    try:
        text = read(path, "competition", follow)
    except ExperimentError as error:
        raise ConfigError(str(error)) from error
    return parse_competition(text, path)


def parse_competition(text: str, path: Path) -> Competition:
    """Return the competition that a TOML text describes.

    Args:
        text: of the file.
        path: of the file, for messages; other files are relative to its folder.

    Raises:
        ConfigError: it describes no competition; the message names file and line.
    """
    try:
        with naming_lines(path, text):
            return _competition(parse(text), path)
    except ExperimentError as error:
        raise ConfigError(str(error)) from error


def _competition(document: Mapping[str, Any], path: Path) -> Competition:
    folder = path.parent
    own = {**document, "tasks": [], "entrants": [], "limits": {}, "season": None}
    found = converted(Competition, own, "a competition", base=folder)
    if (found.seed_file is None) == (found.seed_env is None):
        raise SettingError(
            'name the secret from which levels are drawn, once: seed_file = "secret.txt", '
            'or seed_env = "COMPETITION_SEED"',
            "seed_env",
        )
    season = None if "season" not in document else _season(document["season"], folder)
    entrants = [] if season is not None and "entrants" not in document else _tables(document, "entrants")
    found = replace(
        found,
        name=found.name or path.stem,
        tasks=tuple(_task(name, table, folder) for name, table in _tables(document, "tasks")),
        entrants=tuple(_entrant(name, table, folder) for name, table in entrants),
        limits=_limits(document.get("limits", {})),
        season=season,
    )
    if season is not None and all(task.hidden for task in found.proving):
        raise SettingError(
            'a season needs a task that is played in it and not hidden: phase = "proving"', "tasks"
        )
    if season is None and found.proving:
        name = found.proving[0].name
        raise SettingError(
            "a proving task is played in a season, and there is no table [season]", "tasks", name, "phase"
        )
    return found


def changes(was: Season, now: Season) -> dict[str, str]:
    """Return the settings in which two seasons differ, with their new values as JSON.

    The place of the code is none of them: it is no rule, and relative to the file that names it.
    """
    return {
        one.name: msgspec.json.encode(getattr(now, one.name)).decode()
        for one in fields(Season)
        if one.name not in ("code_file", "code_env") and getattr(was, one.name) != getattr(now, one.name)
    }


def changed(season: Season, name: str, value: str) -> Season:
    """Return a season with another value, as JSON, of one setting.

    Raises:
        ExperimentError: there is no such setting, or it cannot have this value.
    """
    hints = get_type_hints(Season, include_extras=True)
    try:
        return replace(season, **{name: msgspec.json.decode(value, type=hints[name])})
    except (KeyError, ValueError, RecursionError):
        raise ExperimentError(f"a season cannot have {name:.80} = {value:.80}") from None


def _tables(document: Mapping[str, Any], kind: str) -> list[tuple[str, Any]]:
    """Return the tables of the tasks or the entrants, with their names."""
    tables = document.get(kind)
    if not isinstance(tables, dict) or not tables:
        raise SettingError(f"a competition needs {kind}, each a table, as in: [{kind}.NAME]", kind)
    for name in tables:
        if not is_name(name):
            raise SettingError(f"{name!r} cannot be a name: {NAMES}", kind, name)
    return list(tables.items())


def _season(table: object, folder: Path) -> Season:
    if isinstance(table, dict) and "most_bytes" in table:
        table = table | {"most_bytes": _size("most_bytes", table["most_bytes"], "season")}
    found = converted(Season, table, "[season]", "season", base=folder)
    try:
        zone = found.days
    except (OSError, ValueError, KeyError):
        raise SettingError(
            f'zone is the name of a time zone, as in "Europe/Berlin", not {shown(found.zone)}',
            "season",
            "zone",
        ) from None
    times = {name: getattr(found, name) for name in ("opens", "closes", "freeze")}
    found = replace(
        found, **{key: time.replace(tzinfo=time.tzinfo or zone) for key, time in times.items() if time}
    )
    if not found.opens <= (found.freeze or found.opens) < found.closes:
        raise SettingError("a season opens first, may freeze then, and closes", "season", "closes")
    if found.enrol == "code" and (found.code_file is None) == (found.code_env is None):
        raise SettingError(
            'name the code with which entrants enrol, once: code_file = "code.txt" or code_env = "CODE"; or '
            'admit everyone, or no one: enrol = "open", enrol = "closed"',
            "season",
            "enrol",
        )
    return found


def _task(name: str, table: object, folder: Path) -> Task:
    where = ("tasks", name)
    task = converted(Task, table, f"task {name}", *where, base=folder, name=name)
    try:
        task.pace  # noqa: B018  # checks both
    except ConfigError as error:
        raise SettingError(f"task {name}: {error}", *where, *error.settings[:1]) from None
    if task.hidden and task.phase != "proving":
        raise SettingError(f"task {name} is played once, so its scores are hidden anyway", *where, "hidden")
    if (task.episodes == 0) == (task.steps == 0):
        raise SettingError(f"task {name} needs its length: episodes = 20, or steps = 100_000", *where)
    for option, value in task.options.items():
        if not is_option(value):
            raise SettingError(
                f"option {option!r:.80} takes a number, a string, true or false, not {shown(value)}",
                *(*where, "options", option),
            )
    return replace(task, env=located(task.env, folder))


def _entrant(name: str, table: object, folder: Path) -> Entrant:
    where = ("entrants", name)
    entrant = converted(Entrant, table, f"entrant {name}", *where, base=folder, name=name, id="")
    if sum(map(bool, (entrant.image, entrant.command, entrant.key, entrant.folder))) != 1:
        raise SettingError(
            f'entrant {name} needs one of image = "alice/agent:1", command = ["glue-agent", "sample"], '
            'key = "carol.pub" and folder = "/run/entrants/dave"',
            *where,
        )
    return entrant


def _limits(table: Any) -> Limits:
    if isinstance(table, dict):
        table = table | {key: _size(key, table[key]) for key in _SIZES if key in table}
    try:
        return converted(Limits, table, "[limits]", "limits")
    except ConfigError as error:  # of a time; the message begins with its name
        raise SettingError(str(error), "limits", str(error).partition(" ")[0]) from error


def _size(key: str, value: object, table: str = "limits") -> int:
    text = str(value) if isinstance(value, str) or (type(value) is int and 0 < value < 2**62) else ""
    match = _SIZE.fullmatch(text.lower())
    size = int(match[1]) * _UNITS[match[2]] if match else 0
    if size < (_LEAST_MEMORY if key == "memory" else 1):
        least = ' of at least "6m"' if key == "memory" else ""
        raise SettingError(
            f'{key} is a number of bytes{least}, as in: {key} = "512m"; not {shown(value)}', table, key
        )
    return size

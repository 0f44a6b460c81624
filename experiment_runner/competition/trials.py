"""The secret seed of a competition, and the seeds, levels and pseudonyms drawn from it.

Everything that depends on the secret is derived by HMAC-SHA-256, from which the secret cannot be computed:
the level of one trial says nothing about the level of another.
"""

from __future__ import annotations

import hashlib
import hmac
import itertools
import os
import stat
from collections.abc import Callable, Collection, Iterable, MutableMapping
from pathlib import Path
from typing import Final, NamedTuple

from experiment_runner.competition.records.journal import Act
from experiment_runner.competition.settings import Competition, Season, Task
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.plan.user_files import with_digests
from experiment_runner.store.database import reported
from glue.errors import ConfigError
from glue.files import open_regular
from glue.options import Value, build, parameters
from glue.plugins.loading import find
from glue.wire.messages import Role

_LEVEL_SEED: Final = "level_seed"
_NAMES_A_LEVEL: Final = (_LEVEL_SEED, "mdp")
"""Options with which a task itself names its level."""
_LEVEL: Final = "level"
_LEVEL_DIGEST: Final = "level_digest"
"""Options of an environment that reads a level from a file."""

_COLOURS: Final = ("amber", "azure", "coral", "crimson", "emerald", "golden", "indigo", "ivory", "jade")
_ANIMALS: Final = ("badger", "crane", "falcon", "fox", "heron", "ibis", "lynx", "otter", "owl", "raven")
_NUMBERS: Final = 1_000_000

_SEED_BITS: Final = 63
_MAX_SECRET: Final = 65_536
_HINT: Final = "make one with: head -c 32 /dev/urandom | base64 >"

Warn = Callable[[str], None]
"""Shows a line."""


def read_secret(
    competition: Competition, variables: MutableMapping[str, str], warn: Warn = lambda line: None
) -> bytes:
    """Return the secret seed of a competition, without the white space around it.

    An environment variable that holds the secret is removed from `variables`.

    Args:
        competition: names the file or variable of the secret.
        variables: the environment variables of the process; a program started later inherits no secret.
        warn: shows a line about a file that other users can read.

    Raises:
        ConfigError: there is no secret, or it is empty.
    """
    path, name = competition.seed_file, competition.seed_env
    return _read("the secret seed", path, name, f"{_HINT} {path or 'FILE'}", variables, warn)


def read_code(
    season: Season, variables: MutableMapping[str, str], warn: Warn = lambda line: None
) -> str | None:
    """Return the code with which entrants enrol, as by `read_secret`; None if they need none.

    Raises:
        ConfigError: there is no code, or it is empty.
    """
    if season.enrol != "code":
        return None
    how = "write into it what you tell those who may take part"
    code = _read("the code", season.code_file, season.code_env, how, variables, warn)
    return code.decode(errors="replace")


def _read(
    what: str, path: Path | None, name: str | None, hint: str, variables: MutableMapping[str, str], warn: Warn
) -> bytes:
    if path is None:
        secret, where = variables.pop(name or "", "").encode(), f"the environment variable {name}"
        if not secret:
            raise ConfigError(f"{where} must hold {what}: {name}=... glue-compete ...")
    else:
        where = str(path)
        try:
            with open_regular(path, follow=True) as file:
                secret = file.read(_MAX_SECRET)
                mode = os.fstat(file.fileno()).st_mode
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(f"cannot read {what} {path}: {reason}; {hint}") from None
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            warn(f"other users can read {what}: chmod 600 {path}")
    if not secret.strip():
        raise ConfigError(f"{where} is empty, but it must hold {what}; {hint}")
    return secret.strip()


def draw(secret: bytes, *names: str) -> int:
    """Return the number that belongs to these names, 0 <= number < 2**63."""
    message = b"".join(len(name).to_bytes(4, "little") + name.encode() for name in names)
    return int.from_bytes(hmac.digest(secret, message, hashlib.sha256)[:8], "little") >> (64 - _SEED_BITS)


def pseudonym(name: str, secret: bytes, taken: Collection[str]) -> str:
    """Return a pseudonym that is not taken, and that tells the name only to those who know the secret."""
    rest, colour = divmod(int.from_bytes(derived(secret, "alias", name)), len(_COLOURS))
    rest, animal = divmod(rest, len(_ANIMALS))
    alias = f"{_COLOURS[colour]} {_ANIMALS[animal]}"
    numbered = (f"{alias} {(rest + number) % _NUMBERS}" for number in itertools.count())
    return next(one for one in itertools.chain([alias], numbered) if one not in taken)


def derived(secret: bytes, *names: str) -> bytes:
    """Return 32 bytes that belong to these names, and that only those who know the secret can compute."""
    return hmac.digest(secret, "\0".join(names).encode(), "sha256")


class Level(NamedTuple):
    """The part of a trial of a task that is the same for all entrants.

    task, number  of the trial; number from 0
    environment   with the options that were drawn
    seed          of the trial
    """

    task: Task
    number: int
    environment: RoleSpec
    seed: int

    def trial(self, entrant: str, player: str, identity: str, number: int | None = None) -> TrialSpec:
        """Return the trial for an entrant.

        Args:
            entrant: its name.
            player: `Entrant.player`.
            identity: `Entrant.id`.
            number: of the trial; None for that of the level.
        """
        return TrialSpec(
            id=TrialId.of(entrant, self.task.name, self.number if number is None else number),
            agent=RoleSpec(player, {"id": identity} if identity else {}, entrant),
            environment=self.environment,
            episodes=self.task.episodes or self.task.steps,  # an episode has at least one step
            max_steps=self.task.max_steps,
            seed=self.seed,
            pace=self.task.pace,
        )


def levels(competition: Competition, secret: bytes) -> list[Level]:
    """Return the levels of every trial of every task, drawn from the competition's secret.

    All entrants play the same level in a trial of a task, and another one in the next trial.

    Raises:
        ConfigError: there is no such environment, or an option is wrong.
    """
    return [
        Level(
            task,
            number,
            _environment(task, draw(secret, _LEVEL_SEED, task.name, str(number)), number),
            draw(secret, "trial", task.name, str(number)),
        )
        for task in competition.tasks
        for number in range(competition.trials)
    ]


def trials(competition: Competition, secret: bytes) -> list[TrialSpec]:
    """Return every trial of the testing tasks of a competition.

    Raises:
        ConfigError: as `levels`.
    """
    return [
        level.trial(entrant.name, entrant.player, entrant.id)
        for level in levels(competition, secret)
        if level.task.phase == "testing"
        for entrant in competition.entrants
    ]


def attempt_trials(levels: Iterable[Level], count: int, start: Act) -> list[TrialSpec]:
    """Return the trials of an attempt: those of every proving task, in the order of the file.

    Args:
        levels: of the competition.
        count: number of trials of each task.
        start: the act that lets the attempt play, with the player and its id.
    """
    return [
        level.trial(start.subject, start.player, start.id, (start.number - 1) * count + level.number)
        for level in levels
        if level.task.phase == "proving"
    ]


def public_trial(task: Task, entrant: str, episodes: int, max_steps: int) -> TrialSpec:
    """Return a trial of a task in which nothing is secret, for trying out an entrant.

    Raises:
        ConfigError: as `trials`.
    """
    environment = _environment(task, None)
    trial, agent = TrialId.of(entrant, task.name, 0), RoleSpec(entrant)
    return TrialSpec(trial, agent, environment, episodes, max_steps, 0, pace=task.pace)


def agent_seed(spec: TrialSpec) -> int:
    """Return the seed that a trial's agent's seed is derived from; it does not reveal the environment's."""
    return draw(spec.seed.to_bytes(8, "little"), "agent")


def _environment(task: Task, level_seed: int | None, number: int = 0) -> RoleSpec:
    factory = find(Role.ENVIRONMENT, task.env)
    options: dict[str, Value] = dict(task.options)
    known = parameters(factory)
    if _LEVEL_DIGEST in known and _LEVEL in options:
        raise ConfigError(f"task {task.name}: levels from files are not an option: levels = [...]")
    if task.levels and _LEVEL_DIGEST not in known:
        raise ConfigError(f"task {task.name}: {task.env} reads no levels from files: leave out levels")
    drawn = known.get(_LEVEL_SEED)
    if task.levels and level_seed is not None:
        path = str(task.levels[number % len(task.levels)].absolute())
        with reported("cannot read a level"):
            options = with_digests({**options, _LEVEL: path}, known)
    elif drawn is not None and level_seed is not None and not options.keys() & _NAMES_A_LEVEL:
        low = 0 if drawn.option.low is None else max(0, int(drawn.option.low))
        high = 2**31 - 1 if drawn.option.high is None else int(drawn.option.high)
        options[_LEVEL_SEED] = low + level_seed % (high - low + 1)
    try:
        build(factory, options)
    except ConfigError as error:
        raise ConfigError(f"task {task.name}: {error}") from None
    return RoleSpec(task.env, options, task.name)

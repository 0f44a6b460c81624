"""The secret seed of a competition, and the seeds and levels drawn from it.

Everything that depends on the secret is derived by HMAC-SHA-256, from which the secret cannot be computed:
the level of one trial says nothing about the level of another.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from collections.abc import Callable, MutableMapping
from typing import Final

from experiment_runner.competition.settings import Competition, Task
from experiment_runner.plan.ids import TrialId
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

_SEED_BITS: Final = 63
_MAX_SECRET: Final = 65_536
_HINT: Final = "make one with: head -c 32 /dev/urandom | base64 >"


def read_secret(
    competition: Competition,
    variables: MutableMapping[str, str],
    warn: Callable[[str], None] = lambda line: None,
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
    path = competition.seed_file
    if path is None:
        name = competition.seed_env or ""
        secret, where = variables.pop(name, "").encode(), f"the environment variable {name}"
        if not secret:
            raise ConfigError(f"{where} must hold the secret seed: {name}=... glue-compete ...")
    else:
        where = str(path)
        try:
            with open_regular(path, follow=True) as file:
                secret = file.read(_MAX_SECRET)
                mode = os.fstat(file.fileno()).st_mode
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(f"cannot read the secret seed {path}: {reason}; {_HINT} {path}") from None
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            warn(f"other users can read the secret seed: chmod 600 {path}")
    if not secret.strip():
        raise ConfigError(f"{where} is empty, but it must hold the secret seed; {_HINT} {path or 'FILE'}")
    return secret.strip()


def draw(secret: bytes, *names: str) -> int:
    """Return the number that belongs to these names, 0 <= number < 2**63."""
    message = b"".join(len(name).to_bytes(4, "little") + name.encode() for name in names)
    return int.from_bytes(hmac.digest(secret, message, hashlib.sha256)[:8], "little") >> (64 - _SEED_BITS)


def trials(competition: Competition, secret: bytes) -> list[TrialSpec]:
    """Return every trial of a competition, with the levels drawn from its secret.

    All entrants play the same level in a trial of a task, and another one in the next trial.

    Raises:
        ConfigError: there is no such environment, or an option is wrong.
    """
    specs = []
    for task in competition.tasks:
        for number in range(competition.trials):
            name = str(number)
            seed = draw(secret, "trial", task.name, name)
            environment = _environment(task, draw(secret, _LEVEL_SEED, task.name, name), number)
            specs += [
                TrialSpec(
                    id=TrialId.of(entrant.name, task.name, number),
                    agent=RoleSpec(entrant.player, {"id": entrant.id} if entrant.id else {}, entrant.name),
                    environment=environment,
                    episodes=task.episodes or task.steps,  # an episode has at least one step
                    max_steps=task.max_steps,
                    seed=seed,
                    pace=task.pace,
                )
                for entrant in competition.entrants
            ]
    return specs


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

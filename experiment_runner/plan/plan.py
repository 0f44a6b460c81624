"""An experiment as data: agents, environments, a budget in episodes or in steps, trials, a seed.

Every agent plays every environment, in every combination of the swept values, `trials` times. See
`experiment_runner.plan.file` for its file format.

A trial's id names its combination, as in `hierarchical/step_size=0.1/mario/level_difficulty=0/3`,
and its seed is derived from the experiment's seed and the trial's number only. So all combinations get the
same seeds and can be compared in pairs, results do not depend on names, and a plan that is extended by an
agent, a value or a trial keeps its existing trials.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from experiment_runner.plan.limits import BUDGETS, COUNTS, PACE, REMOTE, TrialId, label_of
from experiment_runner.plan.metrics import MetricsPlan, Summary, check_extras
from experiment_runner.plan.toml import SettingError, is_option, shown
from experiment_runner.plan.tuning import Range, TunePlan
from glue.console import did_you_mean
from glue.errors import ConfigError
from glue.options import Value, parameters
from glue.pace import REPEAT, Pace
from glue.plugins.loading import file_in, located, short_name

ROLES: Final = ("environments", "agents")

_MOST_TRIALS: Final = 10_000_000  # of a run: they are in memory, at a kilobyte each

Seeds = Literal["number", "id"]
"""The part of a trial from which its seed is derived, with the experiment's seed; `id` before 0.3.0."""


def _in(name: str) -> Meta:
    return Meta(ge=COUNTS[name][0], le=COUNTS[name][-1])


@dataclass(frozen=True, slots=True)
class RoleSpec:
    """An agent or environment and its options, from which it can be constructed.

    Args:
        name: an entry point's name, `module:Class` or `path/file.py:Class`.
        options: constructor options by name.
        label: its name in tables and figures.
    """

    name: str
    options: Mapping[str, Value] = field(default_factory=dict)
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label or _default_label(self.name))


@dataclass(frozen=True, slots=True)
class RoleSweep:
    """An agent or environment of a plan: a `RoleSpec`, except that a tuple of values is swept over.

    Args:
        name: as in `RoleSpec`.
        options: values by name; a tuple of values is swept over.
        label: of any characters; those that cannot be part of a trial's id are replaced.

    Raises:
        SettingError: a value cannot be part of a plan.
    """

    name: str
    options: Mapping[str, Value | tuple[Value, ...]] = field(default_factory=dict)
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", label_of(self.label) if self.label else _default_label(self.name))
        for option, value in self.options.items():
            values = value if isinstance(value, tuple) else (value,)
            if not values:
                raise SettingError(f"option {option} of {self.label} has an empty list of values", option)
            for one in values:
                if not is_option(one):
                    raise SettingError(
                        f"option {option} of {self.label} takes a number, a string, true or false, "
                        f"or a list of these, not {shown(one)}",
                        option,
                    )

    def expand(self) -> list[tuple[str, RoleSpec]]:
        """Return every combination of the swept values, each with its part of a trial's id."""
        expanded = []
        for values in itertools.product(*map(_as_tuple, self.options.values())):
            options = dict(zip(self.options, values, strict=True))
            swept = [f"{o}={plain(v)}" for o, v in options.items() if isinstance(self.options[o], tuple)]
            expanded.append(("/".join([self.label, *swept]), RoleSpec(self.name, options, self.label)))
        return expanded


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """One trial: everything that determines its results.

    Args:
        id: unique in its plan.
        agent: None if it connects from outside.
        environment: None if it connects from outside.
        episodes: number of episodes; 0 if the trial has a budget of steps.
        max_steps: the step limit of `Experiment.rl_episode`; 0 for none.
        seed: random seed, 0 <= seed < 2**63.
        steps: budget of the trial, over all episodes; 0 if it has a number of episodes.
        pace: of the environment.
    """

    id: TrialId
    agent: RoleSpec | None
    environment: RoleSpec | None
    episodes: int
    max_steps: int
    seed: int
    steps: int = 0
    pace: Pace = field(default_factory=Pace)

    def __post_init__(self) -> None:
        object.__setattr__(self, "id", TrialId(self.id))  # also for a spec from a database or another process

    def finished_by(self, episodes: int, steps: int) -> bool:
        """Return whether a trial is finished after `episodes` episodes with `steps` steps in all."""
        return steps == self.steps if self.steps else episodes == self.episodes

    def named(self, joined: Mapping[tuple[str, str], str]) -> str:
        """Return the id with the names of players from outside, as in `Jumper/mines/0`.

        Args:
            joined: their names by trial and role.
        """
        agent = joined.get((self.id, "agent")) if self.agent is None else None
        environment = joined.get((self.id, "environment")) if self.environment is None else None
        return self.id.naming(agent, environment)

    def labels(self, joined: Mapping[tuple[str, str], str]) -> dict[str, str]:
        """Return the label of each player by its role; for one from outside its name, as in `named`."""
        roles = {"agent": self.agent, "environment": self.environment}
        return {
            name: role.label if role else joined.get((self.id, name), REMOTE) for name, role in roles.items()
        }

    @property
    def environment_label(self) -> str:
        """The environment's label; `REMOTE` if it joins from outside."""
        return self.environment.label if self.environment else REMOTE

    def step_limit(self, steps: int) -> int:
        """Return the step limit of the next episode, 0 for none.

        Args:
            steps: number of steps in all episodes so far.
        """
        left = self.steps - steps if self.steps else 0
        return min(self.max_steps, left) if self.max_steps and left else self.max_steps or left


@dataclass(frozen=True, slots=True)
class Plan:
    """An experiment; see the top of this module.

    Args:
        episodes: number in each trial; 0 if the trial has a budget of steps.
        steps: budget of each trial, over all episodes; the last one is cut off. 0 if it has a number of
            episodes.
        max_steps: step limit of an episode, as in `TrialSpec`.
        trials: of each combination, at least 1.
        seed: of the experiment.
        environments: swept; empty if the environment joins from outside.
        agents: the same for the agent.
        seeds: the part of a trial from which its seed is derived.
        inside: players that are objects in the process of a trial, of `PLAYERS`; does not affect results.
        metrics: the agents' metrics to record; None for none.
        extras: the environments' extras to record, and as what; see `experiment_runner.plan.metrics`.
        tune: the search for the agents' options; None for none.
        rate, late, delay: the pace of every environment, see `glue.pace.Pace`.

    Raises:
        SettingError: it has no length or two, two agents or environments share a label, or the search is
            for an agent that it does not have.
    """

    episodes: Annotated[int, _in("episodes")] = 0
    max_steps: Annotated[int, _in("max_steps")] = 0
    trials: Annotated[int, _in("trials")] = 1
    seed: Annotated[int, _in("seed")] = 0
    environments: tuple[RoleSweep, ...] = ()
    agents: tuple[RoleSweep, ...] = ()
    seeds: Seeds = "number"
    inside: tuple[Literal["agent", "env"], ...] = ()
    steps: Annotated[int, _in("steps")] = 0
    metrics: MetricsPlan | None = None
    extras: Mapping[str, Summary] = field(default_factory=dict)
    tune: TunePlan | None = None
    rate: float = 0.0
    late: str = REPEAT
    delay: int = 0

    def __post_init__(self) -> None:
        try:
            self.pace  # noqa: B018  # checks the three
        except ConfigError as error:
            raise SettingError(str(error), *error.settings[:1]) from None
        if bool(self.episodes) == bool(self.steps):
            raise SettingError(
                "a trial ends after a number of episodes or of steps: a plan needs "
                f"{'only ' if self.steps else ''}one of them, as in: episodes = 1000",
                *(["steps"] if self.steps else []),
            )
        for role in ROLES:
            labels = [sweep.label for sweep in getattr(self, role)]
            for label in labels:
                if labels.count(label) > 1:
                    raise SettingError(f"two {role} are called {label}; label them apart", role, label)
        check_extras(self.extras, [sweep.label for sweep in self.environments] or [REMOTE])
        if self.tune is not None:
            labels = [sweep.label for sweep in self.agents]
            for label in self.tune.agents:
                if label not in labels:
                    near = did_you_mean(label, labels)
                    raise SettingError(
                        f"tune.agents.{label} is not an agent of the plan{near}", "tune", "agents", label
                    )

    @property
    def pace(self) -> Pace:
        """The pace of every environment."""
        return Pace(self.rate, self.late, self.delay)

    def expand(self, numbers: range | None = None) -> list[TrialSpec]:
        """Return every trial; those of one combination follow each other.

        Args:
            numbers: of the trials of each combination; None for those from 0.

        Raises:
            SettingError: two trials would have the same id, as when a value is listed twice; or there are too
                many trials for a run.
        """
        numbers = range(self.trials) if numbers is None else numbers
        combinations = [sum(map(_combinations, sweeps)) or 1 for sweeps in (self.agents, self.environments)]
        if math.prod(combinations) * len(numbers) > _MOST_TRIALS:
            raise SettingError(f"the plan has more than {_MOST_TRIALS:,} trials: sweep over fewer values")
        specs = []
        for (agent_part, agent), (environment_part, environment) in itertools.product(
            _expand_role(self.agents), _expand_role(self.environments)
        ):
            for number in numbers:
                name = TrialId.of(agent_part, environment_part, number)
                seed = trial_seed(self.seed, str(number) if self.seeds == "number" else name)
                limits = (self.episodes, self.max_steps, seed, self.steps, self.pace)
                specs.append(TrialSpec(name, agent, environment, *limits))
        seen = set()
        for spec in specs:
            if spec.id in seen:
                raise SettingError(f"the plan has trial {spec.id} twice: is a value listed twice?")
            seen.add(spec.id)
        return specs


def length_of(plan: Plan | TrialSpec) -> str:
    """Return the length of a trial, as in `100 episodes` or `20,000 steps`."""
    return f"{plan.steps:,} steps" if plan.steps else f"{plan.episodes:,} episodes"


def budget(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given numbers of a plan, with 0 for the budget that one of them replaces."""
    ours = [name for name in BUDGETS if given.get(name)]
    return {**given, **{name: 0 for name in BUDGETS if len(ours) == 1 and name not in ours}}


def trial_seed(seed: int, trial: str) -> int:
    """Return the seed of a trial, 0 <= seed < 2**63.

    Args:
        seed: of the experiment.
        trial: the trial's number in decimal or, with seeds derived from it, its id.
    """
    digest = hashlib.sha256(trial.encode()).digest()
    words = tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, len(digest), 4))
    import numpy as np  # imported here, so that --help does not need it

    state = np.random.SeedSequence(seed, spawn_key=words).generate_state(1, np.uint64)
    return int(state[0]) >> 1


def absolute(plan: Plan, folder: Path) -> Plan:
    """Return the plan with every relative `path/file.py:Class` resolved against `folder`."""

    def resolved(sweep: RoleSweep) -> RoleSweep:
        return replace(sweep, name=located(sweep.name, folder))

    return replace(
        plan, environments=tuple(map(resolved, plan.environments)), agents=tuple(map(resolved, plan.agents))
    )


def class_files(roles: Iterable[RoleSweep | RoleSpec | None]) -> list[str]:
    """Return the files of the classes that are named as `path/file.py:Class`, without duplicates."""
    files = [file_in(role.name) for role in roles if role is not None]
    return list(dict.fromkeys(file for file in files if file))


def check_options(plan: Plan, find: Callable[[str, str], type]) -> Plan:
    """Return the plan with every option checked against its class; ints become floats where needed.

    Args:
        find: returns the class for a role ("agent" or "environment") and a name.

    Raises:
        SettingError: a class cannot be found, or an option is unknown to its class or has an invalid value.
    """

    def checked(role: str, sweep: RoleSweep, *where: str) -> RoleSweep:
        """Return `sweep` with its options checked; `where` are the keys of its table in the plan."""
        try:
            factory = find(role, sweep.name)
        except ConfigError as error:
            raise SettingError(str(error), f"{role}s", sweep.label, "class") from error
        known = parameters(factory)
        options: dict[str, Value | tuple[Value, ...]] = {}
        for name, value in sweep.options.items():
            if name not in known:
                near = did_you_mean(name, known)
                raise SettingError(f"{sweep.label} has no option {name}{near}", *where, name)
            check = known[name].check
            try:
                options[name] = tuple(map(check, value)) if isinstance(value, tuple) else check(value)
            except ConfigError as error:
                raise SettingError(f"{sweep.label}: {error}", *where, name) from None
        return replace(sweep, options=options)

    spaces = plan.tune.agents if plan.tune else {}
    for sweep in plan.agents:
        if space := spaces.get(sweep.label):
            ends = {name: (v.at(0), v.at(1)) if isinstance(v, Range) else v for name, v in space.items()}
            checked("agent", RoleSweep(sweep.name, ends, sweep.label), "tune", "agents", sweep.label)
    environments = (checked("environment", one, "environments", one.label) for one in plan.environments)
    agents = (checked("agent", one, "agents", one.label) for one in plan.agents)
    return replace(plan, environments=tuple(environments), agents=tuple(agents))


def differences(ours: Plan, theirs: Plan) -> list[str]:
    """Return the differences of `theirs` from `ours`, one line for each."""
    found = [
        f"{name} is {getattr(theirs, name)}, not {getattr(ours, name)}"
        for name in (*COUNTS, *PACE)
        if getattr(ours, name) != getattr(theirs, name)
    ]
    if ours.tune != theirs.tune:
        found.append("tune differs")
    if ours.metrics != theirs.metrics:
        was, become = (plan.metrics or "not recorded" for plan in (ours, theirs))
        found.append(f"metrics are {become}; they were {was}")
    if ours.extras != theirs.extras:
        found.append(f"extras are {dict(theirs.extras)}, not {dict(ours.extras)}")
    for role in ROLES:
        our_sweeps, their_sweeps = ({s.label: s for s in getattr(plan, role)} for plan in (ours, theirs))
        found += [f"{role} lack {label}" for label in our_sweeps if label not in their_sweeps]
        found += [f"{role} include {label}" for label in their_sweeps if label not in our_sweeps]
        for label, our in our_sweeps.items():
            their = their_sweeps.get(label, our)
            if our.name != their.name:
                found.append(f"{label} is {their.name}, not {our.name}")
            for option in sorted(our.options.keys() | their.options.keys()):
                if our.options.get(option) != their.options.get(option):
                    was, became = (_shown(sweep.options, option) for sweep in (our, their))
                    found.append(f"{option} of {label} is {became}, not {was}")
    return found


def describe(plan: Plan) -> str:
    """Return a readable summary of a plan, with a line for each trial."""
    specs = plan.expand()
    cutoff = f"cut off after {plan.max_steps} steps" if plan.max_steps else "without a step limit"
    length = f"{length_of(plan)}{', episodes' if plan.steps else ''} {cutoff}{plan.pace}"
    lines = [
        f"{len(specs)} trials of {length}; seed {plan.seed}"
        + (", and each trial's id" if plan.seeds == "id" else ""),
        f"agents        {_describe_roles(plan.agents)}",
        f"environments  {_describe_roles(plan.environments)}",
        "",
    ]
    width = max(len(spec.id) for spec in specs)
    lines += [f"{spec.id:<{width}}  seed {spec.seed}" for spec in specs]
    return "\n".join(lines)


def _describe_roles(sweeps: Sequence[RoleSweep]) -> str:
    described = []
    for sweep in sweeps:
        name = sweep.label if sweep.label == sweep.name else f"{sweep.label} ({sweep.name})"
        described.append(" ".join([name, *(f"{o}={_shown(sweep.options, o)}" for o in sweep.options)]))
    return "; ".join(described) or "connects from outside"


def _expand_role(sweeps: Sequence[RoleSweep]) -> list[tuple[str, RoleSpec | None]]:
    if not sweeps:
        return [(REMOTE, None)]
    return [(part, spec) for sweep in sweeps for part, spec in sweep.expand()]


def _combinations(sweep: RoleSweep) -> int:
    return math.prod(len(_as_tuple(value)) for value in sweep.options.values())


def _default_label(name: str) -> str:
    return label_of(short_name(name))


def _as_tuple(value: Value | tuple[Value, ...]) -> tuple[Value, ...]:
    return value if isinstance(value, tuple) else (value,)


def _shown(options: Mapping[str, Value | tuple[Value, ...]], name: str) -> str:
    if name not in options:
        return "the default"
    return ",".join(plain(value) for value in _as_tuple(options[name]))


def plain(value: Value) -> str:
    """Return an option's value as it is written in ids and in TOML."""
    return str(value).lower() if isinstance(value, bool) else str(value)

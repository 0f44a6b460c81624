"""An experiment as data: agents, environments, episodes, trials, a seed.

Every agent meets every environment, in every combination of the swept values, `trials` times. See
`experiment_runner.plan_file` for its file format.

A trial's id names its combination, as in `hierarchical/step_size=0.1/mario/level_difficulty=0/3`,
and its seed is derived from the experiment's seed and that id alone. So results depend neither on the order
of trials nor on the machine, and a plan that is extended by an agent or a value keeps its existing trials.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from glue.errors import ConfigError, ExperimentError
from glue.options import Value, parameters
from glue.suggestions import did_you_mean

__all__ = [
    "COUNTS",
    "REMOTE",
    "ROLES",
    "Plan",
    "RoleSpec",
    "RoleSweep",
    "TrialSpec",
    "absolute",
    "check_options",
    "class_files",
    "describe",
    "differences",
    "plain",
    "trial_seed",
]

COUNTS: Final = {  # a plan's numbers, with the range of each
    "episodes": range(1, 2**63),
    "max_steps": range(2**32),
    "trials": range(1, 1_000_001),
    "seed": range(2**63),
}
ROLES: Final = ("environments", "agents")
REMOTE: Final = "remote"
"""Stands in a trial's id for a player that joins from outside."""

_LABEL: Final = re.compile(r"[A-Za-z0-9_.+-]+")


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

    Raises:
        ExperimentError: the label cannot be part of a trial's id, or a value cannot be part of a plan.
    """

    name: str
    options: Mapping[str, Value | tuple[Value, ...]] = field(default_factory=dict)
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label or _default_label(self.name))
        if not _LABEL.fullmatch(self.label):
            raise ExperimentError(
                f"{self.label!r} cannot label an agent or environment: "
                "letters, digits and _ . + - are allowed"
            )
        for option, value in self.options.items():
            values = value if isinstance(value, tuple) else (value,)
            if not values:
                raise ExperimentError(f"option {option} of {self.label} has an empty list of values")
            for one in values:
                if not isinstance(one, (bool, int, float, str)):
                    raise ExperimentError(
                        f"option {option} of {self.label} takes a number, a string, true or false, "
                        f"or a list of these, not {one!r}"
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
        id: unique and readable, `agent/environment/number`.
        agent: None if it connects from outside.
        environment: None if it connects from outside.
        episodes: number of episodes, at least 1.
        max_steps: the step limit of `Experiment.rl_episode`; 0 for none.
        seed: random seed, 0 <= seed < 2**63.
    """

    id: str
    agent: RoleSpec | None
    environment: RoleSpec | None
    episodes: int
    max_steps: int
    seed: int


@dataclass(frozen=True, slots=True)
class Plan:
    """An experiment; see the top of this module.

    Raises:
        ExperimentError: a number is out of range, or two agents or environments share a label.
    """

    episodes: int
    max_steps: int = 0
    trials: int = 1
    seed: int = 0
    environments: tuple[RoleSweep, ...] = ()
    agents: tuple[RoleSweep, ...] = ()

    def __post_init__(self) -> None:
        for name, allowed in COUNTS.items():
            value = getattr(self, name)
            if type(value) is not int or value not in allowed:
                raise ExperimentError(
                    f"{name} must be a whole number from {allowed[0]} to {allowed[-1]}, not {value!r}"
                )
        for role in ROLES:
            labels = [sweep.label for sweep in getattr(self, role)]
            for label in labels:
                if labels.count(label) > 1:
                    raise ExperimentError(f"two {role} are called {label}; label them apart")

    def expand(self) -> list[TrialSpec]:
        """Return every trial; those of one combination follow each other.

        Raises:
            ExperimentError: two trials would have the same id, as when a value is listed twice.
        """
        specs = []
        for (agent_part, agent), (environment_part, environment) in itertools.product(
            _expand_role(self.agents), _expand_role(self.environments)
        ):
            for number in range(self.trials):
                name = f"{agent_part}/{environment_part}/{number}"
                seed = trial_seed(self.seed, name)
                specs.append(TrialSpec(name, agent, environment, self.episodes, self.max_steps, seed))
        seen = set()
        for spec in specs:
            if spec.id in seen:
                raise ExperimentError(f"the plan has trial {spec.id} twice: is a value listed twice?")
            seen.add(spec.id)
        return specs


def trial_seed(seed: int, trial_id: str) -> int:
    """Return the seed of a trial, 0 <= seed < 2**63: derived from the experiment's seed and the id."""
    digest = hashlib.sha256(trial_id.encode()).digest()
    words = tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, len(digest), 4))
    import numpy as np  # here, so that the commands answer --help without it

    state = np.random.SeedSequence(seed, spawn_key=words).generate_state(1, np.uint64)
    return int(state[0]) >> 1


def absolute(plan: Plan, folder: Path) -> Plan:
    """Return the plan with every relative `path/file.py:Class` resolved against `folder`."""

    def located(sweep: RoleSweep) -> RoleSweep:
        file, _, name = sweep.name.rpartition(":")
        return replace(sweep, name=f"{folder.absolute() / file}:{name}") if file.endswith(".py") else sweep

    return replace(
        plan,
        environments=tuple(map(located, plan.environments)),
        agents=tuple(map(located, plan.agents)),
    )


def class_files(roles: Iterable[RoleSweep | RoleSpec | None]) -> list[str]:
    """Return the files of the classes that are named as `path/file.py:Class`, without duplicates."""
    sources = [role.name.rpartition(":")[0] for role in roles if role is not None]
    return list(dict.fromkeys(source for source in sources if source.endswith(".py")))


def check_options(plan: Plan, find: Callable[[str, str], type]) -> Plan:
    """Return the plan with every option checked against its class; ints become floats where needed.

    Args:
        find: returns the class for a role ("agent" or "environment") and a name.

    Raises:
        ConfigError: raised by `find`, or an option is unknown to its class or has an invalid value.
    """
    return replace(
        plan,
        environments=tuple(_check_sweep(s, find("environment", s.name)) for s in plan.environments),
        agents=tuple(_check_sweep(s, find("agent", s.name)) for s in plan.agents),
    )


def differences(ours: Plan, theirs: Plan) -> list[str]:
    """Return how `theirs` differs from `ours`, one line for each difference."""
    found = [
        f"{name} is {getattr(theirs, name)}, not {getattr(ours, name)}"
        for name in COUNTS
        if getattr(ours, name) != getattr(theirs, name)
    ]
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
    """Return a summary of a plan for people, with a line for each trial."""
    specs = plan.expand()
    cutoff = f"cut off after {plan.max_steps} steps" if plan.max_steps else "without a step limit"
    lines = [
        f"{len(specs)} trials of {plan.episodes} episodes {cutoff}; seed {plan.seed}",
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


def _check_sweep(sweep: RoleSweep, factory: type) -> RoleSweep:
    known = parameters(factory)
    options: dict[str, Value | tuple[Value, ...]] = {}
    for name, value in sweep.options.items():
        if name not in known:
            raise ConfigError(f"{sweep.label} has no option {name}{did_you_mean(name, known)}")
        check = known[name].check
        try:
            options[name] = tuple(map(check, value)) if isinstance(value, tuple) else check(value)
        except ConfigError as error:
            raise ConfigError(f"{sweep.label}: {error}") from None
    return replace(sweep, options=options)


def _default_label(name: str) -> str:
    return name.rpartition(":")[2]


def _as_tuple(value: Value | tuple[Value, ...]) -> tuple[Value, ...]:
    return value if isinstance(value, tuple) else (value,)


def _shown(options: Mapping[str, Value | tuple[Value, ...]], name: str) -> str:
    if name not in options:
        return "the default"
    return ",".join(plain(value) for value in _as_tuple(options[name]))


def plain(value: Value) -> str:
    """Return an option's value as it is written in ids and in TOML."""
    return str(value).lower() if isinstance(value, bool) else str(value)

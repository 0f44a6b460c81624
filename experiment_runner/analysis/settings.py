"""The settings of one or more runs: groups of trials that differ only in their random seed."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from experiment_runner.analysis.stats import FloatArray
from experiment_runner.plan import REMOTE, RoleSpec, TrialSpec
from experiment_runner.store.joined import joined_players
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results
from glue.errors import ExperimentError

__all__ = ["Setting", "collect"]


@dataclass(frozen=True, slots=True)
class Setting:
    """Trials of one agent in one environment.

    agent        the agent's label, and the options that distinguish it from others of that label
    environment  the same for the environment; empty when all settings share it
    trials       the record of each trial
    returns      each trial's episode returns, (episodes so far,)
    steps        how many steps each of these episodes took; may be longer than the returns
    """

    agent: str
    environment: str
    trials: tuple[TrialRecord, ...]
    returns: tuple[FloatArray, ...]
    steps: tuple[npt.NDArray[np.int64], ...] = ()

    @property
    def label(self) -> str:
        """The setting's name, unique among these runs."""
        return f"{self.agent}, {self.environment}" if self.environment else self.agent

    def curves(self) -> FloatArray:
        """Return the returns of the finished trials, shape (trials, episodes).

        If no trial is finished, of all trials that have begun, up to the length of the shortest.
        """
        used = [self.returns[i] for i in self._drawn()]
        length = min((len(r) for r in used), default=0)
        return np.array([r[:length] for r in used]).reshape(len(used), length)

    def curve_steps(self) -> list[npt.NDArray[np.int64]]:
        """Return the steps of the episodes of each trial in `curves`, at least as many as there are there."""
        return [self.steps[i] for i in self._drawn()]

    def _drawn(self) -> list[int]:
        finished = [i for i, trial in enumerate(self.trials) if trial.finished]
        return finished or [i for i, returns in enumerate(self.returns) if returns.size]


def collect(runs: Iterable[Results]) -> list[Setting]:
    """Return the settings of all runs together, in order of appearance.

    Raises:
        ExperimentError: two runs have a trial in common, or a run cannot be read.
    """
    groups: dict[str, list[tuple[TrialRecord, FloatArray, npt.NDArray[np.int64]]]] = defaultdict(list)
    seen: dict[tuple[str, str, int], Results] = {}
    for run in runs:
        joined = {player: RoleSpec(name, label=name) for player, name in joined_players(run).items()}
        for trial in run.trials():
            spec = trial.spec
            agent = spec.agent or joined.get((spec.id, "agent"))
            environment = spec.environment or joined.get((spec.id, "environment"))
            trial = trial._replace(spec=replace(spec, agent=agent, environment=environment))
            key = json.dumps([_fields(agent), _fields(environment), _limits(spec)])
            same = seen.setdefault((key, trial.spec.id, trial.spec.seed), run)
            if same is not run:
                raise ExperimentError(f"trial {trial.spec.id} is in {same.directory} and in {run.directory}")
            returns = run.returns(trial.spec.id)
            groups[key].append((trial, returns, run.steps(trial.spec.id)))
    specs = [members[0][0].spec for members in groups.values()]
    agents = _names([(_label(spec.agent), _fields(spec.agent)) for spec in specs])
    environments = _names(
        [(_label(spec.environment), _fields(spec.environment) | _limits(spec)) for spec in specs]
    )
    if len(set(environments)) == 1:
        environments = [""] * len(specs)
    return [
        Setting(agent, environment, *map(tuple, zip(*members, strict=True)))
        for agent, environment, members in zip(agents, environments, groups.values(), strict=True)
    ]


def _label(role: RoleSpec | None) -> str:
    return REMOTE if role is None else role.label


def _fields(role: RoleSpec | None) -> dict[str, object]:
    return {} if role is None else {"class": role.name, **role.options}


def _limits(spec: TrialSpec) -> dict[str, object]:
    return {"episodes": spec.episodes, "max_steps": spec.max_steps}


def _names(described: Sequence[tuple[str, Mapping[str, object]]]) -> list[str]:
    """Return each label, followed by the fields in which it differs from others of the same label."""
    names = []
    for label, fields in described:
        same_label = [other_fields for other, other_fields in described if other == label]
        differing = [name for name in fields if any(o.get(name) != fields[name] for o in same_label)]
        names.append(" ".join([label, *(f"{name}={fields[name]}" for name in differing)]))
    return names

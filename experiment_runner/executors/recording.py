"""Recording more of a trial than its results: every step, the agent's metrics, and the environment's extras.

The steps are recorded in a file that `glue-replay` reads (docs/trajectories.md). The file contains every
episode that counts once, in order, and also those that became void because a player was lost. Episodes that
players only repeat to restore their state are not recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from experiment_runner.executors.job import BEGINNING, Start
from experiment_runner.plan.limits import REMOTE
from experiment_runner.plan.metrics import ALL, SUMMARIES, Keep, MetricsPlan, Summary, extra_of
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.readings import Part, pack_parts, unpack_parts
from experiment_runner.store.records import TOTAL_REWARD, EpisodeResult, Reading, ask
from glue.engine.engine import role_seed
from glue.engine.experiment import Experiment, steps
from glue.errors import ExperimentError, GlueError, PeerLost, Unsupported
from glue.trajectory import Run, TrajectoryError, TrajectoryReader, TrajectoryWriter
from glue.types import Observation
from glue.wire.messages import Role


class Extras:
    """Reader of an environment's extras, which gives a number for each in an episode.

    Args:
        plan: the summary of each extra; see `experiment_runner.plan.metrics`.
        label: the environment's.
    """

    def __init__(self, plan: Mapping[str, Summary], label: str) -> None:
        self._label = label
        self._summaries = {extra_of(key, label): how for key, how in plan.items()}
        # By each name of the plan: those it may be sent under, the best first, and then recorded under.
        self._forms = {name: {name: name, f"{label}.{name}": name} for name in self._summaries}
        if label == REMOTE:  # any label may be meant by what is before a dot, unless two names differ in it
            shorts = [name.partition(".")[2] for name in self._forms]
            for forms, short in zip(self._forms.values(), shorts, strict=True):
                if short and short not in self._forms and shorts.count(short) == 1:
                    forms[short] = short
        self._values: dict[str, dict[str, float]] = {}  # each summary so far, and the count
        self._found: set[str] = set()  # those that have been numbers

    def begin(self) -> None:
        """Begin an episode."""
        self._values = {}

    def see(self, observation: Observation) -> None:
        """Take the extras of the episode's next observation.

        Raises:
            ExperimentError: one of the plan is a text, bytes or an array, and never was a number.
        """
        extras = observation.extras
        for forms in self._forms.values():
            sent = next((form for form in forms if form in extras), None)
            if sent is None:
                continue
            name, value = forms[sent], extras[sent]
            if isinstance(value, int | float):
                self._found.add(name)
                self._values[name] = _with(float(value), self._values.get(name))
            elif name not in self._found:
                numbers = [key for key, one in extras.items() if isinstance(one, int | float)]
                raise ExperimentError(
                    f"the extra {name} of {self._label} cannot be a metric: it is {value!r:.40}, not a "
                    f"number; numbers among its extras: {', '.join(numbers) or 'none'}"
                )

    def numbers(self) -> dict[str, float]:
        """Return the number of each extra in the episode, by the environment's label, a dot, and its name.

        In an episode in which one was sent under its whole name, another whose name ends like it is left out.
        """
        return {
            f"{self._label}.{sent}": self._values[sent][self._summaries[name]]
            for name, forms in self._forms.items()
            if (sent := next((one for one in forms.values() if one in self._values), None)) is not None
        }

    def missing(self) -> Iterator[str]:
        """Yield for each extra of the plan without a number in the episode why there is none.

        One whose name has a dot may be that of an environment with another label, if this one has a label.
        """
        for name, forms in self._forms.items():
            unseen = self._values.keys().isdisjoint(forms.values())
            if unseen and ("." not in name or self._label == REMOTE):
                yield f"the environment sent no extra {name}: some send extras only if an option says so"


def _with(value: float, before: dict[str, float] | None) -> dict[str, float]:
    """Return the summaries of an extra's values, and their count, after one more value."""
    if before is None:
        return {"count": 1, **dict.fromkeys(SUMMARIES, value)}
    total, count = before["sum"] + value, before["count"] + 1
    least, most = min(before["min"], value), max(before["max"], value)
    after = {"last": value, "sum": total, "count": count, "mean": total / count, "min": least, "max": most}
    return before | after


@contextmanager
def recorded(path: Path | None) -> Iterator[TrajectoryWriter | None]:
    """Yield the writer of a new recording, or None without a path; remove the file if it has no episode.

    Raises:
        TrajectoryError: the file exists and contains episodes or anything else, or it cannot be written.
    """
    if path is None:
        yield None
        return
    _remove_remnant(path)  # left by a process that was killed, or had no disk space, before the first episode
    writer = TrajectoryWriter(path)
    try:
        with writer:
            yield writer
    finally:
        _remove_remnant(path)


def _remove_remnant(path: Path) -> None:
    """Remove a recording without an episode, and a file that is empty."""
    with suppress(TrajectoryError, OSError):
        if path.is_file() and (path.stat().st_size == 0 or next(iter(TrajectoryReader(path)), None) is None):
            path.unlink()


def run_of(spec: TrialSpec, task_spec: str, state: bytes = b"") -> Run:
    """Return the run with which the recording of a trial begins.

    Args:
        spec: the trial.
        task_spec: the environment's task spec.
        state: state that the environment has loaded; empty if none.
    """
    environment = spec.environment
    return Run(
        environment=environment.name if environment else "",
        options=environment.options if environment else {},
        task_spec=task_spec,
        seed=role_seed(spec.seed, Role.ENVIRONMENT),
        state=state,
    )


class Recorder:
    """Runner of a trial's episodes, like `Experiment.rl_episode`, which records every step.

    Args:
        writer: writes the recording; an episode is in the file once it has ended.
        spec: the trial.
        glue: the connected experiment.
        meter: reads metrics during the episode.
        questions: messages to send to the agent at each start and after each step.
    """

    def __init__(
        self,
        writer: TrajectoryWriter,
        spec: TrialSpec,
        glue: Experiment,
        meter: Meter,
        questions: Sequence[str] = (),
    ) -> None:
        self._writer = writer
        self._spec = spec
        self._glue = glue
        self._meter = meter
        self._questions = questions
        self._answers: dict[str, str] = {}
        self._task_spec = ""
        self._continued = False
        self._in_run = False

    def begin(self, task_spec: str, continued: bool) -> None:
        """Begin a new run of the recording with the next episode.

        Args:
            task_spec: as `rl_init` returned it.
            continued: whether the environment has already run episodes or loaded a state since `rl_init`.
        """
        self._task_spec = task_spec
        self._continued = continued
        self._in_run = False

    def rl_episode(self, max_steps: int) -> bool:
        """Run an episode; see `Experiment.rl_episode`.

        Raises:
            PeerLost: a player was lost; the recording marks the episode as void.
            TrajectoryError: the recording cannot be written.
            LocalProtocolError: the episode exceeds the limits of a recording.
        """
        if not self._in_run:
            self._writer.run(run_of(self._spec, self._task_spec, self._saved() if self._continued else b""))
            self._in_run = True
        try:
            return self._episode(max_steps)
        except PeerLost:
            self._writer.void()
            # The environment is a new one, or has executed a step whose result was not received.
            self.begin(self._task_spec, continued=True)
            raise

    def _saved(self) -> bytes:
        try:
            return self._glue.rl_env_save()
        except Unsupported:
            return b""

    def _episode(self, max_steps: int) -> bool:
        observation, action = self._glue.rl_start()
        self._answers.clear()
        self._ask()
        self._writer.start(observation)
        self._meter.see(observation)
        late = before = 0  # of actions, without and with the one that is carried out next
        for number, step in enumerate(steps(self._glue, max_steps), 1):
            self._ask()
            self._meter.see(step.observation)
            ended = step.terminal and not step.truncated
            self._writer.step(action, step.reward, step.observation, ended, late=late > before)
            if ended:
                return True
            self._meter.after(number)
            action = step.action
            before, late = late, self._glue.late_actions() or 0
        self._writer.cutoff()
        return False

    def _ask(self) -> None:
        """Record the agent's answers that differ from its previous ones in this episode."""
        for message, answer in ask(self._glue, self._questions):
            if self._answers.get(message) != answer:
                self._answers[message] = answer
                self._writer.answer(message, answer)


class Meter:
    """Reader of an agent's metrics in a trial, and of the environment's extras.

    If metrics are read during episodes, the total reward is, too.

    Args:
        glue: the experiment.
        plan: the readings of metrics to take; None for none.
        start: of the trial.
        extras: reads the environment's extras; None for none.

    Attributes:
        each_step: whether something is read during episodes.

    Raises:
        ExperimentError: the metrics of its checkpoint are damaged.
    """

    def __init__(
        self,
        glue: Experiment,
        plan: MetricsPlan | None,
        start: Start = BEGINNING,
        extras: Extras | None = None,
    ) -> None:
        self._glue = glue
        self._plan = plan
        self._every = 0 if plan is None else plan.every
        self._extras = extras
        self._steps = start.steps
        self._reward = start.reward
        saved = start.checkpoint.metrics if start.checkpoint else b""
        self._before = unpack_parts(saved)  # the parts before the episode under way
        self._parts = dict(self._before)
        self._readings: list[Reading] = []
        self.each_step: bool = self._every > 0 or extras is not None
        self._unread = ""  # why there are no metrics, if the agent turned out to have none

    def begin(self) -> None:
        """Begin an episode; the readings of one that became void are dropped."""
        self._readings = []
        self._parts = dict(self._before)
        if self._extras is not None:
            self._extras.begin()

    def rl_episode(self, max_steps: int) -> bool:
        """Run an episode like `Experiment.rl_episode`, with the readings that are due during it."""
        if self._extras is not None:
            return self._by_steps(max_steps)
        self._glue.rl_start()
        step, terminal = 0, None
        while terminal is None and (max_steps == 0 or step + 1 < max_steps):
            step += self._every - (self._steps + step) % self._every
            # RL_num_steps is 1 after the start, and stays as it is at the end of the episode.
            terminal = self._glue.rl_go_on(min(step + 1, max_steps or step + 1))
            if not terminal and self._glue.rl_num_steps() == step + 1:
                self.after(step)
        return bool(terminal)

    def _by_steps(self, max_steps: int) -> bool:
        self.see(self._glue.rl_start().observation)
        for number, step in enumerate(steps(self._glue, max_steps), 1):
            self.see(step.observation)
            if step.terminal and not step.truncated:
                return True
            self.after(number)
        return False

    def see(self, observation: Observation) -> None:
        """Take the extras of the episode's next observation."""
        if self._extras is not None:
            self._extras.see(observation)

    def after(self, step: int) -> None:
        """Read the metrics after a step of the episode, counted from 1, if they are due."""
        at = self._steps + step
        if self._every and at % self._every == 0:
            self._read(at // self._every, at, {TOTAL_REWARD: self._reward + self._glue.rl_return()})

    def end(self, result: EpisodeResult) -> tuple[Reading, ...]:
        """End an episode, with a reading of its last step if one is due; return all of its readings."""
        if self._every:
            self.after(result.steps)
        else:
            self._read(result.episode, self._steps + result.steps, {})
        self._steps += result.steps
        if self._extras is not None and (numbers := self._extras.numbers()):
            self._readings.append(Reading(self._steps, numbers))
        self._reward += result.episode_return
        self._before = self._parts
        return tuple(self._readings)

    def missing(self) -> Iterator[str]:
        """Yield why there are no readings, or none of an extra."""
        if self._unread:
            yield f"no metrics are recorded: {self._unread}"
        if self._extras is not None:
            yield from self._extras.missing()

    def save(self) -> bytes:
        """Return the unfinished means after an episode, on which later readings depend."""
        return pack_parts(self._before)

    def _read(self, number: int, step: int, own: dict[str, float]) -> None:
        """Read the metrics for the `number`-th time, counted from 1, and add the trial's own."""
        if self._plan is None:
            return
        try:
            metrics = {} if self._unread else self._glue.rl_agent_metrics()
        except Unsupported as error:
            metrics, self._unread = {}, str(error)
        if TOTAL_REWARD in metrics:
            raise GlueError(f"the agent has a metric {TOTAL_REWARD!r}, which is the name of the trial's own")
        if self._plan.keep:
            metrics = self._kept(self._plan.keep, number, metrics)
        if own or metrics:
            self._readings.append(Reading(step, {**own, **metrics} if own else metrics))

    def _kept(self, keep: Mapping[str, Keep], number: int, metrics: dict[str, float]) -> dict[str, float]:
        """Return the values to keep, or means in their place."""
        kept = {}
        for name, value in metrics.items():
            every, averaged = keep.get(name, ALL)
            if averaged:
                group = (number - 1) // every
                part = self._parts.get(name)
                total, count = (part.total, part.members) if part and part.group == group else (0.0, 0)
                self._parts[name] = Part(group, total + value, count + 1)
                value = (total + value) / (count + 1)
            if number % every == 0:
                self._parts.pop(name, None)
                kept[name] = value
        return kept

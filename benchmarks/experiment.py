"""The reference command as three processes: steps per second, and memory over the whole run."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks.hub import three_processes
from benchmarks.measure import REPEATS, Table, count, ratio
from experiment_runner.executors import player_command
from experiment_runner.store.results import Results
from glue.wire.messages import Role

_RUNS: Final = (("random", 100, REPEATS), ("hierarchical", 300, 1), ("random", 5000, 1))
"""Agent, episodes and repeats; long runs are made only once. The second is that of `make demo`."""

_COMMAND: Final = ("-m", "glue_rl", "experiment", "--env", "mario", "--json")
_PROGRAMS: Final = {
    "experiment and hub": ("glue_rl", "experiment"),
    "environment": (player_command.MODULE, str(Role.ENVIRONMENT)),
    "agent": (player_command.MODULE, str(Role.AGENT)),
}
"""Words on the command line of each process."""
_SAMPLE_SECONDS: Final = 0.05
_PAGE: Final = os.sysconf("SC_PAGESIZE")


class _Outcome(NamedTuple):
    """One run.

    seconds           from the command to its end
    steps_per_second  while episodes ran
    bare              the same of three processes that only play, just before and after
    memory            bytes of each process, resident; (samples, 3)
    """

    seconds: float
    steps_per_second: float
    bare: float
    memory: list[list[int]]


def run() -> list[Table]:
    """Measure the reference command, and the paper's agent in the place of the random one."""
    columns = [
        _column([_measure(agent, episodes) for _ in range(repeats)]) for agent, episodes, repeats in _RUNS
    ]
    names = [f"{agent}, {episodes:,} episodes" for agent, episodes, _ in _RUNS]
    return [
        Table(
            "The reference command",
            "`glue-experiment --env mario --agent AGENT --episodes EPISODES`: three processes over ipc, "
            f"every episode committed to disk. The first column is the median of {REPEATS} runs, the others "
            "are one run each, the second that of `make demo`. The bare hub is three processes that do "
            "nothing but play, measured just before and just after each run (the aim is 0.85 of it). Memory "
            "is what is resident; what is shared counts three times.",
            ("measure", *names),
            [(measure, *(column[measure] for column in columns)) for measure in columns[0]],
        )
    ]


def _column(outcomes: list[_Outcome]) -> dict[str, str]:
    """Return the measurements by name."""

    def middle(values: list[float]) -> str:
        return count(statistics.median(values))

    column = {
        "seconds": middle([outcome.seconds for outcome in outcomes]),
        "steps per second": middle([outcome.steps_per_second for outcome in outcomes]),
        "of the bare hub": ratio(statistics.median(each.steps_per_second / each.bare for each in outcomes)),
    }
    for number, name in enumerate(_PROGRAMS):
        peaks = [max(sample[number] for sample in outcome.memory) / 1e6 for outcome in outcomes]
        column[f"peak memory, {name}"] = middle(peaks) + " MB"
    sums = [[sum(sample) / 1e6 for sample in outcome.memory] for outcome in outcomes]
    column["peak memory, all three"] = middle([max(one) for one in sums]) + " MB"
    growth = [statistics.mean(_last(one)) - statistics.mean(_middle(one)) for one in sums]
    column["growth from the middle of the run to its end"] = f"{statistics.median(growth):.1f} MB"
    return column


def _last(samples: list[float]) -> list[float]:
    return samples[-max(len(samples) // 10, 1) :]


def _middle(samples: list[float]) -> list[float]:
    half = len(samples) // 2
    return samples[half : half + max(len(samples) // 10, 1)]


def _measure(agent: str, episodes: int) -> _Outcome:
    with three_processes() as measure:
        bare = [measure().per_second for _ in range(REPEATS)]
        outcome = _run(agent, episodes)
        bare += [measure().per_second for _ in range(REPEATS)]
    return outcome._replace(bare=statistics.median(bare))


def _run(agent: str, episodes: int) -> _Outcome:
    """Run the command; `bare` is not measured yet."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "lines"
        options = ["--agent", agent, "--episodes", str(episodes), "--out", f"{folder}/run"]
        command = [sys.executable, *_COMMAND, *options]
        memory: list[list[int]] = []
        began = time.monotonic()
        with output.open("w") as lines, subprocess.Popen(command, stdout=lines) as process:
            pids: list[int] = []
            while process.poll() is None:
                if not pids and output.stat().st_size:  # an episode is finished: all three processes exist
                    pids = [_find(process.pid, program) for program in _PROGRAMS.values()]
                sample = [_resident(pid) for pid in pids]
                if sample and all(sample):
                    memory.append(sample)
                time.sleep(_SAMPLE_SECONDS)
        took = time.monotonic() - began
        *finished, summary = map(json.loads, output.read_text().splitlines())
        assert len(finished) == episodes
        seconds = _wall_time(Path(folder) / "run")
        return _Outcome(took, summary["steps"] / seconds, 0.0, memory)


def _wall_time(directory: Path) -> float:
    with Results.open(directory) as results:
        [trial] = results.trials()
        return sum(episode.wall_time for episode in results.episodes(trial.spec.id))


def _find(experiment: int, program: tuple[str, ...]) -> int:
    """Return the process with these words on its command line: the experiment or one of its children."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            arguments = (entry / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        pid = int(entry.name)
        if experiment in (pid, parent) and set(program) <= set(arguments):
            return pid
    raise RuntimeError(f"no process runs {' '.join(program)}")


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE
    except (OSError, IndexError):
        return 0

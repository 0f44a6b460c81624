"""The reference command as three processes: steps per second, and memory over the whole run.

`python -m benchmarks.experiment 5000` measures a run of that many episodes, once, and prints it.
"""

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

from benchmarks.measure import REPEATS, Table, count
from experiment_runner.store import Results

__all__ = ["run"]

_EPISODES: Final = 300
_COMMAND: Final = ("-m", "experiment_runner.cli", "--env", "mario", "--agent", "random", "--json")
_PROGRAMS: Final = {
    "experiment and hub": "experiment_runner.cli",
    "environment": "env_server.cli",
    "agent": "agents.cli",
}
_SAMPLE_SECONDS: Final = 0.05
_PAGE: Final = os.sysconf("SC_PAGESIZE")


class _Outcome(NamedTuple):
    """One run.

    steps_per_second  while episodes ran
    memory            bytes of each process, resident; (samples, 3)
    """

    steps_per_second: float
    memory: list[list[int]]


def run() -> list[Table]:
    """Measure the reference command, cut down to a few hundred episodes."""
    return [_table(_EPISODES, [_measure(_EPISODES) for _ in range(REPEATS)])]


def _table(episodes: int, outcomes: list[_Outcome]) -> Table:
    def middle(values: list[float]) -> str:
        return count(statistics.median(values))

    rows = [("steps per second", middle([outcome.steps_per_second for outcome in outcomes]))]
    for number, name in enumerate(_PROGRAMS):
        peaks = [max(sample[number] for sample in outcome.memory) / 1e6 for outcome in outcomes]
        rows.append((f"peak memory, {name}", middle(peaks) + " MB"))
    sums = [[sum(sample) / 1e6 for sample in outcome.memory] for outcome in outcomes]
    rows.append(("peak memory, all three", middle([max(one) for one in sums]) + " MB"))
    growth = [statistics.mean(_last(one)) - statistics.mean(_middle(one)) for one in sums]
    rows.append(("growth from the middle of the run to its end", f"{statistics.median(growth):.1f} MB"))
    return Table(
        "The reference command",
        f"`glue-experiment --env mario --agent random --episodes {episodes}`: three processes over ipc, "
        "every episode committed to disk. Memory is what is resident; what is shared counts three times.",
        ("measure", "value"),
        rows,
    )


def _last(samples: list[float]) -> list[float]:
    return samples[-max(len(samples) // 10, 1) :]


def _middle(samples: list[float]) -> list[float]:
    half = len(samples) // 2
    return samples[half : half + max(len(samples) // 10, 1)]


def _measure(episodes: int) -> _Outcome:
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "lines"
        command = [sys.executable, *_COMMAND, "--episodes", str(episodes), "--out", f"{folder}/run"]
        memory: list[list[int]] = []
        with output.open("w") as lines, subprocess.Popen(command, stdout=lines) as process:
            pids: list[int] = []
            while process.poll() is None:
                if not pids and output.stat().st_size:  # an episode is finished: all three are there
                    pids = [_find(process.pid, program) for program in _PROGRAMS.values()]
                sample = [_resident(pid) for pid in pids]
                if sample and all(sample):
                    memory.append(sample)
                time.sleep(_SAMPLE_SECONDS)
        *finished, summary = map(json.loads, output.read_text().splitlines())
        assert len(finished) == episodes
        seconds = _wall_time(Path(folder) / "run")
        return _Outcome(summary["steps"] / seconds, memory)


def _wall_time(directory: Path) -> float:
    with Results.open(directory) as results:
        [trial] = results.trials()
        return sum(episode.wall_time for episode in results.episodes(trial.spec.id))


def _find(experiment: int, program: str) -> int:
    """Return which of the experiment and its children runs a program."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            arguments = (entry / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        pid = int(entry.name)
        if experiment in (pid, parent) and program in arguments:
            return pid
    raise RuntimeError(f"no process runs {program}")


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE
    except (OSError, IndexError):
        return 0


if __name__ == "__main__":
    number = int(sys.argv[1])
    print(_table(number, [_measure(number)]))

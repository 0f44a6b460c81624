"""Fuzz, guided by coverage: python -m tests.fuzzing [--seconds 60] [TARGET...].

Needs atheris. Each target runs in a process of its own. An input for which a target fails is kept in
tests/fuzzing/found, where a test tries it from then on.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from hashlib import sha256
from pathlib import Path

HERE = Path(__file__).parent


def fuzz(name: str, seconds: int) -> None:
    """Fuzz one target, in this process; libFuzzer ends it."""
    import atheris

    with atheris.instrument_imports(include=["glue", "experiment_runner"]):
        from tests.fuzzing.targets import examples, run

    corpus = HERE.parents[1] / "build/fuzzing" / name
    corpus.mkdir(parents=True, exist_ok=True)
    for example in examples(name):
        (corpus / sha256(example).hexdigest()[:16]).write_bytes(example)
    found = HERE / "found"
    found.mkdir(exist_ok=True)
    options = [
        f"-max_total_time={seconds}",
        "-max_len=4096",
        "-timeout=20",
        "-rss_limit_mb=2048",
        "-print_final_stats=1",
        f"-artifact_prefix={found}/{name}-",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], lambda data: run(name, data))
    atheris.Fuzz()


def main() -> int:
    """Fuzz the targets of the command line; return its exit code."""
    from tests.fuzzing.targets import TARGETS

    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    parser.add_argument(
        "targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all by default"
    )
    parser.add_argument("--seconds", type=int, default=60, help="time for each target (default 60)")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        fuzz(options.targets[0], options.seconds)
        return 0
    names = options.targets or list(TARGETS)
    commands = [
        [sys.executable, "-m", "tests.fuzzing", name, "--here", "--seconds", str(options.seconds)]
        for name in names
    ]
    failed = False
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        run = partial(subprocess.run, capture_output=True, text=True, check=False)
        for name, done in zip(names, pool.map(run, commands), strict=True):
            executed = (line for line in done.stderr.splitlines() if "number_of_executed" in line)
            inputs = next(executed, "?").split()[-1]
            print(f"{name}: {inputs} inputs{'' if done.returncode == 0 else ', FAILED'}", flush=True)
            if done.returncode:
                failed = True
                print(done.stdout[-1500:] + done.stderr[-3000:])
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())

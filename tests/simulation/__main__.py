"""Simulate: python -m tests.simulation --seeds 1000, or --seed N, with --trace to see what happens."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from tests.simulation.diagram import diagram
from tests.simulation.faults import drawn
from tests.simulation.run import simulate
from tests.simulation.shrinking import needed


def one(seed: int, trace: bool) -> int:
    """Run one seed; if it breaks a promise, rerun it with only the faults needed."""
    outcome = simulate(seed, trace=trace)
    if outcome.problems:
        which = outcome.problems[0][:3]
        faults = needed(
            drawn(seed),
            lambda tried: any(problem.startswith(which) for problem in simulate(seed, tried).problems),
        )
        outcome = simulate(seed, faults, trace)
        print(f"needed: {', '.join(map(str, faults)) or 'no fault'}")
    if trace:
        for line in diagram(outcome.trace):
            print(line)
    for problem in outcome.problems:
        print(problem)
    print(
        f"seed {seed}: {len(outcome.faults)} faults, {outcome.blocks} blocks, {outcome.voids} void, "
        f"{outcome.seconds:.1f} s of virtual time"
    )
    return bool(outcome.problems)


class Total:
    """The outcomes of many seeds together; of each seed that failed, the first problem."""

    def __init__(self) -> None:
        self.problems: list[str] = []
        self.reached: Counter[str] = Counter()
        self.blocks = self.voids = 0


def many(first: int, number: int, stop: bool) -> Total:
    """Run many seeds."""
    total = Total()
    for seed in range(first, first + number):
        outcome = simulate(seed)
        total.reached += outcome.reached
        total.blocks += outcome.blocks
        total.voids += outcome.voids
        if outcome.problems:
            total.problems.append(f"seed {seed}: {outcome.problems[0]}")
            print(total.problems[-1], flush=True)
            if stop:
                break
    return total


def main() -> int:
    """Run what the command line asks for; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="number of seeds (default 1000)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default 0)")
    parser.add_argument("--seed", type=int, help="a single seed")
    parser.add_argument("--trace", action="store_true", help="with --seed: print a sequence diagram")
    parser.add_argument("--reached", action="store_true", help="list the situations that were reached")
    parser.add_argument("--stop", action="store_true", help="end at the first seed that fails")
    options = parser.parse_args()
    if options.seed is not None:
        return one(options.seed, options.trace)
    total = many(options.first, options.seeds, options.stop)
    seconds, failed = time.process_time(), len(total.problems)
    faults = sum(number for name, number in total.reached.items() if name.startswith("fault: "))
    print(
        f"{options.seeds} seeds, {faults} faults, {total.blocks} blocks compared, {total.voids} void, "
        f"{seconds:.1f} s, {faults / seconds:.0f} faults a second, {failed} failed"
    )
    if options.reached:
        for name, number in sorted(total.reached.items()):
            print(f"{number:8} {name}")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())

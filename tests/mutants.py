"""Random mutants of the product, and whether tests catch them: `python -m tests.mutants --seed 1`.

A mutant is a copy of the checkout with one change: another operator, comparison or constant, or a statement
less. It is caught if a test of the folders that belong to its module fails. Packages with compiled code are
left out: each of their mutants would be compiled for a minute, and golden recordings show each step of the
game. With `--of FILE` the mutants of an earlier run are made again, wherever their line is the same, to
compare two versions of the suite. What follows `--` are options of pytest.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parents[1]
PACKAGES: Final = ("glue", "experiment_runner")

ALSO: Final = {
    "glue/cli": ("tests/system/test_commands.py", "tests/glue/hub"),
    "glue/client": (
        *("tests/glue/hub", "tests/simulation", "tests/system/test_conformance.py"),
        "tests/glue/conform/test_own_clients.py",
    ),
    "glue/conform": ("tests/glue/testing",),
    "glue/engine": ("tests/system/test_conformance.py", "tests/glue/hub", "tests/glue/testing"),
    "glue/hub": ("tests/simulation", "tests/system/test_faults.py", "tests/glue/testing"),
    "glue/legacy": ("tests/system/legacy",),
    "glue/wire": ("tests/glue/hub", "tests/glue/client", "tests/simulation"),
    "experiment_runner/processes": ("tests/experiment_runner/executors",),
    "experiment_runner/plan": ("tests/experiment_runner/executors",),
    "experiment_runner/store": ("tests/experiment_runner/executors",),
    "experiment_runner/analysis": ("tests/experiment_runner/report",),
}
"""Tests of a folder's modules outside its mirror in `tests/`."""

_OPERATORS: Final = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "//",
    ast.FloorDiv: "*",
    ast.Div: "*",
    ast.Mod: "*",
}
_COMPARISONS: Final = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip


class Mutant(NamedTuple):
    """A change of one line: `before` and `after` are its text, `line` its number from 1."""

    file: str
    line: int
    before: str
    after: str


def candidates(root: Path) -> list[Mutant]:
    """Return every mutant of the packages, in a fixed order."""
    files = sorted(file for package in PACKAGES for file in (root / package).rglob("*.py"))
    return [mutant for file in files for mutant in _of_file(root, file)]


def _of_file(root: Path, file: Path) -> Iterator[Mutant]:
    source = file.read_text("utf-8")
    lines = source.splitlines()
    for node, text in _changes(ast.parse(source), source):
        if node.lineno == node.end_lineno:
            line = lines[node.lineno - 1].encode()
            after = line[: node.col_offset] + text.encode() + line[node.end_col_offset :]
            yield Mutant(str(file.relative_to(root)), node.lineno, line.decode(), after.decode())


def _changes(tree: ast.AST, source: str) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Yield the nodes to be replaced, and the text that replaces each."""
    left: list[ast.AST] = [tree]
    while left:
        node = left.pop()
        if isinstance(node, ast.FunctionDef) and any(
            ast.unparse(decorator) in ("jit", "entry", "inline") for decorator in node.decorator_list
        ):
            continue
        if isinstance(node, ast.Raise):  # wordings of errors
            continue
        left += reversed(list(ast.iter_child_nodes(node)))

        def text(part: ast.AST) -> str:
            return ast.get_source_segment(source, part) or ""

        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            yield node, f"{text(node.left)} {_OPERATORS[type(node.op)]} {text(node.right)}"
        elif isinstance(node, ast.BoolOp):
            word = " or " if isinstance(node.op, ast.And) else " and "
            yield node, word.join(f"({text(value)})" for value in node.values)
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            yield node, f"{text(node.left)} {_COMPARISONS[type(node.ops[0])]} {text(node.comparators[0])}"
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield node, text(node.operand)
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield node, str(not node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield node, str(node.value + 1)
        elif isinstance(node, ast.AugAssign) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
        ):
            yield node, "pass"


def tests_of(file: str) -> list[str]:
    """Return the tests that belong to a module: the deepest mirror of its folder, and those of `ALSO`."""
    folders = [folder.as_posix() for folder in Path(file).parents if folder != Path()]
    mirror = next(ROOT / "tests" / folder for folder in folders if (ROOT / "tests" / folder).is_dir())
    # The mirror of a package itself has only modules of tests: each subfolder belongs to a subpackage.
    found = [mirror] if mirror.parent != ROOT / "tests" else sorted(mirror.glob("test_*.py"))
    found += [ROOT / path for folder in folders for path in ALSO.get(folder, ())]
    return [str(path.relative_to(ROOT)) for path in found if path.exists()]


def caught(mutant: Mutant, options: Sequence[str], seconds: float) -> str:
    """Return "caught", "survived" or "gone", if the line is no longer there."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        shutil.copytree(
            ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(".git", ".venv", "build", "runs")
        )
        file = copy / mutant.file
        lines = file.read_text("utf-8").splitlines() if file.exists() else []
        places = [number for number, line in enumerate(lines, 1) if line == mutant.before]
        if not places:
            return "gone"
        lines[min(places, key=lambda number: abs(number - mutant.line)) - 1] = mutant.after
        file.write_text("\n".join(lines) + "\n", "utf-8")
        try:
            done = _pytest(copy, "-x", *options, *tests_of(mutant.file), timeout=seconds)
        except subprocess.TimeoutExpired:
            return "caught"  # it hangs
        return "survived" if done.returncode == 0 else "caught"


def failing(tests: Sequence[str], options: Sequence[str], jobs: int) -> list[str]:
    """Return the tests that fail without a mutant, as on a machine that lacks what they need."""
    printed = _pytest(ROOT, "-rfE", f"--numprocesses={jobs}", *options, *tests).stdout
    return re.findall(r"^(?:FAILED|ERROR) (tests/\S+)", printed, re.MULTILINE)


def _pytest(folder: Path, *arguments: str, timeout: float | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    env = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=timeout, check=False
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument(
        "--seconds", type=float, default=300.0, help="after which a mutant counts as one that hangs"
    )
    parser.add_argument("--of", type=Path, help="make the mutants of this file again")
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    parser.add_argument("options", nargs="*", help="options of pytest")
    asked = parser.parse_args()
    if asked.of is None:
        mutants = random.Random(asked.seed).sample(candidates(ROOT), asked.count)
    else:
        mutants = [Mutant(*json.loads(row)[:4]) for row in asked.of.read_text("utf-8").splitlines()]
    found: Counter[str] = Counter()
    with ThreadPoolExecutor(asked.jobs) as pool, asked.out.open("w") as out:
        tests = sorted({test for mutant in mutants for test in tests_of(mutant.file)})
        options = [*asked.options, *map("--deselect={}".format, failing(tests, asked.options, asked.jobs))]
        verdicts = pool.map(lambda mutant: caught(mutant, options, asked.seconds), mutants)
        for mutant, verdict in zip(mutants, verdicts, strict=True):
            found[verdict] += 1
            print(json.dumps([*mutant, verdict]), file=out, flush=True)
            if verdict == "survived":
                print(f"{mutant.file}:{mutant.line}:\n-{mutant.before}\n+{mutant.after}", flush=True)
    print(dict(found))


if __name__ == "__main__":
    main()

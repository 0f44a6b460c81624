"""docs/coming-from.md: each experiment has the same returns in the other library and here.

`nox -s libraries` installs the other libraries.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.forked import BIN
from tests.pages import DOCS, blocks, run_block

BLOCKS: Final = blocks((DOCS / "coming-from.md").read_text("utf-8"))
RUNS: Final = {"andnp": 0, "codec": 0, "plan": 1, "gym": 2, "dm": 3}
"""For each run here, the index of the other library's program with the same returns."""


def test_every_block_is_run() -> None:
    assert [block for block in BLOCKS if not (block.file or block.note in ("there", "here"))] == []


def test_returns_there_and_here_are_equal(tmp_path: Path) -> None:
    there: list[list[float]] = []
    for block in BLOCKS:
        if block.file:
            (tmp_path / block.file).write_text(block.body)
            continue
        done = run_block(block, tmp_path)
        if block.note == "there":
            there.append([float(line) for line in done.stdout.split()])
    assert [len(returns) for returns in there] == [50, 150, 50, 50]
    assert len(set(there[0])) > 5
    for name, program in RUNS.items():
        words = [str(BIN / "glue-results"), "export", f"runs/{name}", "--format", "json"]
        rows = json.loads(subprocess.check_output(words, cwd=tmp_path))
        assert [row["return"] for row in rows] == there[program], name


def test_tables_of_a_run_are_data_frames(tmp_path: Path) -> None:
    words = ["--env", "mines", "--agent", "random", "--episodes", "3", "--in-process", "--out", "runs/plan"]
    subprocess.run([str(BIN / "glue-experiment"), *words], cwd=tmp_path, check=True, capture_output=True)
    body = """
import glue
run = glue.load_run("runs/plan")
assert run.to_pandas()["return"].tolist() == run.to_polars()["return"].to_list()
"""
    subprocess.run([sys.executable, "-c", body], cwd=tmp_path, check=True)

"""docs/coming-from.md: each experiment has the same returns in the other library and here.

`nox -s coming_from` installs the other libraries.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.forked import BIN

TEXT: Final = (Path(__file__).parents[2] / "docs" / "coming-from.md").read_text()
BLOCK: Final = re.compile(
    r"^<!-- (?P<note>.*?) -->\n```(?P<kind>\w+)\n(?P<body>.*?)^```", re.MULTILINE | re.DOTALL
)
RUNS: Final = {"andnp": 0, "codec": 0, "plan": 1, "gym": 2, "dm": 3}
"""For each run here, the index of the other library's program with the same returns."""


def test_every_block_is_run() -> None:
    blocks = list(BLOCK.finditer(TEXT))
    assert len(blocks) == TEXT.count("```") / 2
    assert all(re.fullmatch(r"there|here|file: \w+\.\w+", block["note"]) for block in blocks)


def test_returns_there_and_here_are_equal(tmp_path: Path) -> None:
    env = os.environ | {"PATH": os.pathsep.join([str(BIN), os.environ["PATH"]]), "PYTHONPATH": "."}
    there: list[list[float]] = []
    for block in BLOCK.finditer(TEXT):
        note, body = block["note"], block["body"]
        if note.startswith("file: "):
            (tmp_path / note.removeprefix("file: ")).write_text(body)
            continue
        command = [sys.executable, "-c", body] if note == "there" else ["bash", "-euc", body]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, f"{body}\n{done.stderr}"
        if note == "there":
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

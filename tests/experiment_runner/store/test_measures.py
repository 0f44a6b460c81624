from __future__ import annotations

import contextlib
import math
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Final

from experiment_runner.store.records import MEASURES, EpisodeResult

# The steps to add a column: a measure and its field in `records`, its migration in `schema`.
ADDED: Final = """
import sys
from pathlib import Path
from typing import NamedTuple

import experiment_runner.store.records as records

fields = [*records.EpisodeResult.__annotations__.items(), ("reached", float)]
EpisodeResult = NamedTuple("EpisodeResult", fields)
EpisodeResult.repeats = records.EpisodeResult.repeats
records.EpisodeResult = EpisodeResult
records.MEASURES["reached"] = records.Measure(float, "reached REAL", "part of the way", lambda ended: 0.5)

import experiment_runner.store.schema as schema

schema.MIGRATIONS += ((f"ALTER TABLE episodes ADD COLUMN {records.MEASURES['reached'].sql}",),)

from experiment_runner.store.run_data import episode_table, write_csv
from experiment_runner.store.store import Store

with Store.open(Path(sys.argv[1])) as store:
    glue = {"rl_return": lambda: 3.0, "rl_num_steps": lambda: 7, "late_actions": lambda: 2}
    ended = records.EndedEpisode(glue=type("", (), glue), terminal=True, seconds=0.25)
    store.record("remote/mario/1", records.measured(1, ended))
    write_csv(episode_table(store), sys.stdout)
    print(*store.measure("remote/mario/1", "reached"), *store.measure(sys.argv[2], "reached"))
"""


def test_an_unknown_value_of_a_measure_repeats_any_other() -> None:
    known, unknown = EpisodeResult(1, 2.0, 7, True, 0.1), EpisodeResult(1, math.nan, 7, True, 0.3)
    assert known.repeats(unknown)
    assert unknown.repeats(unknown)
    assert not known.repeats(EpisodeResult(1, 3.0, 7, True, 0.1))
    assert not unknown.repeats(EpisodeResult(1, math.nan, 8, True, 0.3))


def test_measure_added_in_two_places_is_stored_exported_and_read(tmp_path: Path) -> None:
    older = "random/level_seed=121/mario/0"
    with contextlib.closing(sqlite3.connect(tmp_path / "results.sqlite")) as connection:
        connection.executescript((Path(__file__).parent / "run_version_1.sql").read_text())
    done = subprocess.run(
        [sys.executable, "-c", ADDED, str(tmp_path), older], capture_output=True, text=True, check=True
    )
    header, first, _, new, numbers = done.stdout.splitlines()
    assert header.startswith(f"trial,episode,{','.join(MEASURES)},reached,seed,")
    assert first.startswith(f"{older},1,1.5,100,true,0.25,,,")
    assert new.startswith("remote/mario/1,1,3.0,7,true,0.25,2,0.5,")
    assert numbers == "0.5 nan nan"

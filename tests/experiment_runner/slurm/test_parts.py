"""Parts of a run: they continue like runs, and are merged completely."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment_runner.slurm import array
from experiment_runner.slurm.array import (
    array_script,
    check_folder,
    check_options,
    divide,
    gather,
    gathering_job,
)
from experiment_runner.store.layout import PARTS, DirectoryTaken, parts_of, runs_under
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ConfigError
from tests.system.runs import contents, run
from tests.system.test_workers import SARSA

PLAN = (*SARSA, "--episodes", 6, "--trials", 5, "--in-process", "--checkpoint-every", 2)


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of five trials."""
    folder = tmp_path_factory.mktemp("finished")
    assert run(*PLAN, "--out", "whole", cwd=folder).returncode == 0
    return folder / "whole"


@pytest.fixture
def begun(whole_run: Path, tmp_path: Path) -> Path:
    """The same run, of which the first two trials are finished and the third has begun."""
    with Results.open(whole_run) as whole:
        specs = [trial.spec for trial in whole.trials()]
        files = {name: (whole_run / name).read_text() for name in ("plan.toml", "run.json")}

        def fill(store: Store) -> None:
            for spec in specs[:3]:
                store.adopt(whole, spec.id, spec.id)
            store.rewind(specs[2].id, 3)
            store.record_event("lost", "its worker was lost", specs[2].id)

        Store.create(tmp_path / "run", specs, files, fill=fill).close()
    return tmp_path / "run"


def test_parts_hold_the_unfinished_trials_with_their_progress(begun: Path) -> None:
    with Store.open(begun) as store:
        assert divide(store, 2) == 2
    held = {path.name: contents(path) for path in parts_of(begun)}
    assert {name: list(trials) for name, trials in held.items()} == {
        "0": ["sarsa/mines/2", "sarsa/mines/4"],
        "1": ["sarsa/mines/3"],
    }
    assert held["0"]["sarsa/mines/2"] == contents(begun)["sarsa/mines/2"]
    assert list(runs_under(begun.parent)) == [begun]  # the parts are not listed


def test_a_part_is_removed_when_its_results_are_on_the_disk(
    begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    removed = []
    with Store.open(begun) as store:
        divide(store, 1000)

        def remove(path: Path) -> None:
            assert store._connection.execute("PRAGMA synchronous").fetchone() == (2,), "a power loss loses it"
            removed.append(path)

        monkeypatch.setattr(array, "remove_run", remove)
        assert gather(store) == len(removed) == 3


def test_what_the_parts_have_done_is_the_run_s(begun: Path, whole_run: Path, tmp_path: Path) -> None:
    with Store.open(begun) as store:
        divide(store, 1000)
    for part in parts_of(begun)[1:]:
        done = run("--resume", part, "--in-process", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    local = run("--resume", begun, "--in-process", cwd=tmp_path)
    assert local.returncode == 1
    assert f"glue-results gather {begun}" in local.stderr
    before = contents(begun)["sarsa/mines/2"]
    with Store.open(begun) as store:
        assert gather(store) == 3
        assert gather(store) == 0
        assert [event.text for event in store.events() if event.kind == "lost"] == ["its worker was lost"]
    assert contents(begun)["sarsa/mines/2"] == before
    assert run("--resume", begun, "--in-process", cwd=tmp_path).returncode == 0
    assert contents(begun) == contents(whole_run)


def test_a_part_that_is_being_continued_stays(begun: Path) -> None:
    with Store.open(begun) as store:
        divide(store, 2)
        with Store.open(parts_of(begun)[1]), pytest.raises(DirectoryTaken):
            gather(store)
        assert [path.name for path in parts_of(begun)] == ["1"]
        assert gather(store) == 1


def test_the_script_quotes_paths_and_limits_tasks() -> None:
    script = array_script(Path("/a b") / PARTS, ["glue", "--trust"], 12, 3, ["time=2:00:00", "exclusive"])
    assert script.splitlines()[0] == "#!/bin/sh"
    assert "#SBATCH --array=0-11%3" in script
    folder = Path('/my runs/50%array/"quoted"') / PARTS
    (output,) = (line for line in array_script(folder, [], 1, None, []).splitlines() if "--output" in line)
    assert output == r'#SBATCH --output="/my runs/50%%array/\"quoted\"/parts/%a.log"'
    assert f'--output=/my runs/50%%array/"quoted"/{PARTS}/gather.log' in gathering_job("1", folder, [], [])
    with pytest.raises(ConfigError, match="on one line"):
        check_folder(Path("/a\n#SBATCH --uid=0"))
    assert script.splitlines()[-1] == """exec glue --trust '/a b/parts'/"$SLURM_ARRAY_TASK_ID\""""


@pytest.mark.parametrize("option", ["", "--time=1", "time=1\n#SBATCH --uid=0", "time=", "x=1 2"])
def test_an_option_that_is_none_is_refused(option: str) -> None:
    check_options(["time=2:00:00", "exclusive"])
    with pytest.raises(ConfigError, match="NAME=VALUE"):
        check_options([option])

"""The wheel and the sdist: their contents, and everything that works with nothing else installed."""

from __future__ import annotations

import email
import re
import shutil
import subprocess
import tarfile
import time
import urllib.request
import zipfile
from pathlib import Path
from typing import Final

import pytest

from glue.names import NAMES
from tests.package.environments import COMMANDS, DIST, Installed
from tests.pages import DOCS, ROOT

TRACKED: Final = frozenset(
    subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
)
OURS: Final = {name for name in TRACKED if name.split("/")[0] in NAMES}


@pytest.fixture(scope="module")
def wheel() -> Path:
    (found,) = Path(DIST).resolve().glob("*.whl")
    return found


@pytest.fixture(scope="module")
def sdist() -> Path:
    (found,) = Path(DIST).resolve().glob("*.tar.gz")
    return found


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Installed:
    installed = Installed.make(tmp_path_factory.mktemp("plain"))
    installed.install(str(wheel))
    return installed


@pytest.fixture(scope="module")
def extras(plain: Installed, wheel: Path) -> Installed:
    plain.install(f"{wheel}[web,soar]")
    return plain


def test_wheel_holds_the_program_and_its_licence_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    info = f"{'-'.join(wheel.name.split('-')[:2])}.dist-info"
    written = {"METADATA", "RECORD", "WHEEL", "entry_points.txt", "top_level.txt"}
    expected = {f"glue_rl/packages/{name}" for name in OURS}
    expected |= {name for name in TRACKED if name.startswith("glue_rl/")} | {"glue_rl.pth"}
    expected |= {f"{info}/{name}" for name in {"licenses/LICENSE", "licenses/NOTICE", *written}}
    assert names == expected
    assert not {name for name in names if "test_" in name or Path(name).suffix in {".png", ".gif", ".pyc"}}
    told = re.search(r"The wheel has (\S+) MB", (DOCS / "install.md").read_text("utf-8"))
    assert told is not None
    assert abs(wheel.stat().st_size / 1e6 - float(told[1])) < 0.1


def test_sdist_holds_what_a_wheel_is_made_of(sdist: Path) -> None:
    root = sdist.name.removesuffix(".tar.gz")
    with tarfile.open(sdist) as archive:
        names = {member.name.removeprefix(f"{root}/") for member in archive if member.isfile()}
    documents = {"CHANGELOG.md", "CITATION.cff", "LICENSE", "MANIFEST.in", "NOTICE", "README.md"}
    expected = OURS | {name for name in TRACKED if name.startswith("glue_rl/")} | documents
    assert {name for name in names if ".egg-info/" not in name} == expected | {
        *("PKG-INFO", "pyproject.toml", "setup.cfg", "setup.py")
    }


def test_building_again_gives_the_same_bytes(wheel: Path, sdist: Path, tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    for name in sorted(TRACKED - {""}):
        if (ROOT / name).is_file() and name.split("/")[0] not in {"docs", "tests", "clients"}:
            (checkout / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, checkout / name)  # with today's date and other permissions
    subprocess.run(["pyproject-build", "--outdir", tmp_path, checkout], check=True, capture_output=True)
    assert (tmp_path / wheel.name).read_bytes() == wheel.read_bytes()
    assert (tmp_path / sdist.name).read_bytes() == sdist.read_bytes()


def test_metadata(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        found = email.message_from_bytes(archive.read(name))
    assert found["License-Expression"] == "Apache-2.0"
    assert found.get_all("License-File") == ["LICENSE", "NOTICE"]
    assert {url.split(",")[0] for url in found.get_all("Project-URL", [])} >= {"Documentation", "Source"}
    links = re.findall(r"\]\(([^)]+)\)", str(found.get_payload()))
    assert len(links) > 10
    assert [link for link in links if not link.startswith("https://")] == []  # PyPI shows only this page


def test_everything_comes_from_the_wheel(plain: Installed) -> None:
    shown = plain.python("import agents, env_server, experiment_runner, glue, glue_rl; print(glue.__file__)")
    assert Path(shown.stdout.strip()) == plain.packages / "glue_rl/packages/glue/__init__.py"
    assert not shown.stderr


def test_names_are_the_same_objects_through_either_door(plain: Installed) -> None:
    plain.python("import glue, glue_rl; assert glue_rl.Agent is glue.Agent; assert glue_rl.__version__")
    plain.python("import glue_rl, glue; assert glue_rl.Agent is glue.Agent")


def test_importing_glue_costs_no_numpy_and_its_names_no_numba(plain: Installed) -> None:
    plain.python("import glue, sys; assert not {'numpy', 'zmq', 'click', 'numba'} & set(sys.modules)")
    plain.python("import glue, sys; glue.Agent; assert 'numba' not in sys.modules")


@pytest.mark.parametrize("command", COMMANDS)
def test_command_explains_itself(command: str, plain: Installed) -> None:
    shown = plain.run(command, "--help")
    assert shown.stdout.startswith(f"Usage: {command} ")
    assert not shown.stderr


def test_experiment_in_three_processes(plain: Installed) -> None:
    plain.run("glue-experiment", "--env", "mines", "--agent", "sarsa", "--episodes", "20", "--out", "three")
    shown = plain.python("import glue; print(len(glue.load_run('three')['return']))")
    assert shown.stdout.strip() == "20"


def test_mario_is_recorded_and_replayed(plain: Installed) -> None:
    golden = plain.cwd / "mario.jsonl.gz"
    shutil.copyfile(ROOT / "tests/golden/mario/episodes.jsonl.gz", golden)
    plain.run("glue-replay", "--check", str(golden))


def test_page(extras: Installed) -> None:
    process = subprocess.Popen(
        [extras.folder / "bin/glue-view", "--no-browser", "--port", "0"],
        cwd=extras.cwd,
        env=extras.environ(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert process.stdout is not None
        address = next(found for line in process.stdout if (found := re.search(r"http://\S+", line)))[0]
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        for _ in range(100):
            try:
                with browser.open(address, timeout=20) as page:
                    assert b"<html" in page.read()
                break
            except ConnectionError:
                time.sleep(0.1)
        else:
            raise AssertionError("the page never answered")
    finally:
        process.terminate()
        process.communicate()


def test_soar_productions(extras: Installed) -> None:
    experiment = ["glue-experiment", "--env", "mines", "--agent", "soar-mines", "--episodes", "2"]
    extras.run(*experiment, "--max-steps", "20", "--in-process", "--out", "soar")

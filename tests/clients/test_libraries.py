"""Each library as users get it: its own tests, its documentation, its package, and the kit's verdict."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

from env_server.toys import SkeletonEnvironment
from glue import Action, Observation, Step, connect
from glue.wire.messages import THREE_ROLES, Role
from tests.clients.languages import CLIENTS, CPP, JAVASCRIPT, LANGUAGES, OWN, RUST, Language, own_program, run
from tests.clients.table import SECONDS, program
from tests.hubs import hub_with
from tests.pages import DOCS, blocks

CONFORM: Final = (sys.executable, "-c", "from glue_rl.commands import conform; conform()")

KIT_SECONDS: Final = 280.0


@pytest.fixture(params=LANGUAGES, ids=lambda language: language.name)
def language(request: pytest.FixtureRequest) -> Language:
    asked: Language = request.param
    asked.ready()
    return asked


def test_own_tests_pass_and_documentation_is_whole(language: Language) -> None:
    for command in language.tests:
        run(command, language.folder, RUSTDOCFLAGS="-D warnings")


@pytest.mark.parametrize("role", THREE_ROLES)
def test_kit_finds_no_fault(language: Language, role: Role) -> None:
    done = judged(role, "--wait", "20", "--", *language.programs["mirror"], role)
    lines = done.stdout.splitlines()
    unjudged = [before for before, line in pairwise(lines) if line.strip().startswith("not judged")]
    # Players have all capabilities except these; experiments ask for the return and the number of steps.
    assert all(re.search(" (outcome|batch): ", line) for line in unjudged), done.stdout
    assert "broken" not in lines[-1]


@pytest.mark.parametrize("role", THREE_ROLES)
def test_scripts_of_random_faults_find_none(language: Language, role: Role) -> None:
    how = ("--seeds", "6", "--transport", "tcp", "--wait", "20")
    assert judged(role, *how, "--", *language.programs["mirror"], role).stdout == "survives (6 passed)\n"


class Unknown(SkeletonEnvironment):
    """Orders the mirror to do what it does not know."""

    def env_step(self, action: Action) -> Step:
        return Step(0.0, Observation(chars=b"dance"), False)


def test_experiment_that_fails_ends(language: Language) -> None:
    mirror = [*language.programs["mirror"], "experiment"]
    with (
        hub_with(Unknown()) as url,
        pytest.raises(AssertionError, match="the mirror was ordered to do dance"),
    ):
        run(mirror, language.folder, SECONDS, GLUE_HUB=url)


def judged(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Return what the kit says of a client that keeps the rules."""
    done = subprocess.run([*CONFORM, *arguments], capture_output=True, text=True, timeout=KIT_SECONDS)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


PAGE: Final = DOCS / "clients.md"


def code_in(page: Path, language: str) -> str:
    """Return the first code block in a language on a page."""
    return blocks(page.read_text("utf-8"), language)[0].body


@pytest.mark.parametrize("name", OWN)
def test_readme_begins_with_the_first_agent_of_the_page(name: str) -> None:
    readme = CLIENTS / name / "README.md"

    assert code_in(readme, name) == code_in(PAGE, name)
    assert len(readme.read_text("utf-8").splitlines()) <= 75  # a page


SOURCES: Final = {"cpp": "include", "java": "src", "javascript": "src", "rust": "src"}


def test_page_tells_how_long_the_sources_are() -> None:
    (row,) = re.findall(r"^\| source, without tests \|(.*)\|$", PAGE.read_text("utf-8"), re.MULTILINE)
    told = [int(cell.split()[0].replace(",", "")) for cell in row.split("|")]
    lengths = [
        sum(
            len(path.read_text("utf-8").splitlines())
            for path in (CLIENTS / name / source).rglob("*")
            if path.is_file() and path.name != "tests.rs"
        )
        for name, source in SOURCES.items()
    ]

    assert [round(length, -2) for length in lengths] == told


@pytest.mark.slow
def test_first_agent_in_python_walks(tmp_path: Path) -> None:
    file = tmp_path / "agent.py"
    file.write_text(code_in(PAGE, "python"))
    walks((str(Path(sys.executable).with_name("glue-agent")), f"{file}:Walker"))


def walks(start: Sequence[str]) -> None:
    """Check that an agent walks to the end, reports a refusal, and passes the kit, SHOULDs included."""
    with hub_with() as url, program(start, url), connect(url) as glue:
        glue.rl_agent_message("are you there?")
        second = run(start, Path.cwd(), SECONDS, status=1, GLUE_HUB=url)
        assert "already has an agent" in second.stdout + second.stderr
    kit = judged("agent", "--transport", "tcp", "--wait", "20", "--", *start)
    assert "should" not in {line.partition(" ")[0] for line in kit.stdout.splitlines()}, kit.stdout
    assert "plays, as far as can be told without the mirror" in kit.stdout.splitlines()[-1]
    with (
        hub_with(SkeletonEnvironment()) as url,
        program(start, url),
        connect(url) as glue,
    ):
        glue.rl_init()
        assert glue.rl_episode()
        assert (glue.rl_return(), glue.rl_num_steps()) == (1.0, 10)


@pytest.mark.slow
def test_first_agent_walks(language: Language, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    walks(own_program(language, code_in(PAGE, language.name), tmp_path))


def test_fresh_project_installs_the_tarball_and_checks_its_types(tmp_path: Path) -> None:
    JAVASCRIPT.ready()
    if shutil.which("npm") is None:
        pytest.skip("there is no npm here to pack clients/javascript (Debian: npm)")
    run(["npm", "pack", "--silent", str(JAVASCRIPT.folder)], tmp_path)
    (tarball,) = tmp_path.glob("*.tgz")
    (tmp_path / "package.json").write_text('{"name": "fresh", "type": "module", "private": true}')
    run(
        ["npm", "install", "--silent", "--no-package-lock", str(tarball), "typescript", "@types/node@18"],
        tmp_path,
    )
    (tmp_path / "agent.ts").write_text(FIRST_AGENT)
    strict = ["--strict", "--target", "es2022", "--module", "nodenext", "--types", "node"]
    run(["npx", "tsc", *strict, "agent.ts"], tmp_path)
    run(["npx", "tsc", "--project", str(copy_of_sources(tmp_path))], tmp_path)
    with hub_with() as url, program(["node", str(tmp_path / "agent.js")], url) as process:
        run([*JAVASCRIPT.programs["mirror"][:1], "-e", JOIN], tmp_path, GLUE_HUB=url)
        assert process.poll() is None


FIRST_AGENT: Final = """\
import { type Agent, type Observation, serveAgent } from "glue-rl";

class Walker implements Agent {
  init(taskSpec: string): void {}
  start(observation: Observation) { return { ints: [1] }; }
  step(reward: number, observation: Observation) { return { ints: [observation.ints[0] < 20 ? 1 : 0] }; }
}

const reason: string = await serveAgent(new Walker());
console.log(reason);
"""

JOIN: Final = """\
import("glue-rl").then(async ({ connect }) => {
  const glue = await connect();
  const answer = await glue.agentMessage("anybody there?");
  await glue.close();
  process.exit(answer === "" ? 0 : 1);
});
"""


def copy_of_sources(folder: Path) -> Path:
    """Copy the library next to the installed types, which its own folder lacks; return the copy."""
    copy = folder / "sources"
    shutil.copytree(JAVASCRIPT.folder, copy, ignore=shutil.ignore_patterns("node_modules", "build"))
    return copy


def test_another_cmake_project_finds_the_installed_package(tmp_path: Path) -> None:
    CPP.ready()
    run(["cmake", "--install", "build", "--prefix", str(tmp_path / "installed")], CPP.folder)
    shutil.copy(CPP.folder / "examples" / "skeleton.cpp", tmp_path / "own.cpp")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(own CXX)\nfind_package(glue_rl 0.3 REQUIRED)\n"
        "add_executable(own own.cpp)\ntarget_link_libraries(own PRIVATE glue_rl::glue_rl)\n"
    )
    run(["cmake", "-B", "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}"], tmp_path)
    run(["cmake", "--build", "build"], tmp_path)

    assert (tmp_path / "build" / "own").exists()


@pytest.mark.parametrize("tool", ["fmt", "clippy"])
def test_rust_is_formatted_and_has_no_lint(tool: str) -> None:
    RUST.ready()
    if subprocess.run(["cargo", tool, "--version"], capture_output=True).returncode != 0:
        pytest.skip(f"there is no cargo {tool} here")
    arguments = {"fmt": ["--check"], "clippy": ["--quiet", "--all-targets", "--", "-D", "warnings"]}
    run(["cargo", tool, *arguments[tool]], RUST.folder)

"""The client libraries: the tools, the build and the example programs of each."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
CLIENTS: Final = ROOT / "clients"

_BUILD_SECONDS: Final = 600.0


@dataclass(frozen=True)
class Language:
    """A client library.

    Args:
        name: name of its folder.
        tools: the programs that build and run it, and their Debian packages.
        build: commands that build its examples, in its folder.
        tests: the commands that run its own tests, in its folder.
        programs: the commands of its examples: random, skeleton, experiment and mirror.
    """

    name: str
    tools: Mapping[str, str]
    build: Sequence[Sequence[str]]
    tests: Sequence[Sequence[str]]
    programs: Mapping[str, Sequence[str]]

    @property
    def folder(self) -> Path:
        return CLIENTS / self.name

    def ready(self) -> None:
        """Build the library, if possible and enabled; otherwise skip the test with a one-line reason."""
        for tool, package in self.tools.items():
            if shutil.which(tool) is None:
                pytest.skip(f"there is no {tool} here for clients/{self.name} (Debian: {package})")
        (self.folder / "build").mkdir(exist_ok=True)
        with (self.folder / "build" / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # the tests may run in several processes
            for command in self.build:
                run(command, self.folder)


def run(
    command: Sequence[str], cwd: Path, seconds: float = _BUILD_SECONDS, status: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a command, which must end with this status."""
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, timeout=seconds
    )
    assert done.returncode == status, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done


def _in_folder(name: str, *parts: str) -> str:
    return str(CLIENTS.joinpath(name, *parts))


_EXAMPLES: Final = ("random", "skeleton", "experiment", "mirror")

_CLASSES: Final = dict(zip(_EXAMPLES, ("RandomAgent", "Skeleton", "FewEpisodes", "Mirror"), strict=True))

_JAVA_PATH: Final = f"{_in_folder('java', 'build', 'glue-rl.jar')}:{_in_folder('java', 'build', 'examples')}"

JAVASCRIPT: Final = Language(
    "javascript",
    {"node": "nodejs"},
    (),
    (("node", "--test", "test/"),),
    {each: ("node", _in_folder("javascript", "examples", f"{each}.js")) for each in _EXAMPLES},
)

JAVA: Final = Language(
    "java",
    {"javac": "openjdk-17-jdk-headless", "make": "make"},
    (("make", "all"),),
    (("make", "test"), ("make", "javadoc")),
    {
        each: ("java", "-XX:+UseSerialGC", "-XX:TieredStopAtLevel=1", "-cp", _JAVA_PATH, _CLASSES[each])
        for each in _EXAMPLES
    },
)

RUST: Final = Language(
    "rust",
    {"cargo": "cargo", "rustc": "rustc"},
    (("cargo", "build", "--quiet", "--release", "--examples"),),
    (("cargo", "test", "--quiet"), ("cargo", "doc", "--quiet")),
    {each: (_in_folder("rust", "target", "release", "examples", each),) for each in _EXAMPLES},
)

CPP: Final = Language(
    "cpp",
    {"g++": "g++", "cmake": "cmake", "pkg-config": "pkg-config"},
    (("cmake", "-B", "build"), ("cmake", "--build", "build")),
    (("ctest", "--test-dir", "build", "--output-on-failure"),),
    {each: (_in_folder("cpp", "build", each),) for each in _EXAMPLES},
)

_BIN: Final = Path(sys.executable).parent

PYTHON: Final = Language(
    "python",
    {},
    (),
    (),
    {
        "random": (str(_BIN / "glue-agent"), f"{Path(__file__).with_name('random_agent.py')}:RandomAgent"),
        "skeleton": (str(_BIN / "glue-env"), "skeleton"),
    },
)
"""Players of our own library, for comparison."""

LANGUAGES: Final = (JAVASCRIPT, CPP, JAVA, RUST)


OWN: Final = {
    "cpp": (
        "agent.cpp",
        ("g++", "-std=c++17", f"-I{CLIENTS / 'cpp/include'}", "agent.cpp"),
        ("./a.out",),
    ),
    "java": ("Walker.java", (), ("java", "-cp", str(CLIENTS / "java/build/glue-rl.jar"), "Walker.java")),
    "javascript": ("agent.mjs", (), ("node", "agent.mjs")),
    "rust": ("main.rs", ("cargo", "build", "--quiet", "--offline"), ("target/debug/walker",)),
}
"""For each language the file of one's own program, the command that builds it, and the one that starts it."""

_MANIFEST: Final = f"""\
[package]
name = "walker"
version = "0.1.0"
edition = "2021"

[[bin]]
name = "walker"
path = "main.rs"

[dependencies]
glue-rl = {{ path = "{CLIENTS / "rust"}" }}
"""


def own_program(language: Language, code: str, folder: Path) -> Sequence[str]:
    """Write and build a program in an empty folder; return the command that starts it there.

    In Java its class is Walker.
    """
    file, build, start = OWN[language.name]
    (folder / file).write_text(code)
    (folder / "Cargo.toml").write_text(_MANIFEST)
    (folder / "node_modules").mkdir()
    (folder / "node_modules" / "glue-rl").symlink_to(CLIENTS / "javascript")
    if build:
        run(build, folder)
    return start

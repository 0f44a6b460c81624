"""A container engine, and the entrants of this folder as images; without an engine, all tests are skipped.

`docker/engine .venv/bin/python -m pytest tests/jails` provides an engine.
"""

from __future__ import annotations

import gc
import os
import socket
import subprocess
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.house.imports import ROOT

docker = pytest.importorskip("docker", reason="needs the extra compete", exc_type=ImportError)

HOSTILE = ROOT / "tests/jails/hostile"

_BUILD_SECONDS = 600


@pytest.fixture(autouse=True)
def unclosed() -> Iterator[None]:
    """Allow Docker's SDK to leave its sockets to the garbage collector."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        yield
        gc.collect()


@pytest.fixture(scope="session")
def engine() -> Iterator[Any]:
    path = os.environ.get("DOCKER_HOST", "unix:///var/run/docker.sock").removeprefix("unix://")
    with socket.socket(socket.AF_UNIX) as probe:
        if probe.connect_ex(path) != 0:
            pytest.skip("no container engine runs here; docker/engine brings one")
    client = docker.from_env()
    yield client
    client.close()


@pytest.fixture(scope="session")
def build(engine: Any) -> Callable[[str], str]:
    """Return a function that builds the image of an entrant of this folder, and returns its tag."""
    command = ["docker", "build", "--quiet", "--file", "docker/Dockerfile", "--target", "hub", "--tag"]
    subprocess.run([*command, "glue-hub", "."], cwd=ROOT, check=True, timeout=_BUILD_SECONDS)

    def build(entrant: str) -> str:
        tag = f"glue-test/{entrant}"
        engine.images.build(path=str(HOSTILE), buildargs={"ENTRANT": entrant}, tag=tag, forcerm=True)
        return tag

    return build


@pytest.fixture
def image(engine: Any) -> Iterator[Callable[..., str]]:
    """Return a function that builds an image from the base image and some lines of a Dockerfile."""
    made: list[str] = []

    def image(*lines: str) -> str:
        tag = f"glue-test/image{len(made)}"
        text = "\n".join([f"FROM {_base()}", *lines]).encode()
        subprocess.run(["docker", "build", "--quiet", "--tag", tag, "-"], input=text, check=True, timeout=60)
        made.append(tag)
        return tag

    yield image
    for tag in made:
        engine.images.remove(tag, force=True)


def _base() -> str:
    lines = Path(ROOT, "docker/Dockerfile").read_text().splitlines()
    return next(line.split()[1] for line in lines if line.startswith("FROM ") and line.endswith(" AS base"))

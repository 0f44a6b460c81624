"""The page's own files: all there, nothing from elsewhere, and what is not ours as it was published."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import experiment_runner.view

STATIC = Path(experiment_runner.view.__file__).with_name("static")
OURS = [
    path
    for path in STATIC.rglob("*")
    if path.suffix in (".js", ".css", ".html") and "uplot" not in path.parts
]


def test_uplot_is_what_was_published_with_its_licence() -> None:
    sums = (STATIC / "uplot/SHA256SUMS").read_text().split("\n")[:-1]
    listed = {name: digest for digest, name in (line.split("  ") for line in sums)}
    assert {"LICENSE", "uPlot.esm.js", "uPlot.min.css"} == listed.keys()
    for name, digest in listed.items():
        assert hashlib.sha256((STATIC / "uplot" / name).read_bytes()).hexdigest() == digest, name
    assert "MIT License" in (STATIC / "uplot/LICENSE").read_text()
    # What npm has under this version, seen when it was taken.
    assert (STATIC / "uplot/VERSION").read_text() == "1.6.32\n"
    assert listed["uPlot.esm.js"] == "5dd9b3281aa64b461b42d9945f6adb2649d346502b12281a9ae0d46599a80eba"


def test_no_text_becomes_markup_and_nothing_is_evaluated() -> None:
    assert len(OURS) >= 8
    forbidden = (
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|srcdoc|javascript:"
    )
    for path in OURS:
        assert not re.search(forbidden, path.read_text()), path


def test_nothing_comes_from_another_host_or_stands_inline() -> None:
    for path in OURS:
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "//" not in re.sub(r"(?m)(^|\s)//.*$", "", text), path
        assert (
            not re.search(r"<script(?![^>]*src=)|<style|\sstyle=|\son\w+=", text) or path.suffix == ".js"
        ), path

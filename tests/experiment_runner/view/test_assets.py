"""The page's own files: all there, and nothing from elsewhere."""

from __future__ import annotations

import re
from pathlib import Path

import experiment_runner.view

STATIC = Path(experiment_runner.view.__file__).with_name("static")
OURS = [path for path in STATIC.rglob("*") if path.suffix in (".js", ".css", ".html")]


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

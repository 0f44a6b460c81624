"""docs/architecture.md shows the program as it is: its folders, its files, its picture."""

from __future__ import annotations

import re
from typing import Final

import pytest

from tests.house.imports import ROOT, files
from tests.house.picture import FILE, drawing

TEXT: Final = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")


def test_the_picture_is_that_of_the_imports() -> None:
    current = FILE.read_text(encoding="utf-8") == drawing()
    assert current, "the imports between folders have changed: run `make picture`"


def test_folders_and_files_that_the_page_names_are_there() -> None:
    named = set(re.findall(r"\b(?:glue|env_server|agents|experiment_runner|tests)/[\w/]*(?:\.py)?", TEXT))
    assert len(named) > 30
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_every_folder_of_glue_is_explained() -> None:
    folders = {f"{file.parent}/" for file in files() if file.parts[0] == "glue"}
    assert folders <= set(re.findall(r"^\| `(\S+)` \|", TEXT, re.MULTILINE))


@pytest.mark.parametrize("document", ["architecture", "glossary"])
def test_links_lead_somewhere(document: str) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", (ROOT / f"docs/{document}.md").read_text(encoding="utf-8")):
        file, _, anchor = target.partition("#")
        linked = ROOT / "docs" / file
        assert linked.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {heading.lower().replace(" ", "-") for heading in headings}, target

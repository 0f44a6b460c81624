"""docs/install.md lists every extra that is for users."""

from __future__ import annotations

import re
import tomllib

from tests.house.imports import ROOT

DEVELOPERS = {"bench", "dev", "docs"}


def test_every_extra_is_listed_once() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = set(tomllib.load(file)["project"]["optional-dependencies"])
    section = (ROOT / "docs/install.md").read_text("utf-8").partition("## Extras")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(listed) == sorted(extras - DEVELOPERS)

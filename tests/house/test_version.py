"""The version is defined in one place, and the first heading of the changelog names it."""

from __future__ import annotations

import re
import tomllib

from glue import __version__
from tests.house.imports import ROOT


def test_the_version_is_that_of_the_package_and_of_the_changelog() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in settings["project"]
    assert settings["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "glue.__version__"}
    first = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert first is not None
    assert first[1] == __version__

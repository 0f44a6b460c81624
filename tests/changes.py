"""Mistakes as changes of the source of something that is right: tables of them, in TOML.

Each row names its `mistake`, and has the text `before` and `after` it, or a list of several such `changes`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

Row = Mapping[str, Any]


def read_table(file: Path) -> dict[str, Row]:
    """Return the rows of a table by their mistakes."""
    return {row["mistake"]: row for row in tomllib.loads(file.read_text("utf-8"))["fault"]}


def changed(file: Path, row: Row) -> ModuleType:
    """Return a module as it is after the changes of a row; each text has to occur in its source once."""
    source = file.read_text("utf-8")
    once = [(row["before"], row["after"])] if "before" in row else []
    for before, after in row.get("changes", once):
        if source.count(before) != 1:
            raise ValueError(f"{row['mistake']}: {before!r} occurs {source.count(before)} times")
        source = source.replace(before, after)
    module = ModuleType(str(row.get("mistake", file.stem)))
    exec(compile(source, str(file), "exec"), vars(module))
    return module

"""The contents of a Soar agent's working memory, read as Soar prints it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping

from agents.soar.kernel import Kernel

Memory = Mapping[str, Mapping[str, list[str]]]
"""Identifiers, each with its attributes and their values as texts."""

_OBJECT = re.compile(r"\(([A-Z]\d+)((?:[^()|]|\|[^|]*\|)*)\)")
_ATTRIBUTE = re.compile(r"\^(\S+)\s+(\|[^|]*\||[^\s^]+)(\s+\+)?")


def working_memory(kernel: Kernel, root: str, depth: int) -> Memory:
    """Return the elements reachable from an identifier; acceptable operators are called `operator+`."""
    found: dict[str, dict[str, list[str]]] = {}
    for identifier, attributes in _OBJECT.findall(kernel.command(f"print --depth {depth} {root}")):
        values = found.setdefault(identifier, defaultdict(list))
        for name, value, acceptable in _ATTRIBUTE.findall(attributes):
            values[name + "+" * bool(acceptable)].append(value.strip("|"))
    return found

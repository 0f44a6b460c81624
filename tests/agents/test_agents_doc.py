"""docs/agents.md names every agent, and every option with its default."""

from __future__ import annotations

import re

import pytest

from agents.mario.agent import MarioAgent
from agents.mario.sample import SampleAgent
from agents.mohan2010.flat import ObjectsFlatAgent, TilesAgent, TilesCoarseAgent
from agents.mohan2010.hierarchical import (
    HierarchicalAgent,
    HierarchicalFactsAgent,
    HierarchicalInternalAgent,
    HierarchicalProgrammedAgent,
    ObjectsCoarseAgent,
)
from glue.options import parameters
from tests.pages import DOCS, rows

DOCUMENT = (DOCS / "agents.md").read_text(encoding="utf-8")
EXPERIMENTS: dict[type[MarioAgent], str] = {
    SampleAgent: "",
    TilesAgent: "1",
    TilesCoarseAgent: "2",
    ObjectsFlatAgent: "3",
    HierarchicalProgrammedAgent: "4",
    HierarchicalAgent: "5",
    HierarchicalFactsAgent: "6",
    HierarchicalInternalAgent: "7",
    ObjectsCoarseAgent: "8",
}


@pytest.mark.parametrize("kind", EXPERIMENTS, ids=lambda kind: kind.name)
def test_every_agent_and_option_is_documented(kind: type[MarioAgent]) -> None:
    assert re.search(rf"^\| `{kind.name}` \| {EXPERIMENTS[kind]} ?\|", DOCUMENT, re.MULTILINE)
    for name, parameter in parameters(kind).items():
        default = "the experiment's" if parameter.default is None else f"{parameter.default:g}"
        if parameter.type is bool:
            default = str(parameter.default).lower()
        assert f"| `{name}` | {default} |" in DOCUMENT


def test_no_option_is_documented_that_is_not_there() -> None:
    known = {name for kind in EXPERIMENTS for name in parameters(kind)}
    assert {row[0].strip("`") for row in rows(DOCUMENT, "| option |")} == known

"""docs/agents.md names every agent, and every option with its default."""

from __future__ import annotations

import re

import pytest

from glue.options import parameters
from glue.plugins.loading import find
from glue.wire.messages import Role
from tests.agents.mohan2010.test_paper_agents import PAPER
from tests.pages import DOCS, rows

DOCUMENT = (DOCS / "agents.md").read_text(encoding="utf-8")
OPTIONS = {name: parameters(find(Role.AGENT, name)) for name in ("sample", *PAPER)}


@pytest.mark.parametrize("agent", OPTIONS)
def test_every_agent_and_option_is_documented(agent: str) -> None:
    experiment = PAPER.index(agent) + 1 if agent in PAPER else ""
    assert re.search(rf"^\| `{agent}` \| {experiment} ?\|", DOCUMENT, re.MULTILINE)
    for name, parameter in OPTIONS[agent].items():
        default = "the experiment's" if parameter.default is None else f"{parameter.default:g}"
        if parameter.type is bool:
            default = str(parameter.default).lower()
        assert f"| `{name}` | {default} |" in DOCUMENT


def test_no_option_is_documented_that_is_not_there() -> None:
    known = {name for options in OPTIONS.values() for name in options}
    assert {row[0].strip("`") for row in rows(DOCUMENT, "| option |")} == known

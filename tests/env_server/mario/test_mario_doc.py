"""docs/mario.md tells authors of agents how the environment behaves."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from env_server.mario.environment import InfiniteMario
from env_server.mario.parameters import MDPS
from env_server.mario.pictures import read_picture
from env_server.render.scene import KINDS
from glue.errors import ConfigError
from glue.options import parameters, parse_assignments
from tests.pages import DOCS, rows

TEXT = (DOCS / "mario.md").read_text(encoding="utf-8")


def task(**options: int | str) -> dict[str, object]:
    return json.loads(InfiniteMario(**options).env_message("parameters"))  # type: ignore[no-any-return]


def test_instances_are_as_listed() -> None:
    listed = rows(TEXT, "| instance | differs")
    assert [int(number) for number, _ in listed] == list(range(10))
    for number, differing in listed:
        options = parse_assignments(InfiniteMario, differing.split())
        assert task(instance=int(number)) == task() | options


def test_mdps_are_as_listed() -> None:
    listed = {}
    for number, proving, testing, differing in rows(TEXT, "| | proving"):
        options = parse_assignments(InfiniteMario, differing.split())
        listed[f"proving-{number}"] = {"level_seed": int(proving), **options}
        listed[f"testing-{number}"] = {"level_seed": int(testing), **options}
    assert set(listed) == set(MDPS)
    for name, options in listed.items():
        assert task(mdp=name) == task() | options


def test_kinds_are_as_listed() -> None:
    cells = [cell for row in rows(TEXT, "| kind | actor") for cell in (row[:2], row[2:])]
    assert {int(kind): actor for kind, actor in cells} == KINDS


def test_every_character_of_a_picture_is_listed(tmp_path: Path) -> None:
    listed = "".join(cell for cell, _ in rows(TEXT, "| character |")).replace("&#124;", "`|`")
    characters = re.findall(r"`(.)`", listed)
    file = tmp_path / "level.txt"
    file.write_text("F" + "?" * 19 + "\n\n9 0 z")
    with pytest.raises(ConfigError) as error:
        read_picture(file)
    assert f"expected one of {''.join(sorted(characters))} " in str(error.value)


def test_messages_are_answered() -> None:
    mario = InfiniteMario()
    messages = [message.strip("`") for message, _ in rows(TEXT, "| message | answer |")]
    answers = [mario.env_message(message) for message in messages]
    assert json.loads(answers[0])["level_seed"] == 121
    assert answers[1:] == [
        "level_seed=121 level_type=0 level_difficulty=0",
        "level_seed=7 level_type=1 level_difficulty=0",
    ]


def test_options_that_are_named_exist() -> None:
    named = set(re.findall(r"`(\w+)=\w+`", TEXT)) | set(re.findall(r"`(reward_\w+|max_\w+|alpha)`", TEXT))
    assert {"reward_step", "max_trial_steps", "alpha", "render", "velocity", "start_ticks"} <= named
    assert named <= set(parameters(InfiniteMario))


def test_every_parameter_is_listed_with_its_default_and_bounds() -> None:
    known = parameters(InfiniteMario)
    for name, default, bounds, unit, meaning in rows(TEXT, "| parameter | default"):
        name = name.strip("`")
        assert str(task()[name]) == default
        about = known.pop(name).option
        shown = about.choices or (f"{about.low:.10g} to {about.high:.10g}",)
        assert (", ".join(shown), about.unit) == (bounds, unit)
        assert about.help == f"{meaning}; {default} by default"
    assert [*known] == ["instance", "mdp", "level", "level_digest", "extras"]

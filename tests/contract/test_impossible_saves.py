"""Saves that an agent cannot have written: of the right form, with contents that contradict each other."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest

from agents.mario.best import Archive
from env_server.mario import InfiniteMario
from glue.errors import SaveError
from glue.plugins.loading import find
from glue.saves import Saved, generator_array, pack
from glue.wire.messages import Role

_GENERATOR: Final = {"generator": generator_array(np.random.default_rng(1))}
_ARCHIVE: Final = {f"0 {name}": array for name, array in Archive().arrays().items()}
_WORLDS: Final = {"worlds": np.array([7])}
_NO_WORLDS: Final = {"worlds": np.empty(0, np.int64)}
_BEST: Final = {**_WORLDS, **_GENERATOR, **_ARCHIVE}

_TILES: Final = {"random": 1, "cycles": 0}
_KEYS, _VALUES = np.array([1, 5], np.uint64), np.array([0.5, -1.0])
_TABLE: Final = {"keys": _KEYS, "values": _VALUES}

_SAMPLE: Final = {"random": 1, "hesitating": 0}
_LAST: Final = {"last": np.array([1], np.int8)}

POSSIBLE: Final[dict[str, tuple[dict[str, int], dict[str, Any]]]] = {
    "best": ({"episodes": 3}, _BEST),
    "tiles": (_TILES, _TABLE),
    "sample": (_SAMPLE, _LAST),
}
"""Numbers and arrays that each agent can have saved."""

IMPOSSIBLE: Final[list[tuple[str, dict[str, int], dict[str, Any]]]] = [
    ("best", {"episodes": 3}, _NO_WORLDS),
    ("best", {"episodes": 3}, {**_NO_WORLDS, "generator": _GENERATOR["generator"][:39]}),
    ("best", {"episodes": -1}, {**_NO_WORLDS, **_GENERATOR}),
    ("best", {"episodes": 3}, _GENERATOR),
    ("best", {"episodes": 3}, {**_GENERATOR, "worlds": np.empty(0)}),
    ("best", {"episodes": 3}, {**_GENERATOR, **_WORLDS}),
    ("best", {"episodes": 3}, {**_BEST, "0 values": np.zeros(1)}),
    ("best", {"episodes": 3}, {**_BEST, "worlds": np.array([7, 8])}),
    ("best", {"episodes": 3}, {**_BEST, "worlds": np.arange(9)}),
    ("tiles", _TILES, {"keys": _KEYS}),
    ("tiles", _TILES, {"values": _VALUES}),
    ("tiles", _TILES, {**_TABLE, "keys": _KEYS[::-1]}),
    ("tiles", _TILES, {**_TABLE, "keys": _KEYS - np.uint64(1)}),
    ("tiles", _TILES, {**_TABLE, "keys": np.array([5, 5], np.uint64)}),
    ("tiles", _TILES, {**_TABLE, "values": _VALUES[:1]}),
    ("tiles", _TILES, {**_TABLE, "keys": _KEYS.astype(np.int64)}),
    ("tiles", _TILES, {**_TABLE, "values": np.array([0.5, np.nan])}),
    ("tiles", {"random": -1, "cycles": 0}, _TABLE),
    ("tiles", {"random": 2**64, "cycles": 0}, _TABLE),
    ("tiles", {"random": 1, "cycles": -1}, _TABLE),
    ("tiles", {"cycles": 0}, _TABLE),
    ("sample", _SAMPLE, {"last": np.array([12], np.int8)}),
    ("sample", _SAMPLE, {"last": np.array([-1], np.int8)}),
    ("sample", {"random": 1, "hesitating": 2}, _LAST),
    ("sample", {"random": 2**48, "hesitating": 0}, _LAST),
    ("sample", {"hesitating": 0}, _LAST),
]


@pytest.mark.parametrize(("name", "numbers", "arrays"), IMPOSSIBLE)
def test_what_an_agent_cannot_have_saved_is_refused_and_changes_nothing(
    name: str, numbers: dict[str, int], arrays: dict[str, Any]
) -> None:
    agent: Any = find(Role.AGENT, name)()
    agent.agent_init(InfiniteMario().env_init())
    before = agent.agent_save()
    with pytest.raises(SaveError):
        agent.agent_load(pack(Saved(name, {}, numbers, arrays)))
    assert agent.agent_save() == before
    agent.agent_load(pack(Saved(name, {}, *POSSIBLE[name])))
    assert agent.agent_save() != before

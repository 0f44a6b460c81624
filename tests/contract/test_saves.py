"""Every installed player refuses a damaged save, survives a forged one, and reads those of older versions."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import random
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from agents.mario.best import Archive
from agents.sarsa import feature, table_of
from env_server.mario import InfiniteMario
from glue import saves
from glue.engine.local import local
from glue.errors import SaveError
from glue.plugins.loading import find
from glue.roles import SaveableAgent, SaveableEnvironment, offers
from glue.saves import Saved, generator_array, pack, unpack
from glue.wire.messages import Role
from tests.players import installed, outcomes
from tests.proof import size

OLD: dict[str, dict[str, Any]] = json.loads(
    gzip.decompress(Path(__file__).parents[1].joinpath("golden", "old_saves.json.gz").read_bytes())
)
"""By agent: its task, the saves of both players after three episodes, and the three episodes after that."""
TASKS = {"linear": "mines", **{name: old["environment"] for name, old in OLD.items()}}
OPTIONS: dict[str, dict[str, Any]] = {"mines": {"random_start": True}}
SAVEABLE = {Role.AGENT: SaveableAgent, Role.ENVIRONMENT: SaveableEnvironment}
PLAYERS = [
    (role, name) for role in SAVEABLE for name in installed(role) if offers(find(role, name), SAVEABLE[role])
]
MUTATIONS = size(200, 1000)

all_players = pytest.mark.parametrize(("role", "name"), PLAYERS, ids=lambda value: str(value))


def make(role: Role, name: str) -> Any:
    return find(role, name)(**OPTIONS.get(name, {}) if role is Role.ENVIRONMENT else {})


@cache
def played(role: Role, name: str) -> tuple[Any, bytes]:
    """Return a player in the middle of a run, and its save."""
    agent = name if role is Role.AGENT else {"mines": "sarsa", "skeleton": "skeleton"}.get(name, "random")
    environment = TASKS.get(name, "mario") if role is Role.AGENT else name
    players = make(Role.AGENT, agent), make(Role.ENVIRONMENT, environment)
    glue = local(*players)
    glue.rl_init(seed=7)
    outcomes(glue, 3, 60)
    player = players[role is not Role.AGENT]
    return player, save(role, player)


def save(role: Role, player: Any) -> bytes:
    saved: bytes = player.agent_save() if role is Role.AGENT else player.env_save()
    return saved


def load(role: Role, player: Any, data: bytes) -> None:
    (player.agent_load if role is Role.AGENT else player.env_load)(data)


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Return `data` with some bits flipped, bytes replaced, a piece cut out or put in, or its end cut off."""
    broken = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        place = rng.randrange(len(broken)) if broken else 0
        kind = rng.randrange(5)
        if kind == 0 and broken:
            broken[place] ^= 1 << rng.randrange(8)
        elif kind == 1 and broken:
            broken[place] = rng.randrange(256)
        elif kind == 2:
            del broken[place : place + rng.randrange(1, 9)]
        elif kind == 3:
            broken[place:place] = rng.randbytes(rng.randrange(1, 9))
        elif len(broken) > 1:
            del broken[rng.randrange(1, len(broken)) :]
    return bytes(broken)


NUMBERS = [
    "-1",
    "2147483648",
    str(2**70),
    "1" + "0" * 5000,
    "Infinity",
    "NaN",
    "1.5",
    "null",
    "true",
    '"x"',
    "[]",
]


def forged(saved: bytes, rng: random.Random) -> bytes:
    """Return a save with a changed header or changed arrays, and a matching digest."""
    head, contents = saved[: saves._HEAD.size], saved[saves._HEAD.size : -saves._DIGEST_SIZE]
    size = saves._HEAD.unpack(head)[2]
    header, arrays = contents[:size], contents[size:]
    if rng.random() < 0.5:
        fields = json.loads(header)
        if fields["numbers"]:
            fields["numbers"][rng.choice(sorted(fields["numbers"]))] = "HERE"
        if fields["arrays"] and rng.random() < 0.5:
            rng.choice(fields["arrays"])[rng.randrange(3)] = "HERE"
        header = json.dumps(fields).replace('"HERE"', rng.choice(NUMBERS)).encode()
    elif rng.random() < 0.5 or not arrays:
        header = mutated(header, rng)
    else:
        broken = bytearray(arrays)
        place = rng.randrange(len(broken)) & ~7
        broken[place : place + 8] = rng.choice(
            (b"\xff" * 8, b"\0" * 7 + b"\x80", np.float64(np.nan).tobytes())
        )
        arrays = bytes(broken[: len(arrays)])
    data = saves._HEAD.pack(saves._MAGIC, saves._VERSION, len(header)) + header + arrays
    return data + hashlib.sha256(data).digest()


@pytest.mark.proof
@all_players
def test_a_forged_save_is_refused_or_harmless(role: Role, name: str) -> None:
    player, saved = played(role, name)
    rng = random.Random(f"{role} {name}")
    refused = 0
    for _ in range(MUTATIONS):
        try:
            load(role, player, forged(saved, rng))
        except SaveError:
            refused += 1
        else:
            save(role, player)
    assert refused > MUTATIONS // 3
    load(role, player, saved)
    assert save(role, player) == saved


@pytest.mark.parametrize("agent", sorted(OLD))  # new agents have no old saves
def test_saves_of_earlier_versions_are_continued_exactly(agent: str) -> None:
    old = OLD[agent]
    with local(make(Role.AGENT, agent), make(Role.ENVIRONMENT, old["environment"])) as glue:
        glue.rl_init(seed=99)
        glue.rl_agent_load(base64.b64decode(old["agent_save"]))
        glue.rl_env_load(base64.b64decode(old["env_save"]))
        assert outcomes(glue, 3, 60) == [tuple(episode) for episode in old["episodes"]]


def test_keys_that_collide_are_refused_long_before_they_take_time() -> None:
    """160,000 colliding keys took 26 seconds of compiled code that nothing could interrupt."""
    colliding = np.arange(1, 160_001, dtype=np.uint64) << np.uint64(24)
    with pytest.raises(SaveError, match="collide"):
        table_of(colliding, np.zeros(len(colliding)))
    tiles: Any = played(Role.AGENT, "tiles")[0]
    saved = unpack(tiles.agent_save(), "tiles", {})
    forgery = Saved("tiles", {}, saved.numbers, {"keys": colliding, "values": np.zeros(160_000)})
    with pytest.raises(SaveError, match="collide"):
        tiles.agent_load(pack(forgery))


def test_keys_of_a_learner_are_never_refused() -> None:
    keys = np.sort(np.array([feature(number) for number in range(200_000)], np.uint64))
    assert np.count_nonzero(table_of(keys, np.ones(len(keys)))["key"]) == 200_000


def test_a_save_of_another_player_is_refused() -> None:
    for role, name in PLAYERS:
        for other_role, other in PLAYERS:
            if (role, name) != (other_role, other) and role is other_role:
                with pytest.raises(SaveError, match="cannot be loaded"):
                    load(role, played(role, name)[0], played(other_role, other)[1])


# Saves of the right form whose contents contradict each other

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

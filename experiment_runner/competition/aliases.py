"""Pseudonyms of entrants."""

from __future__ import annotations

import hmac
import itertools
from collections.abc import Collection
from typing import Final

_COLOURS: Final = ("amber", "azure", "coral", "crimson", "emerald", "golden", "indigo", "ivory", "jade")
_ANIMALS: Final = ("badger", "crane", "falcon", "fox", "heron", "ibis", "lynx", "otter", "owl", "raven")
_NUMBERS: Final = 1_000_000


def pseudonym(name: str, secret: bytes, taken: Collection[str]) -> str:
    """Return a pseudonym that nobody has, and that tells the name only to those who know the secret."""
    rest, colour = divmod(int.from_bytes(derived(secret, "alias", name)), len(_COLOURS))
    rest, animal = divmod(rest, len(_ANIMALS))
    alias = f"{_COLOURS[colour]} {_ANIMALS[animal]}"
    numbered = (f"{alias} {(rest + number) % _NUMBERS}" for number in itertools.count())
    return next(one for one in itertools.chain([alias], numbered) if one not in taken)


def derived(secret: bytes, *names: str) -> bytes:
    """Return 32 bytes that belong to these names, and that only those who know the secret can compute."""
    return hmac.digest(secret, "\0".join(names).encode(), "sha256")

"""A directory of a hub's keys, and the pairs of those who join it."""

from __future__ import annotations

from pathlib import Path

from glue.client.libzmq import new_pair
from glue.keys.certificates import PUBLIC, SECRET, write_pair


class KeyFolder:
    """The keys of a hub in `path`, and beside them the secret keys of whoever is to join.

    Attributes:
        hub_key: for `--hub-key`.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "keys"
        self._entrants = folder / "entrants"
        self.hub_key = self.path / f"hub{PUBLIC}"
        write_pair(self.path, "hub", new_pair())
        self.allow("")

    def allow(self, text: str) -> None:
        """Write the list of who may join."""
        (self.path / "allow.toml").write_text(text)

    def entrant(self, name: str) -> Path:
        """Make a pair, and hand in its public key; return the file with the secret one."""
        public, secret = write_pair(self._entrants, name, new_pair())
        assert secret.suffix == SECRET
        (self.path / public.name).write_bytes(public.read_bytes())
        return secret

"""A directory of a hub's keys, and the key pairs of the peers that join it."""

from __future__ import annotations

from pathlib import Path

from glue.client.libzmq import new_pair
from glue.keys.certificates import PUBLIC, SECRET, write_pair


class KeyFolder:
    """The keys of a hub in `path`, and in another folder the key pairs of its entrants.

    Attributes:
        hub_key: the file for `--hub-key`.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "keys"
        self._entrants = folder / "entrants"
        self.hub_key = self.path / f"hub{PUBLIC}"
        write_pair(self.path, "hub", new_pair())
        self.allow("")

    def allow(self, text: str) -> None:
        """Write the list of peers that may join."""
        (self.path / "allow.toml").write_text(text)

    def entrant(self, name: str) -> Path:
        """Create a key pair and copy its public key to the hub's folder; return the secret key's file."""
        public, secret = write_pair(self._entrants, name, new_pair())
        assert secret.suffix == SECRET
        (self.path / public.name).write_bytes(public.read_bytes())
        return secret

"""A hub's directory of keys: what it lets whom do, and mistakes in it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.errors import ConfigError
from glue.keys.allowed import read_keys
from glue.keys.certificates import encode, read_pair, read_public, write_pair
from glue.protocol.messages import Role
from tests.keyed import KeyFolder


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    return KeyFolder(tmp_path)


def test_a_list_says_who_may_join_as_what(folder: KeyFolder) -> None:
    carol, dave, erin = (read_pair(folder.entrant(name)).public for name in ("carol", "dave", "erin"))
    (folder.path / "dave.key").rename(folder.path / "dave.pub")
    folder.allow(
        '[carol]\nrole = "agent"\nsession = "a"\n'
        '[dave]\nrole = ["agent", "environment"]\nsession = ["a", "b"]\n'
        f"[anybody]\nrole = 'experiment'\nkey = '{encode(erin)}'\n"
    )
    keys = read_keys(folder.path)
    assert keys.secret == read_pair(folder.path / "hub.key_secret").secret
    assert keys.permits.keys() == {carol, dave, erin}
    may = {
        permit.name: {(str(role), one) for role in Role for one in "abc" if permit.admits(role, one)}
        for permit in keys.permits.values()
    }
    assert may == {
        "carol": {("agent", "a")},
        "dave": {(role, one) for role in ("agent", "environment") for one in "ab"},
        "anybody": {("experiment", one) for one in "abc"},
    }


def test_what_a_key_may_be_is_never_read_from_the_file_that_its_owner_sent(folder: KeyFolder) -> None:
    folder.entrant("carol")
    sent = folder.path / "carol.key"
    sent.write_text(sent.read_text().replace("metadata\n", 'metadata\n    role = "experiment"\n'))
    folder.allow('[carol]\nrole = "agent"')
    [permit] = read_keys(folder.path).permits.values()
    assert permit.roles == {Role.AGENT}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[carol\n", "is not TOML: .*line 1"),
        ("carol = 1", r"\[carol\] should be a table"),
        ('[carol]\nrole = "agnet"', r"\[carol\] names the role 'agnet'; did you mean agent\?"),
        ('[carol]\nroles = "agent"', r"'roles'; did you mean role\?"),
        ('[carol]\nsession = "a"', 'does not say which role it may take, as in: role = "agent"'),
        ("[carol]\nrole = 1", "role should be a string or a list of strings, not 1"),
        ('[carol]\nrole = "agent"\nsession = []', "may join no session"),
        ('[carol]\nrole = "agent"\nsession = ""', "the name of a session"),
        ('[carol]\nrole = "agent"\nkey = 1', "key should be"),
        ('[carol]\nrole = "agent"\nkey = "nowhere.pub"', "neither a file nor a key"),
        ('[nobody]\nrole = "agent"', r"has no key: put the file that its owner sent there, as .*nobody\.key"),
        ('[carol]\nrole = "agent"\n[c]\nkey = "carol.key"\nrole = "agent"', "carol and c have the same key"),
    ],
)
def test_a_mistake_in_the_list_names_file_and_table(folder: KeyFolder, text: str, what: str) -> None:
    folder.entrant("carol")
    folder.allow(text)
    with pytest.raises(ConfigError, match=what) as raised:
        read_keys(folder.path)
    assert str(folder.path / "allow.toml") in str(raised.value)


def test_a_directory_that_is_not_ready_is_refused_with_the_next_step(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError, match="glue-keys new hub --dir nowhere"):
        read_keys(Path("nowhere"))
    folder.path.chmod(0o777)
    with pytest.raises(ConfigError, match=f"other users can exchange the files in .*chmod o-w {folder.path}"):
        read_keys(folder.path)
    folder.path.chmod(0o755)
    (folder.path / "allow.toml").chmod(0o666)
    with pytest.raises(ConfigError, match="other users can change it: chmod o-w"):
        read_keys(folder.path)
    (folder.path / "allow.toml").unlink()
    with pytest.raises(ConfigError, match=r"there is no .*allow\.toml, which says who may join"):
        read_keys(folder.path)
    (folder.path / "allow.toml").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="is not UTF-8"):
        read_keys(folder.path)
    (folder.path / "allow.toml").write_bytes(bytes(2**20 + 1))
    with pytest.raises(ConfigError, match="is larger than"):
        read_keys(folder.path)
    (folder.path / "hub.key_secret").chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_keys(folder.path)


def test_a_pair_that_does_not_belong_together_is_refused(folder: KeyFolder) -> None:
    secret = folder.path / "hub.key_secret"
    wrong = encode(read_public(folder.entrant("carol")))
    secret.write_text(secret.read_text().replace(encode(read_public(secret)), wrong))
    with pytest.raises(ConfigError, match="its two keys do not belong together"):
        read_keys(folder.path)


def test_a_pair_of_glue_keys_fits_together_for_the_hub(tmp_path: Path) -> None:
    from glue.client.libzmq import new_pair
    from glue.protocol.curve import public_key

    _, secret = write_pair(tmp_path, "any", new_pair())
    pair = read_pair(secret)
    assert public_key(pair.secret) == pair.public

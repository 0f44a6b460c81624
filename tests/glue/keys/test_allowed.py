"""A hub's directory of keys: the permits in it, and mistakes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.errors import ConfigError
from glue.keys.allowed import read_keys
from glue.keys.certificates import encode, read_pair, read_public
from glue.wire.messages import Role
from tests.keyed import KeyFolder

NOBODY = 65534


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    return KeyFolder(tmp_path)


@pytest.fixture
def carols(folder: KeyFolder) -> KeyFolder:
    """A directory that admits one key."""
    folder.entrant("carol")
    folder.allow('[carol]\nrole = "agent"')
    assert len(read_keys(folder.path).permits) == 1
    return folder


def refused(folder: KeyFolder, why: str) -> ConfigError:
    """Expect that the keys cannot be read for this reason."""
    with pytest.raises(ConfigError, match=why) as raised:
        read_keys(folder.path)
    return raised.value


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
        ('[carol]\nrole = "agent"\nkey = "nowhere.pub"', "neither a file in .* nor a key"),
        ('[nobody]\nrole = "agent"', r"has no key: put the file that its owner sent there, as .*nobody\.key"),
        ('["a\\u0000b"]\nrole = "agent"', r"\[a.b\] has no key"),
        ('[carol]\nrole = "agent"\n[c]\nkey = "carol.key"\nrole = "agent"', "carol and c have the same key"),
    ],
)
def test_a_mistake_in_the_list_names_file_and_table(folder: KeyFolder, text: str, what: str) -> None:
    folder.entrant("carol")
    folder.allow(text)
    assert str(folder.path / "allow.toml") in str(refused(folder, what))


def test_a_key_is_read_from_no_file_beside_the_directory(
    folder: KeyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.entrant("carol")
    folder.allow('[carol]\nrole = "agent"\nkey = "carol.pub"')
    elsewhere = folder.path.with_name("elsewhere")
    elsewhere.mkdir(mode=0o700)
    (folder.path / "carol.key").rename(elsewhere / "carol.pub")  # the key is withdrawn
    monkeypatch.chdir(elsewhere)
    refused(folder, "neither a file in")


@pytest.mark.parametrize(
    "text",
    [
        f'["{"x" * 300}"]\nrole = "agent"',
        f"[carol]\nrole = {'[' * 5000}{']' * 5000}",
        f"[carol]\nrole{'.a' * 5000} = 1",
    ],
    ids=["name", "arrays", "keys"],
)
def test_a_list_beyond_all_measure_is_refused_in_a_line(folder: KeyFolder, text: str) -> None:
    folder.entrant("carol")
    folder.allow(text)
    with pytest.raises(ConfigError, match=rf"^cannot read the keys in {folder.path}: \w+[\w ]*$"):
        read_keys(folder.path)


def test_a_list_that_is_no_file_is_refused(folder: KeyFolder) -> None:
    listed = folder.path / "allow.toml"
    listed.unlink()
    os.mkfifo(listed)
    with pytest.raises(ConfigError, match="not a regular file"):
        read_keys(folder.path)
    listed.unlink()
    listed.symlink_to(listed)
    with pytest.raises(ConfigError, match="symbolic links lead to it"):
        read_keys(folder.path)


def test_a_directory_that_is_not_ready_is_refused_with_the_next_step(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError, match="make it in nowhere with glue-keys new hub") as caught:
        read_keys(Path("nowhere"))
    assert caught.value.settings == ("keys",)
    folder.path.chmod(0o777)
    refused(folder, f"chmod go-w {folder.path}")
    folder.path.chmod(0o755)
    (folder.path / "allow.toml").unlink()
    refused(folder, r"there is no .*allow\.toml")
    (folder.path / "allow.toml").write_bytes(b"\xff")
    refused(folder, "is not UTF-8")
    (folder.path / "allow.toml").write_bytes(bytes(2**20 + 1))
    refused(folder, "it has more than")
    (folder.path / "hub.key_secret").chmod(0o644)
    refused(folder, "chmod 600")


@pytest.mark.parametrize("name", [".", "allow.toml", "carol.key", "hub.key_secret"])
@pytest.mark.parametrize("mode", [0o020, 0o002])
def test_files_that_others_can_change_are_refused(carols: KeyFolder, name: str, mode: int) -> None:
    path = carols.path / name
    path.chmod(path.stat().st_mode | mode)
    refused(carols, "chmod")


@pytest.mark.parametrize("depth", [0, 1, 2])
def test_a_key_is_refused_below_a_folder_that_others_can_change(folder: KeyFolder, depth: int) -> None:
    folder.entrant("carol")
    inner = folder.path / "a/b/c"
    inner.mkdir(parents=True)
    (folder.path / "carol.key").rename(inner / "carol.key")
    folder.allow('[carol]\nrole = "agent"\nkey = "a/b/c/carol.key"')
    assert len(read_keys(folder.path).permits) == 1
    inner.parents[depth].chmod(0o777)
    refused(folder, f"exchange {inner.parents[depth]}: chmod go-w")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give a file away")
@pytest.mark.parametrize("name", [".", "allow.toml", "carol.key", "hub.key_secret"])
def test_files_of_another_user_are_refused(carols: KeyFolder, name: str) -> None:
    os.chown(carols.path / name, NOBODY, NOBODY)
    refused(carols, f"belongs to another user .*{NOBODY}")


@pytest.mark.parametrize("spoilt", ["folder of the link", "folder of the target", "target"])
@pytest.mark.parametrize("name", [".", "allow.toml", "carol.key", "hub.key_secret"])
def test_symbolic_links_lead_only_to_files_that_others_cannot_exchange(
    carols: KeyFolder, tmp_path: Path, name: str, spoilt: str
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link, target = carols.path / name, elsewhere / "target"
    link.rename(target)
    link.symlink_to("../elsewhere/target" if name != "." else "elsewhere/target")
    assert len(read_keys(carols.path).permits) == 1
    path = {"folder of the link": link.parent, "folder of the target": elsewhere, "target": target}[spoilt]
    path.chmod(path.stat().st_mode | 0o020)
    refused(carols, "chmod")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give a link away")
def test_a_symbolic_link_of_another_user_is_refused(folder: KeyFolder) -> None:
    link = folder.path / "allow.toml"
    link.rename(folder.path / "list")
    link.symlink_to("list")
    os.chown(link, NOBODY, NOBODY, follow_symlinks=False)
    refused(folder, f"belongs to another user .*{NOBODY}")


def test_a_pair_that_does_not_belong_together_is_refused(folder: KeyFolder) -> None:
    secret = folder.path / "hub.key_secret"
    wrong = encode(read_public(folder.entrant("carol")))
    secret.write_text(secret.read_text().replace(encode(read_public(secret)), wrong))
    refused(folder, "its two keys do not belong together")

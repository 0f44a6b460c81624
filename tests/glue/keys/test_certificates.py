"""Key files: compatible with zmq.auth, readable by their owner only, and never overwritten."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
import zmq.auth
from hypothesis import given
from hypothesis import strategies as st
from zmq.utils import z85

from glue.client.libzmq import new_pair
from glue.errors import ConfigError
from glue.keys.certificates import KeyPair, decode, encode, read_pair, read_public, write_pair


@given(st.binary(min_size=32, max_size=32))
def test_a_key_is_written_as_zeromq_writes_it(key: bytes) -> None:
    assert encode(key).encode() == z85.encode(key)
    assert decode(encode(key)) == key


@pytest.mark.parametrize("text", ["", "x" * 39, "x" * 41, "~" * 40, "é" * 40, "#" * 40, "'" * 40])
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not a key"):
        decode(text)


def test_the_secret_key_is_in_no_representation() -> None:
    pair = new_pair()
    assert repr(pair.secret) not in repr(pair)


def test_zmq_auth_reads_what_we_write(tmp_path: Path) -> None:
    pair = new_pair()
    public, secret = write_pair(tmp_path / "new" / "folder", "carol", pair)
    expected = encode(pair.public).encode(), encode(pair.secret).encode()
    assert zmq.auth.load_certificate(public) == (expected[0], None)
    assert zmq.auth.load_certificate(secret) == expected
    assert read_pair(secret) == pair
    assert read_public(public) == read_public(secret) == pair.public
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    assert stat.S_IMODE(public.parent.stat().st_mode) == 0o700


def test_we_read_what_zmq_auth_writes(tmp_path: Path) -> None:
    public, secret = zmq.auth.create_certificates(tmp_path, "carol", {"role": "a public-key = of another"})
    Path(secret).chmod(0o600)
    pair = read_pair(Path(secret))
    keys = encode(pair.public).encode(), encode(pair.secret).encode()
    assert keys == zmq.auth.load_certificate(secret)
    assert read_public(public) == pair.public


def test_a_public_key_can_be_its_text_or_a_file_with_nothing_else(tmp_path: Path) -> None:
    key = bytes(range(32))
    (tmp_path / "carol.pub").write_text(f"\n{encode(key)}\n")
    assert read_public(tmp_path / "carol.pub") == read_public(encode(key)) == key


@pytest.mark.parametrize("taken", ["carol.key", "carol.key_secret"])
def test_no_key_is_replaced(tmp_path: Path, taken: str) -> None:
    (tmp_path / taken).write_text("a key of long ago")
    with pytest.raises(ConfigError, match=f"{taken} exists already, and is not replaced"):
        write_pair(tmp_path, "carol", new_pair())
    assert [path.name for path in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_text() == "a key of long ago"


@pytest.mark.parametrize("name", ["", ".", "../carol", "a/b", "a\0b", "-x", "x" * 300])
def test_a_name_that_is_no_files_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="the name of a key"):
        write_pair(tmp_path / "keys", name, new_pair())
    assert not (tmp_path / "keys").exists()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o620])
def test_a_secret_key_that_others_can_read_is_refused_with_the_remedy(tmp_path: Path, mode: int) -> None:
    _, secret = write_pair(tmp_path, "carol", new_pair())
    secret.chmod(mode)
    with pytest.raises(ConfigError, match=f"chmod 600 {secret}"):
        read_pair(secret)


def test_files_without_the_key_that_is_needed_are_refused(tmp_path: Path) -> None:
    public, secret = write_pair(tmp_path, "carol", new_pair())
    public.chmod(0o600)
    with pytest.raises(ConfigError, match=rf"carol\.key holds no secret key: give {secret}"):
        read_pair(public)
    damaged = tmp_path / "damaged"
    for text in ('public-key = "x"\nsecret-key = "y"', "secret-key = " + "x" * 40):
        damaged.write_text(text)
        damaged.chmod(0o600)
        with pytest.raises(ConfigError, match="is damaged"):
            read_pair(damaged)
    for data in (b"", b"\xff\0", b"two\nlines"):
        damaged.write_bytes(data)
        with pytest.raises(ConfigError, match="holds no public key"):
            read_public(damaged)
    damaged.write_bytes(bytes(100_000))
    with pytest.raises(ConfigError, match="it has more than"):
        read_public(damaged)
    with pytest.raises(ConfigError, match=r"cannot read .*: Is a directory"):
        read_public(tmp_path)


def test_error_for_a_missing_file_names_the_setting(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no file nowhere") as caught:
        read_pair(Path("nowhere"))
    assert caught.value.settings == ("key",)
    for source in ("nowhere", "x" * 5000, "a\0b"):
        with pytest.raises(ConfigError) as caught:
            read_public(source)
        assert caught.value.settings == ("hub_key",)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"cannot make .*file: File exists"):
        write_pair(tmp_path / "file", "carol", KeyPair(bytes(32), bytes(32)))


def test_a_public_key_that_others_could_exchange_is_refused_with_the_remedy(tmp_path: Path) -> None:
    public, _ = write_pair(tmp_path, "carol", new_pair())
    public.chmod(0o666)
    with pytest.raises(ConfigError, match=f"chmod go-w {public}"):
        read_public(public)

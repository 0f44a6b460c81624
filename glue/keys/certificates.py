"""Key pairs in files, in the format of `zmq.auth`, which programs of any ZeroMQ library read and write.

A pair is two files: NAME.key with the public key, to hand out, and NAME.key_secret with both keys, to keep
secret. In files, messages and options a key is 40 characters of Z85.

Source: ZeroMQ RFC 32 (Z85), pyzmq's zmq.auth.
"""

from __future__ import annotations

import os
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from glue.errors import ConfigError
from glue.keys.files import read_own

PUBLIC: Final = ".key"
SECRET: Final = ".key_secret"
"""Suffix of the file with the secret key of a pair; the file of its public key has the suffix `PUBLIC`."""

_ALPHABET: Final = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"
_VALUES: Final = {character: value for value, character in enumerate(_ALPHABET)}
_CHARACTERS: Final = 40
_WORD: Final = struct.Struct(">I")

_NAME: Final = re.compile(r"[\w@][\w.@-]{0,99}", re.ASCII)
_LINE: Final = re.compile(r"""\s*(public-key|secret-key)\s*=\s*["']?(\S*?)["']?\s*""")

_MAX_FILE: Final = 65_536
"""Maximum size of a file, in bytes; a certificate has less than a thousand."""

_PUBLIC_FILE: Final = """\
#   ZeroMQ CURVE Public Certificate of {name}
#   Share it over a channel on which no one can replace it with another key.

metadata
curve
    public-key = "{public}"
"""

_SECRET_FILE: Final = """\
#   ZeroMQ CURVE **Secret** Certificate of {name}
#   Anyone who has this file can impersonate you: keep it private (mode 600).

metadata
curve
    public-key = "{public}"
    secret-key = "{secret}"
"""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public key and its secret key, 32 bytes each."""

    public: bytes
    secret: bytes = field(repr=False)


def encode(key: bytes) -> str:
    """Return a key of 32 bytes as text."""
    return "".join(
        _ALPHABET[word // 85**power % 85] for (word,) in _WORD.iter_unpack(key) for power in (4, 3, 2, 1, 0)
    )


def decode(text: str) -> bytes:
    """Return the key, 32 bytes, of a text.

    Raises:
        ValueError: the text is not 40 characters of Z85.
    """
    if len(text) != _CHARACTERS or not _VALUES.keys() >= set(text):
        raise ValueError("not a key")
    key = b""
    for at in range(0, _CHARACTERS, 5):
        word = 0
        for character in text[at : at + 5]:
            word = 85 * word + _VALUES[character]
        if word >= 2**32:
            raise ValueError("not a key")
        key += _WORD.pack(word)
    return key


def write_pair(directory: Path, name: str, pair: KeyPair) -> tuple[Path, Path]:
    """Write a pair into two new files; return the paths of the public and of the secret one.

    A directory that does not exist is created, readable only by this user.

    Raises:
        ConfigError: the name is not valid, one of the files exists, or they cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"the name of a key has letters, digits and any of _.@-, not {name!r:.120}")
    public, secret = (directory / f"{name}{ending}" for ending in (PUBLIC, SECRET))
    texts = {"name": name, "public": encode(pair.public), "secret": encode(pair.secret)}
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make {directory}: {error.strerror}") from None
    try:
        _write(public, _PUBLIC_FILE.format(**texts), 0o644)
        try:
            _write(secret, _SECRET_FILE.format(**texts), 0o600)
        except OSError:
            public.unlink()
            raise
    except FileExistsError as error:
        raise ConfigError(
            f"{error.filename} exists already, and is not replaced: peers that trust that key would not "
            f"know a new one. Choose another name, or remove {public} and {secret} first"
        ) from None
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename}: {error.strerror}") from None
    return public, secret


def read_public(source: str | Path, setting: str = "hub_key") -> bytes:
    """Return a public key, 32 bytes.

    Args:
        source: the key as text; or the path of a file with this text, or in the format of `zmq.auth`.
        setting: the name of the setting that holds `source`, for error messages.

    Raises:
        ConfigError: `source` is neither a key nor a file with a key, or other users can change or replace the
            file.
    """
    path = Path(source)
    if not _exists(path):
        try:
            return decode(str(source))
        except ValueError:
            raise ConfigError(
                f"{setting}: {str(source)!r:.120} is neither a file nor a key of {_CHARACTERS} characters",
                settings=(setting,),
            ) from None
    text = _read(path)
    try:
        return decode(_keys_in(text).get("public-key") or _plain(text))
    except ValueError:
        raise ConfigError(f"{path} holds no public key: it should be a file that glue-keys wrote") from None


def read_pair(path: Path, setting: str = "key") -> KeyPair:
    """Return the pair in a secret file.

    Args:
        path: the file.
        setting: the name of the setting that holds `path`, for error messages.

    Raises:
        ConfigError: the file cannot be read or has no secret key, or other users can read, change or replace
            it.
    """
    if not _exists(path):
        raise ConfigError(
            f"{setting}: there is no file {path}; make a pair with: glue-keys new NAME", settings=(setting,)
        )
    keys = _keys_in(_read(path, secret=True))
    if "secret-key" not in keys:
        hint = f": give {path.with_suffix(SECRET)}" if path.suffix == PUBLIC else ""
        raise ConfigError(f"{path} holds no secret key{hint}")
    try:
        return KeyPair(decode(keys["public-key"]), decode(keys["secret-key"]))
    except (KeyError, ValueError):
        raise ConfigError(f"{path} is damaged: it should hold a public and a secret key") from None


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # the path is too long, or contains a zero byte
        return False


def _read(path: Path, secret: bool = False) -> str:
    try:
        return read_own(path, _MAX_FILE, secret).decode("utf-8", "replace")
    except FileNotFoundError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None


def _keys_in(text: str) -> dict[str, str]:
    """Return the keys in a certificate, by `public-key` and `secret-key`."""
    found = (_LINE.fullmatch(line) for line in text.splitlines())
    return {match[1]: match[2] for match in found if match}


def _plain(text: str) -> str:
    """Return the only line of a text."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[0] if len(lines) == 1 else ""


def _write(path: Path, text: str, mode: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with open(descriptor, "w", encoding="utf-8") as file:
        file.write(text)

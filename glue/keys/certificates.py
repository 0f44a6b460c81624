"""Key pairs in files, in the format of `zmq.auth`, which programs of any ZeroMQ library read and write.

A pair is two files: NAME.key with the public key, to be handed out, and NAME.key_secret with both, to be
kept. In them, and wherever people see it, a key is 40 characters of Z85.

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

__all__ = ["PUBLIC", "SECRET", "KeyPair", "decode", "encode", "read_pair", "read_public", "write_pair"]

PUBLIC: Final = ".key"
SECRET: Final = ".key_secret"
"""What is appended to the name of a pair for its files."""

_ALPHABET: Final = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"
_VALUES: Final = {character: value for value, character in enumerate(_ALPHABET)}
_CHARACTERS: Final = 40
_WORD: Final = struct.Struct(">I")

_NAME: Final = re.compile(r"[\w@][\w.@-]{0,99}", re.ASCII)
_LINE: Final = re.compile(r"""\s*(public-key|secret-key)\s*=\s*["']?(\S*?)["']?\s*""")

_MAX_FILE: Final = 65_536
"""Bytes; a certificate has less than a thousand."""

_OTHERS: Final = 0o077
_OTHERS_WRITE: Final = 0o002

_PUBLIC_FILE: Final = """\
#   ZeroMQ CURVE Public Certificate of {name}
#   Hand it out in a way in which it cannot be exchanged for another.

metadata
curve
    public-key = "{public}"
"""

_SECRET_FILE: Final = """\
#   ZeroMQ CURVE **Secret** Certificate of {name}
#   Who has this file is taken for you: give it to nobody, and leave it readable by you alone.

metadata
curve
    public-key = "{public}"
    secret-key = "{secret}"
"""


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public key and the secret one that belongs to it, 32 bytes each."""

    public: bytes
    secret: bytes = field(repr=False)


def encode(key: bytes) -> str:
    """Return a key of 32 bytes as text."""
    return "".join(
        _ALPHABET[word // 85**power % 85] for (word,) in _WORD.iter_unpack(key) for power in (4, 3, 2, 1, 0)
    )


def decode(text: str) -> bytes:
    """Return the key that a text stands for.

    Raises:
        ValueError: it is not 40 characters of Z85.
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

    A directory that does not exist is made, for this user alone.

    Raises:
        ConfigError: the name cannot be that of a file, one of the files exists, or they cannot be written.
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
            f"{error.filename} exists already, and is not replaced: whoever trusts that key would not know "
            f"a new one. Choose another name, or remove {public} and {secret} first"
        ) from None
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename}: {error.strerror}") from None
    return public, secret


def read_public(source: str | Path, option: str = "--hub-key") -> bytes:
    """Return a public key.

    Args:
        source: the key as text; or a file that holds it so, or as `zmq.auth` writes it.
        option: where it was given, for the message.

    Raises:
        ConfigError: it is neither a key nor a file with one, or others can write to the file.
    """
    path = Path(source)
    if not _exists(path):
        try:
            return decode(str(source))
        except ValueError:
            raise ConfigError(
                f"{option}: {str(source)!r:.120} is neither a file nor a key of {_CHARACTERS} characters"
            ) from None
    text = _read(path)
    try:
        return decode(_keys_in(text).get("public-key") or _plain(text))
    except ValueError:
        raise ConfigError(f"{path} holds no public key: it should be a file that glue-keys wrote") from None


def read_pair(path: Path, option: str = "--key") -> KeyPair:
    """Return the pair in a secret file.

    Args:
        path: the file.
        option: where it was given, for the message.

    Raises:
        ConfigError: it cannot be read, holds no secret key, or can be read by others.
    """
    if not _exists(path):
        raise ConfigError(f"{option}: there is no file {path}; make a pair with: glue-keys new NAME")
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
    except (OSError, ValueError):  # too long, or a zero in it
        return False


def _read(path: Path, secret: bool = False) -> str:
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if mode & _OTHERS_WRITE and not secret:
                raise ConfigError(
                    f"other users of this machine can exchange the key in {path} for theirs: chmod o-w {path}"
                )
            if secret and mode & _OTHERS:
                raise ConfigError(
                    f"{path} holds a secret key, and other users of this machine can read it: "
                    f"chmod 600 {path} (and make a new pair if somebody may have)"
                )
            data = file.read(_MAX_FILE + 1)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    if len(data) > _MAX_FILE:
        raise ConfigError(f"{path} is too large for a file with a key")
    return data.decode("utf-8", "replace")


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

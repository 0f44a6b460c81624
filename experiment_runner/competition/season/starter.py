"""Write a small repository with which an entrant of a season begins.

`starters/LANGUAGE.txt` holds its files, each after a line `%%% PATH`; `common.txt` those of all languages. In
other languages than Python the agent is the random one of the library's examples, which `make` fetches.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glue import __version__
from glue.errors import ConfigError

_FOLDER: Final = Path(__file__).with_name("starters")
_MARK: Final = "%%% "

LANGUAGES: Final = ("python", "java", "cpp", "js", "rust")


def write_starter(language: str, directory: Path) -> None:
    """Write the repository of a language.

    Args:
        language: one of `LANGUAGES`.
        directory: new, or empty.

    Raises:
        ConfigError: it is not, or it cannot be written.
    """
    try:
        if directory.exists() and any(directory.iterdir()):
            raise ConfigError(f"{directory} is not empty: choose a new folder")
        for name, text in [*_files("common"), *_files(language)]:
            path = directory / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text.replace("@VERSION@", __version__), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename or directory}: {error.strerror}") from None


def _files(name: str) -> Iterator[tuple[str, str]]:
    """Yield the paths and contents of the files in a text."""
    for part in (_FOLDER / f"{name}.txt").read_text(encoding="utf-8").split(_MARK)[1:]:
        path, _, content = part.partition("\n")
        yield path, content

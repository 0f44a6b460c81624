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
_SOURCE: Final = "https://github.com/glue-rl/glue-rl"

_IGNORED: Final = {
    "python": "__pycache__/",
    "java": "/build/",
    "cpp": "/agent",
    "js": "/node_modules/",
    "rust": "/target/",
}
"""What building an agent of each language leaves."""

LANGUAGES: Final = tuple(_IGNORED)

_PYTHON_NOTE: Final = "\nThe agent is agent.py.\n"
_NOTE: Final = """
The first `make` fetches the library and an agent that acts at random: change it. Its process finds the
season's hub through glue-agent, which also encrypts.
"""


def write_starter(language: str, directory: Path) -> None:
    """Write the repository of a language.

    Args:
        language: one of `LANGUAGES`.
        directory: new, or empty.

    Raises:
        ConfigError: it is not, or it cannot be written.
    """
    values = {
        "@VERSION@": __version__,
        "@PIP@": f"glue-rl[compete,keys] @ git+{_SOURCE}@v{__version__}",
        "@IGNORED@": _IGNORED[language],
        "@NOTES@": _PYTHON_NOTE if language == "python" else _NOTE,
    }
    try:
        if directory.exists() and any(directory.iterdir()):
            raise ConfigError(f"{directory} is not empty: choose a new folder")
        for name, text in [*_files("common"), *_files(language)]:
            for mark, value in values.items():
                text = text.replace(mark, value)
            path = directory / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename or directory}: {error.strerror}") from None


def _files(name: str) -> Iterator[tuple[str, str]]:
    """Yield the paths and contents of the files in a text."""
    for part in (_FOLDER / f"{name}.txt").read_text(encoding="utf-8").split(_MARK)[1:]:
        path, _, content = part.partition("\n")
        yield path, content

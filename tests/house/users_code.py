"""The Python programs of README and the pages, as files for mypy: python -m tests.house.users_code FOLDER.

Interpreter sessions are left out, as is docs/gymnasium.md, which needs libraries of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from tests.pages import DOCS, ROOT, blocks

NAMES: Final = [
    "clients",
    "experiments",
    "first-agent",
    "first-experiment",
    "notebooks",
    "trajectories",
    "view",
]

PAGES: Final = (ROOT / "README.md", *(DOCS / f"{name}.md" for name in NAMES))


def programs() -> dict[str, str]:
    """Return the text of each program by file name: as the page gives it, or made from the page's name."""
    found: dict[str, str] = {}
    for page in PAGES:
        for block in blocks(page.read_text(encoding="utf-8"), "python"):
            if not block.body.startswith(">>>"):
                stem = page.stem.lower().replace("-", "_")
                found[block.file or f"{stem}_{len(found)}.py"] = block.body
    return found


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in programs().items():
        (folder / name).write_text(text, encoding="utf-8")

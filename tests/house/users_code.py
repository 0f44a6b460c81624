"""The Python programs of README and the pages, as files for mypy: python -m tests.house.users_code FOLDER.

Interpreter sessions are left out, as is docs/gymnasium.md, which needs libraries of its own.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from textwrap import dedent
from typing import Final

ROOT: Final = Path(__file__).parents[2]

PAGES: Final = (
    "README.md",
    *(f"docs/{name}.md" for name in ("clients", "experiments", "first-agent", "first-experiment")),
    *(f"docs/{name}.md" for name in ("notebooks", "trajectories", "view")),
)

_PROGRAM: Final = re.compile(
    r"(?:<!-- file: (?P<file>\S+\.py) -->\s+)?^```python\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


def programs() -> dict[str, str]:
    """Return the text of each program by file name: as the page gives it, or made from the page's name."""
    found: dict[str, str] = {}
    for page in PAGES:
        for match in _PROGRAM.finditer((ROOT / page).read_text(encoding="utf-8")):
            text = dedent(match["text"])
            if not text.startswith(">>>"):
                stem = Path(page).stem.lower().replace("-", "_")
                found[match["file"] or f"{stem}_{len(found)}.py"] = text
    return found


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in programs().items():
        (folder / name).write_text(text, encoding="utf-8")

"""`python -m benchmarks [--write] [NAME ...]`: measure everything, or the named parts.

Everything is written to docs/performance.md; named parts are printed, and written with `--write`.
"""

from __future__ import annotations

import importlib
import sys

from benchmarks.page import FILE, ORDER, beside_other_work, draw, merged, section

_PARTS = tuple(name for name in ORDER if name != "notes")
_ELSEWHERE = ("gym", "soar")
"""Parts whose numbers are on other pages."""
_BY_NAME = ("clients", "memory", "realtime", "season", "view")
"""Parts that are measured only when named: they take long, or have to be built first."""
_WRITE = "--write"


def main(arguments: list[str]) -> None:
    """Measure the parts named in `arguments`, or everything."""
    names = [argument for argument in arguments if argument != _WRITE]
    known = _PARTS if _WRITE in arguments else (*_PARTS, *_ELSEWHERE)
    if unknown := set(names) - set(known):
        sys.exit(f"no benchmark is called {', '.join(sorted(unknown))}: there are {', '.join(known)}")
    for name in names or [name for name in _PARTS if name not in _BY_NAME]:
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        tables, others = beside_other_work(importlib.import_module(f"benchmarks.{name}").run)
        measured = section(name, tables, others)
        if names:
            print(measured)
        if not names or _WRITE in arguments:
            draw(tables)
            FILE.write_text(merged(FILE.read_text("utf-8"), {name: measured}), encoding="utf-8")
            print(f"written to {FILE}", file=sys.stderr)


if __name__ == "__main__":
    main(sys.argv[1:])

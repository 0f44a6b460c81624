"""Draw the folders of the program and their imports.

`make picture` runs this program, which writes docs/images/architecture.svg.

An arrow leads from a folder to a folder that its modules import. If a longer path leads there too, the arrow
is left out. Every folder is drawn above all folders that it imports.
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

from tests.house.imports import PACKAGES, ROOT, arrows

FILE: Final = ROOT / "docs/images/architecture.svg"

BOX: Final = (150, 34)
GAP: Final = (26, 40)
MARGIN: Final = 24
TITLE: Final = 30
FILL: Final = {
    "glue": "#dbe9f6",
    "env_server": "#e2f2dc",
    "agents": "#fdebd3",
    "experiment_runner": "#eee4f3",
}

ROOTS: Final = {
    "glue": "types, roles, errors",
    "env_server": "toys",
    "agents": "sarsa, policy, ...",
    "experiment_runner": "plan, players, ...",
}
"""The label of the modules at the top of each package."""


class Place(NamedTuple):
    """The upper left corner of a box or a frame, and its size, in pixels."""

    x: float
    y: float
    width: float
    height: float


def package_of(unit: str) -> str:
    return unit.partition("/")[0]


def reduced(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows without those that a longer path makes redundant."""

    @cache
    def reached(name: str) -> frozenset[str]:
        return frozenset(edges[name]).union(*(reached(other) for other in edges[name]))

    return {
        name: {other for other in others if not any(other in reached(way) for way in others - {other})}
        for name, others in edges.items()
    }


def rows(units: list[str], edges: dict[str, set[str]]) -> list[list[str]]:
    """Return the units of a package, row by row from the top: each directly above its imports."""

    @cache
    def height(name: str) -> int:
        return 1 + max((height(other) for other in edges[name] if other in units), default=-1)

    drawn: list[list[str]] = [[] for _ in range(1 + max(map(height, units)))]
    for unit in sorted(units):
        drawn[height(unit)].append(unit)
    drawn.reverse()
    places: dict[str, float] = {}
    for row in drawn:
        above = {unit: [at for other, at in places.items() if unit in edges[other]] for unit in row}
        row.sort(key=lambda unit: sum(above[unit]) / len(above[unit]) if above[unit] else 0.5)
        places |= {unit: (column + 0.5) / len(row) for column, unit in enumerate(row)}
    return drawn


def frame(package: str, drawn: list[list[str]], x: float, y: float, width: float = 0) -> dict[str, Place]:
    """Return the places of a package's boxes, and of its frame under the package's name with a colon."""
    widest = max(map(len, drawn))
    width = width or widest * (BOX[0] + GAP[0])
    places = {}
    for number, row in enumerate(drawn):
        top = y + TITLE + number * (BOX[1] + GAP[1])
        for column, unit in enumerate(row):
            middle = x + width * (column + 0.5) / len(row)
            places[unit] = Place(middle - BOX[0] / 2, top, *BOX)
    height = TITLE + len(drawn) * (BOX[1] + GAP[1]) - GAP[1] + MARGIN
    return {**places, f"{package}:": Place(x, y, width, height)}


def arranged(edges: dict[str, set[str]]) -> dict[str, Place]:
    """Return the places of all boxes and frames: glue at the bottom, the other packages side by side."""
    grids = {name: rows([unit for unit in edges if package_of(unit) == name], edges) for name in PACKAGES}
    heights = {name: frame(name, grid, 0, 0)[f"{name}:"].height for name, grid in grids.items()}
    ground = MARGIN + max(heights[name] for name in PACKAGES[1:])
    places: dict[str, Place] = {}
    x: float = MARGIN
    for name in PACKAGES[1:]:
        places |= frame(name, grids[name], x, ground - heights[name])
        x += places[f"{name}:"].width + 2 * GAP[0]
    return places | frame("glue", grids["glue"], MARGIN, ground + 2 * GAP[1], x - 2 * GAP[0] - MARGIN)


def drawing() -> str:
    """Return the picture as SVG."""
    edges = reduced(arrows())
    places = arranged(edges)
    width = max(place.x + place.width for place in places.values()) + MARGIN
    height = max(place.y + place.height for place in places.values()) + MARGIN
    shapes = [_frame(name[:-1], place) for name, place in places.items() if name.endswith(":")]
    lines = {
        (name, other) if package_of(name) == package_of(other) else _between_packages(name, other)
        for name, others in edges.items()
        for other in others
    }
    shapes += [_arrow(places[name], places[other]) for name, other in sorted(lines)]
    shapes += [_box(name, place) for name, place in places.items() if not name.endswith(":")]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}"'
            ' font-family="sans-serif" font-size="13">',
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8"'
            ' orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="#555"/></marker></defs>',
            f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
            *shapes,
            "</svg>\n",
        ]
    )


def _between_packages(name: str, other: str) -> tuple[str, str]:
    """Return the ends of an arrow: whole packages for imports of glue, single folders for all others."""
    return (f"{package_of(name)}:", "glue:") if package_of(other) == "glue" else (name, other)


def _frame(name: str, at: Place) -> str:
    return (
        f'<rect x="{at.x:g}" y="{at.y:g}" width="{at.width:g}" height="{at.height:g}" rx="10"'
        f' fill="{FILL[name]}"/>\n'
        f'<text x="{at.x + 12:g}" y="{at.y + 20:g}" font-weight="bold">{name}</text>'
    )


def _box(name: str, at: Place) -> str:
    package, _, folder = name.partition("/")
    label = folder.replace("__init__", "__init__.py") or ROOTS[package]
    return (
        f'<rect x="{at.x:g}" y="{at.y:g}" width="{at.width:g}" height="{at.height:g}" rx="5"'
        ' fill="white" stroke="#555"/>\n'
        f'<text x="{at.x + at.width / 2:g}" y="{at.y + at.height / 2 + 4:g}"'
        f' text-anchor="middle">{label}</text>'
    )


def _arrow(start: Place, end: Place) -> str:
    x1, y1 = start.x + start.width / 2, start.y + start.height
    x2 = min(max(x1, end.x), end.x + end.width) if end.width > BOX[0] else end.x + end.width / 2
    return f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{end.y:g}" stroke="#555" marker-end="url(#head)"/>'


if __name__ == "__main__":
    FILE.write_text(drawing(), encoding="utf-8")
    print(f"wrote {FILE.relative_to(ROOT)}")

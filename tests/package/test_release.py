"""A release is made only if version, changelog, citation and tag agree."""

from __future__ import annotations

import pytest

from glue import __version__
from tests.package.release import faults

WHOLE = (f"## {__version__} (2026-12-01)\n", f"version: {__version__}\n", [f"v{__version__}"], "")


def test_a_whole_release_has_no_faults() -> None:
    assert faults(*WHOLE) == []


@pytest.mark.parametrize(
    ("part", "value"),
    [
        (0, f"## {__version__} (unreleased)\n"),
        (0, "## 9.9.9 (2026-12-01)\n"),
        (1, "version: 9.9.9\n"),
        (2, []),
        (2, ["v9.9.9"]),
        (3, " M glue/__init__.py"),
    ],
)
def test_each_fault_is_found(part: int, value: object) -> None:
    changed = [value if index == part else text for index, text in enumerate(WHOLE)]
    assert len(faults(*changed)) == 1  # type: ignore[arg-type]

"""The lines of a recording of the original Infinite Mario: gzip, one JSON object a line."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from glue.trajectory import TrajectoryError

__all__ = ["MAX_LINE", "Line", "lines_of"]

MAX_LINE: Final = 2**20  # bytes of one line


class Line:
    """One JSON object, and where it stands."""

    def __init__(self, fields: dict[str, Any], where: str, size: int) -> None:
        self._fields = fields
        self._where = where
        self.size = size

    def wrong(self, what: str) -> TrajectoryError:
        return TrajectoryError(f"{self._where}: {what}")

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def get(self, name: str, *kinds: type) -> Any:
        """Return a field that has to be there and of one of `kinds`."""
        value = self._fields.get(name)
        if type(value) not in kinds:
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be {wanted}; {value!r:.60} came")
        return value

    def number(self, name: str) -> float:
        return float(self.get(name, float, int))

    def list_of(self, name: str, *kinds: type) -> list[Any]:
        values: list[Any] = self.get(name, list)
        if not all(type(value) in kinds for value in values):
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise self.wrong(f"field {name!r} must be a list of {wanted}")
        return values


def lines_of(path: Path) -> Iterator[Line]:
    """Yield the lines of a file.

    Raises, while iterating:
        TrajectoryError: the file cannot be read, or a line is too long or no JSON object.
    """
    try:
        with gzip.open(path, "rb") as file:
            number = 0
            while line := file.readline(MAX_LINE + 1):
                number += 1
                where = f"{path}, line {number}"
                if len(line) > MAX_LINE:
                    raise TrajectoryError(f"{where} has more than {MAX_LINE} bytes")
                try:
                    fields = json.loads(line)
                except (ValueError, RecursionError) as error:
                    raise TrajectoryError(f"{where} is not JSON: {error}") from None
                if not isinstance(fields, dict):
                    raise TrajectoryError(f"{where} is not a JSON object")
                yield Line(fields, where, len(line))
    except gzip.BadGzipFile:
        raise TrajectoryError(f"{path} is no recording: it is not a gzip file") from None
    except (EOFError, zlib.error) as error:
        raise TrajectoryError(f"{path} is damaged after line {number}: {error}") from None
    except OSError as error:
        raise TrajectoryError(f"cannot read {path}: {error.strerror}") from None

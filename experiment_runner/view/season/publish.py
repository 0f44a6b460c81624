"""The public page of a season as files, for any web server: the same page, which asks for the same names."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from experiment_runner.competition.season.board import PUBLIC
from experiment_runner.store.database import reported
from experiment_runner.store.layout import replace_flushed
from experiment_runner.view.app import static_content, static_files
from experiment_runner.view.season.views import Views
from glue.errors import ExperimentError

_SECONDS: Final = 60.0


class Publisher:
    """Writes the public page into a folder, and later what has changed.

    Args:
        views: of the season.
        folder: made if it does not exist.
    """

    def __init__(self, views: Views, folder: Path) -> None:
        self._views = views
        self._folder = folder
        self._written: dict[str, int] = {}

    def publish(self) -> None:
        """Write every file that differs from what was written last.

        Raises:
            ExperimentError: the season cannot be read, or a file not be written.
        """
        first = not self._written
        if first:
            for name in static_files():
                where = "index.html" if name == "season.html" else f"static/{name}"
                self._write(where, static_content(name))
        for name, content in self._files():
            self._write(name, content)
        if first:
            self._remove_other_names()

    def keep(self, say: Callable[[str], None]) -> None:
        """Publish now, and every minute in a thread that does not keep the program from ending.

        Args:
            say: shows a line when it fails, and when it works again.

        Raises:
            ExperimentError: as by `publish`, now.
        """
        self.publish()

        def work() -> None:
            failed = ""
            while True:
                pause.wait(_SECONDS)
                try:
                    self.publish()
                except ExperimentError as error:
                    if str(error) != failed:
                        failed = str(error)
                        say(f"the page is not published: {failed}")
                else:
                    failed = ""

        pause = threading.Event()
        threading.Thread(target=work, name="publisher", daemon=True).start()

    def _files(self) -> Iterator[tuple[str, bytes]]:
        board = json.loads(self._views.board(PUBLIC))
        # No server is there to play records again.
        yield "season.json", json.dumps(board | {"replays": False}).encode()
        yield "feed.xml", self._views.feed()
        for entrant in board["entrants"]:
            yield f"entrants/{entrant['name']}.json", self._views.entrant(PUBLIC, entrant["name"])

    def _remove_other_names(self) -> None:
        """Remove what was published while the season showed its entrants by the other of their names."""
        for one in self._views.state.entrants.values():
            for shown in (one.name, one.act.alias):
                name = f"entrants/{shown}.json"
                if name not in self._written:
                    with reported(f"cannot remove {self._folder / name}"):
                        (self._folder / name).unlink(missing_ok=True)

    def _write(self, name: str, content: bytes) -> None:
        if self._written.get(name) != hash(content):
            path = self._folder / name
            with reported(f"cannot write {path}"):
                path.parent.mkdir(parents=True, exist_ok=True)
            replace_flushed(path, content)
            self._written[name] = hash(content)

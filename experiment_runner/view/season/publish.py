"""The public page of a season as files, for any web server: the same page, which asks for the same names."""

from __future__ import annotations

import json
import threading
import time
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
        files = dict(self._files())
        for name, content in files.items():
            if self._written.get(name) != hash(content):
                path = self._folder / name
                with reported(f"cannot write {path}"):
                    path.parent.mkdir(parents=True, exist_ok=True)
                replace_flushed(path, content)
                self._written[name] = hash(content)
        for one in self._views.state.entrants.values():
            for shown in (one.name, one.act.alias):
                name = f"entrants/{shown}.json"
                if name not in files:  # the season may have shown its entrants by the other of their names
                    with reported(f"cannot remove {self._folder / name}"):
                        (self._folder / name).unlink(missing_ok=True)
                    self._written.pop(name, None)

    def keep(self, say: Callable[[str], None]) -> None:
        """Publish now, and every minute in a thread that does not keep the program from ending.

        Args:
            say: shows a line when it fails.

        Raises:
            ExperimentError: as by `publish`, now.
        """
        self.publish()

        def work() -> None:
            failed = ""
            while True:
                time.sleep(_SECONDS)
                try:
                    self.publish()
                    failed = ""
                except ExperimentError as error:
                    if str(error) != failed:
                        failed = str(error)
                        say(f"the page is not published: {failed}")

        threading.Thread(target=work, name="publisher", daemon=True).start()

    def _files(self) -> Iterator[tuple[str, bytes]]:
        for name in static_files():
            yield "index.html" if name == "season.html" else f"static/{name}", static_content(name)
        board = json.loads(self._views.board(PUBLIC))
        # No server is there to play records again.
        yield "season.json", json.dumps(board | {"replays": False}).encode()
        yield "feed.xml", self._views.feed()
        for entrant in board["entrants"]:
            yield f"entrants/{entrant['name']}.json", self._views.entrant(PUBLIC, entrant["name"])

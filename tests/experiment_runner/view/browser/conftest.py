"""Fixtures for browser tests: `glue-view` on a module's folder of runs, and a browser that shows it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.experiment_runner.view.browser.chromium import Browser, browsing
from tests.experiment_runner.view.pages import Page, glue_view


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs of a module, which its function `fill` makes."""
    folder = tmp_path_factory.mktemp("runs")
    request.module.fill(folder)
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Iterator[Page]:
    """The server for the runs in the folder."""
    with glue_view(folder) as page:
        yield page


@pytest.fixture(scope="module")
def browser(page: Page) -> Iterator[Browser]:
    with browsing(page) as browser:
        yield browser

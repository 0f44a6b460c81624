"""Headless Chromium that shows a page.

Needs Debian's chromium and chromium-driver, and selenium; the stage `page` of .ci/run installs them.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest

from tests.experiment_runner.view.pages import Page

_SECONDS = 200.0
_TABLES = """
return Object.fromEntries([...document.querySelectorAll("table")].map((table) => [
  table.caption?.textContent ?? "",
  [...table.tBodies[0].rows].map((row) => [...row.cells].map((cell) => cell.textContent))]))
"""
_AXE = Path(os.environ.get("AXE_CORE", "nowhere"))
"""axe.min.js, which the stage `page` of .ci/run installs with npm."""

_FAULTS = """
return axe.run(document, { resultTypes: ["violations"] }).then((found) => found.violations
  .filter((one) => !arguments[0].length || arguments[0].includes(one.impact))
  .map((one) => `${one.id}: ${one.nodes.map((node) => `${node.html} ${node.failureSummary}`).join("; ")}`))
"""
_Found = TypeVar("_Found")


def needed() -> None:
    """Skip the tests of a module on a machine without a browser."""
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("needs chromium and chromium-driver", allow_module_level=True)
    pytest.importorskip("selenium.webdriver", reason="needs selenium")


class Browser:
    """A browser that has opened a page with its token.

    Args:
        driver: selenium's driver.
        page: the server.
    """

    def __init__(self, driver: Any, page: Page) -> None:
        self.driver = driver
        self._page = page
        driver.get(page.url)

    def go(self, view: str) -> None:
        """Load the page afresh at a view, such as `curves?run=ID`."""
        self.driver.get("about:blank")
        self.driver.get(f"http://127.0.0.1:{self._page.port}/#/{view}")

    def run(self, script: str, *arguments: object) -> Any:
        """Return the result of a script, after waiting for a promise."""
        return self.driver.execute_script(script, *arguments)

    def find(self, selector: str) -> Any:
        """Wait for an element, and return it."""
        return self.wait(lambda: self.driver.find_elements("css selector", selector), selector)[0]

    def button(self, label: str) -> Any:
        """Wait for a button, and return it."""
        return self.wait(lambda: self.driver.find_elements("xpath", f"//button[.='{label}']"), label)[0]

    def wait(self, true: Callable[[], _Found], what: str) -> _Found:
        """Call `true()` until its result is true; return that result."""
        deadline = time.monotonic() + _SECONDS
        while not (found := true()):
            assert time.monotonic() < deadline, f"waited in vain for {what}; there is:\n{self.text()}"
            time.sleep(0.05)
        return found

    def text(self) -> str:
        """Return all text that is shown."""
        return str(self.run("return document.body.innerText"))

    def shows(self, text: str) -> None:
        """Wait until the page shows a text."""
        self.wait(lambda: text in self.text(), text)

    def has_table(self, caption: str) -> list[list[str]]:
        """Wait for a table, and return the cells of its body, row by row."""
        return self.wait(lambda: self.tables().get(caption), caption) or []

    def tables(self) -> dict[str, list[list[str]]]:
        """Return the cells of all tables, by caption."""
        found: dict[str, list[list[str]]] = self.run(_TABLES)
        return found

    def press(self, *keys: str) -> None:
        """Press keys one after the other, at the current focus."""
        from selenium.webdriver import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()

    def set_size(self, width: int, height: int, scale: float = 1) -> None:
        """Set the size of the page in CSS pixels, and the number of screen pixels per CSS pixel."""
        self._devtools(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=width < 600,
        )

    def set_dark(self, is_dark: bool) -> None:
        """Emulate a system with a dark or a light theme."""
        feature = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self._devtools("Emulation.setEmulatedMedia", features=[feature])

    def save_into(self, folder: Path) -> None:
        """Save downloads into a folder."""
        self._devtools("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))

    def screenshot(self) -> bytes:
        """Return a screenshot as PNG."""
        return bytes(self.driver.get_screenshot_as_png())

    def faults(self, *impacts: str) -> list[str]:
        """Return what axe-core finds wrong with the page, of some impacts or of all; skip what is left of a
        test where axe-core is missing.
        """
        if not _AXE.is_file():
            pytest.skip("needs axe-core: AXE_CORE=.../axe.min.js")
        self.run(_AXE.read_text("utf-8"))
        return list(self.run(_FAULTS, impacts))

    def errors(self) -> list[str]:
        """Return the errors in the browser's console since the last call."""
        return [line["message"] for line in self.driver.get_log("browser") if line["level"] == "SEVERE"]

    def foreign(self) -> list[str]:
        """Return the URLs of other hosts in the browser's own log of requests since the last call."""
        found = [json.loads(line["message"])["message"] for line in self.driver.get_log("performance")]
        sent = [one["params"] for one in found if one["method"] == "Network.requestWillBeSent"]
        urls = [str(one["request"]["url"]) for one in sent]
        return [url for url in urls if urlsplit(url).hostname not in (None, "127.0.0.1")]

    def _devtools(self, command: str, **arguments: object) -> None:
        self.driver.execute_cdp_cmd(command, arguments)


@contextlib.contextmanager
def browsing(page: Page) -> Iterator[Browser]:
    """Open a page in a browser of its own; check at the end that nothing was an error or asked elsewhere."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        browser = Browser(driver, page)
        yield browser
        assert browser.errors() == []
        assert browser.foreign() == []
    finally:
        driver.quit()

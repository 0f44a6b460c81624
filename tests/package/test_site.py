"""The documentation site: its reference, search from disk, and axe-core at each width and in each theme."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

SITE: Final = Path(os.environ.get("GLUE_SITE", "nowhere")).resolve()
AXE: Final = Path(os.environ.get("AXE_CORE", "nowhere"))

PAGES: Final = sorted(
    path.relative_to(SITE).as_posix() for path in SITE.rglob("*.html") if "_" not in path.name[:1]
)
SIZES: Final = {"phone": (390, 844), "desktop": (1400, 900)}

FAULTS: Final = """
return axe.run(document, { resultTypes: ["violations"] }).then((found) => found.violations
  .map((one) => `${one.id}: ${one.nodes.map((node) => `${node.html} ${node.failureSummary}`).join("; ")}`))
"""


def test_every_command_and_every_public_name_is_there() -> None:
    import glue
    from tests.package.environments import COMMANDS

    commands = (SITE / "commands.html").read_text(encoding="utf-8")
    assert [command for command in COMMANDS if f"Usage: {command} " not in commands] == []
    names = (SITE / "reference/api.html").read_text(encoding="utf-8")
    public = {name for name in glue.__all__ if not name.startswith("_")} - {"spaces", "taskspec"}
    assert {name for name in public if not re.search(rf'id="glue\.[\w.]*\b{name}"', names)} == set()


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver")
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("needs chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "allow-file-access-from-files"):
        options.add_argument(f"--{argument}")
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    yield driver
    driver.quit()


@pytest.mark.parametrize(("size", "theme"), [("phone", "light"), ("desktop", "dark")])
@pytest.mark.parametrize("page", PAGES)
def test_axe_finds_nothing(driver: Any, page: str, size: str, theme: str) -> None:
    if not AXE.is_file():
        pytest.skip("needs axe-core: AXE_CORE=.../axe.min.js")
    width, height = SIZES[size]
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    features = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", features)
    driver.get(f"file://{SITE}/{page}")
    assert driver.execute_script("return document.documentElement.scrollWidth") <= width
    driver.execute_script(AXE.read_text(encoding="utf-8"))
    assert driver.execute_script(FAULTS) == []


def test_search_works_from_disk(driver: Any) -> None:
    driver.get(f"file://{SITE}/search.html?q=heartbeat")
    wait = pytest.importorskip("selenium.webdriver.support.wait").WebDriverWait(driver, 60)
    wait.until(lambda browser: browser.find_elements("css selector", "#search-results li a"))

"""The board as one HTML file in a real browser, with many entrants that have long names."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment_runner.competition.board.standings import Standing, Standings, TaskScore
from experiment_runner.view.export import as_page
from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.pages import glue_view

needed()

_ENTRANTS = 12
_LOOK = "const style = getComputedStyle(one); return `${style.stroke} ${style.strokeDasharray}`"


def placed(place: int) -> Standing:
    total = -1234.5 * place
    task = TaskScore(total, (-1234.5,), float(place), tuple(range(0, -9 * place, -place)))
    name = f"{place}{'x' * 62}"
    return Standing(name, place, float(place), place, total, -2000.0, -1000.0, {"walk": task})


def board(missing: int) -> Standings:
    entrants = map(placed, range(1, _ENTRANTS + 1))
    others = [Standing(f"late{number}", missing="not verified yet") for number in range(missing)]
    return Standings("spring", ("walk",), (*entrants, *others), "glue-rl 0.3.0")


@pytest.mark.parametrize("missing", [0, 2])
def test_it_stands_alone_fits_the_window_and_tells_its_lines_apart(tmp_path: Path, missing: int) -> None:
    (tmp_path / "board.html").write_text(as_page(board(missing)))
    with glue_view(tmp_path) as page, browsing(page) as browser:
        for width in (1000, 390):
            browser.set_size(width, 800)
            browser.driver.get((tmp_path / "board.html").as_uri())
            assert browser.run("return document.documentElement.scrollWidth") <= width
        looks = _looks(browser, "figure > svg .curve")
        assert len(set(looks)) == _ENTRANTS
        assert _looks(browser, ".legend .curve") == looks
        assert ("Every score was verified by replay." in browser.text()) == (missing == 0)


def _looks(browser: Browser, selector: str) -> list[str]:
    script = f"return [...document.querySelectorAll(arguments[0])].map((one) => {{ {_LOOK} }})"
    return list(browser.run(script, selector))

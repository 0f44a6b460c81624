"""docs/performance.md is as the benchmarks write it: benchmarks/page.py."""

from __future__ import annotations

from benchmarks.measure import Table
from benchmarks.page import FILE, NOTES, ORDER, head, merged, section, sections_of

TABLE = Table("A title", "What it is.", ("what", "how much"), [("one", "1"), ("other", "2")])


def test_the_page_has_the_sections_in_the_form_and_order_in_which_they_are_written() -> None:
    before, sections = sections_of(FILE.read_text("utf-8"))
    rest = FILE.read_text("utf-8").removeprefix(before)

    assert merged(head() + rest, {}) == head() + rest
    assert list(sections) == list(ORDER)
    assert before.startswith(head().partition("Machine:")[0])
    for name, text in sections.items():
        assert f"`python -m benchmarks {name}`" in text or name == "notes"


def test_a_part_takes_its_place_and_leaves_all_others() -> None:
    page = merged(head(), {"view": "old\n", "hub": "kept\n"})

    page = merged(page, {"view": section("view", [TABLE], 0.021)})

    assert page.startswith(head() + "<!-- hub -->\nkept\n<!-- notes -->\n" + NOTES.read_text("utf-8"))
    assert page.endswith(
        "<!-- view -->\n## A title\n\n"
        "What it is. Measured by `python -m benchmarks view`; other work had 2 % of the processors.\n\n"
        "| what | how much |\n| --- | ---: |\n| one | 1 |\n| other | 2 |\n\n"
    )


def test_what_was_measured_on_another_machine_does_not_stay_beside_it() -> None:
    page = merged("# Performance\n\nMachine: another.\n\n<!-- hub -->\nold\n", {"view": "new\n"})

    assert set(sections_of(page)[1]) == {"notes", "view"}

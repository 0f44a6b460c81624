"""The stream of events: its contents, a page that reconnects, and the end."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import Plan, RoleSweep, TrialSpec
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.store import Store
from experiment_runner.view.catalog import Catalog, Watcher
from experiment_runner.view.stream import Pulse, Topic
from tests.experiment_runner.view.pages import Inside, Page, glue_view


def make_run(directory: Path, episodes: int = 10) -> Store:
    return Store.create(directory, [TrialSpec(TrialId("remote/remote/0"), None, None, episodes, 0, 1)], {})


def play(store: Store, episode: int) -> None:
    store.record("remote/remote/0", EpisodeResult(episode, 1.5 * episode, 3, True, 0.1))


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    with glue_view(tmp_path) as page:
        yield page


def run_of(event: dict[str, dict[str, object]]) -> dict[str, object]:
    (run,) = event["runs"].values()
    assert isinstance(run, dict)
    return run


def test_a_page_sees_a_run_begin_go_on_end_and_vanish(page: Page, tmp_path: Path) -> None:
    stream = page.stream("topic=runs")
    assert stream.response.getheader("content-type", "").startswith("text/event-stream")
    assert stream.response.getheader("server") is None
    assert stream.next() == {"runs": {}}
    store = make_run(tmp_path / "a")
    begun = run_of(stream.next())
    assert (begun["state"], begun["episodes"], begun["planned_episodes"]) == ("running", 0, 10)
    play(store, 1)
    assert run_of(stream.next())["episodes"] == 1
    store.close()
    assert run_of(stream.next())["state"] == "interrupted"
    for path in (tmp_path / "a").iterdir():
        path.unlink()
    assert stream.next() == {"runs": {begun["id"]: None}}


def test_a_page_that_comes_back_is_sent_what_it_has_missed_alone(page: Page, tmp_path: Path) -> None:
    stores = [make_run(tmp_path / name) for name in ("a", "b")]
    stream = page.stream("topic=runs")
    assert len(stream.next()["runs"]) == 2
    last = stream.id
    stream.close()
    play(stores[0], 1)
    back = page.stream("topic=runs", {"Last-Event-ID": last})
    missed = back.next()["runs"]
    if not missed:  # the watcher sleeps while nobody listens, and polls once somebody does
        missed = back.next()["runs"]
    assert [run["episodes"] for run in missed.values()] == [1]
    for other in ("", "of-another", f"{last}0" * 9, "-1"):
        assert len(page.stream(f"topic=runs&since={other}").next()["runs"]) == 2
    for store in stores:
        store.close()


def test_a_slow_page_is_sent_the_newest_value_alone() -> None:
    topic = Topic(pulse := Pulse())
    for moment in range(5):
        topic.put("moment", moment)
        topic.put("trial", "a")  # no change
    assert topic.since(0) == {"moment": 4, "trial": "a"}
    assert topic.since(2) == {"moment": 4}
    assert topic.since(pulse.change) == {}


def test_a_change_that_is_found_while_the_last_page_goes_away_is_not_lost(tmp_path: Path) -> None:
    looking, go_on = threading.Semaphore(0), threading.Semaphore(0)

    class Slow(Catalog):
        def changes(self) -> dict[str, dict[str, Any] | None]:
            found = super().changes()
            looking.release()
            assert go_on.acquire(timeout=60)
            return found

    store = make_run(tmp_path / "a")  # stays open, so that reading it changes no file
    play(store, 1)

    async def come_and_go() -> list[int]:
        go_on.release()
        watcher = Watcher(Slow([tmp_path]), Pulse())
        async with watcher.open("") as topic:
            assert [run["episodes"] for run in topic.values().values()] == [1]
            await asyncio.to_thread(looking.acquire)  # the first poll
            await asyncio.to_thread(looking.acquire)  # a poll that finds nothing new
            play(store, 2)
            go_on.release()
            await asyncio.to_thread(looking.acquire)
        go_on.release(2)
        async with watcher.open("") as topic:
            return [run["episodes"] for run in topic.values().values()]

    assert asyncio.run(come_and_go()) == [2]
    store.close()


def test_a_damaged_store_is_shown_as_such_and_harms_no_other(tmp_path: Path) -> None:
    make_run(tmp_path / "good").close()
    bad = tmp_path / "<script>alert(1)<" / "run"
    bad.mkdir(parents=True)
    (bad / "results.sqlite").write_bytes(b"SQLite format 3\0" + b"\xff" * 5000)
    runs = {run["state"]: run for run in Catalog([tmp_path]).changes().values() if run}
    assert runs.keys() == {"interrupted", "damaged"}
    assert str(runs["damaged"]["name"]).endswith("/<script>alert(1)</run")
    assert "results.sqlite" in runs["damaged"]["reason"] or "cannot read" in runs["damaged"]["reason"]
    assert Inside(tmp_path).ask(f"/api/run/{runs['damaged']['id']}").status == 422


def test_ctrl_c_ends_the_server_at_once_with_pages_open(page: Page) -> None:
    streams = [page.stream("topic=runs") for _ in range(5)]
    assert all(stream.next() == {"runs": {}} for stream in streams)
    assert page.stop() == 130  # if the streams did not end, it never would
    assert [stream.next() for stream in streams] == [None] * 5


def test_a_run_is_summed_up_by_the_returns_of_its_settings_and_their_options(tmp_path: Path) -> None:
    agents = (RoleSweep("sarsa", {"step_size": (0.5, 0.05)}),)
    specs = Plan(episodes=300, trials=2, environments=(RoleSweep("mines"),), agents=agents).expand()
    with Store.create(tmp_path / "sweep", specs, {}) as store:
        for number, spec in enumerate(specs):
            for episode in range(1, 201):  # the last 100 count
                total = number if episode > 100 else -99.0
                store.record(spec.id, EpisodeResult(episode, total, 3, True, 0.1))
    (found,) = Catalog([tmp_path]).changes().values()
    assert found is not None
    assert found["returns"] == [0.5, 2.5]
    assert found["options"] == {"step_size": ["0.5", "0.05"]}
    assert "seeds" not in found

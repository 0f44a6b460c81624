"""The seal: what was changed is named, a kill leaves it valid, and its cost does not grow."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from experiment_runner.competition.course import course_of
from experiment_runner.competition.records import journal, seal
from experiment_runner.competition.records.journal import ANNOUNCE, EVERYBODY, act
from experiment_runner.competition.records.verify import verify
from experiment_runner.competition.season.bundle import bundle
from experiment_runner.competition.settings import parse_competition
from experiment_runner.competition.trials import trials
from experiment_runner.store.layout import SEAL_FILE
from experiment_runner.store.records import EpisodeResult, ReplayVerdict, TrialEnd
from experiment_runner.store.store import Store
from glue.errors import ExperimentError

FILE = """\
seed_env = "S"
[tasks.walk]
env = "skeleton"
episodes = 1
[entrants.ann]
command = ["true"]
"""
FILES = {"competition.toml": FILE, "run.json": '{"program": "glue"}\n'}
TRIAL = "ann/walk/0"
LINE = (
    b'{"time": "2026-11-27T06:00:00Z", "act": "enter", "subject": "ann", "reason": "in the file", '
    b'"player": "true", "id": "", "trial": ""}\n'
)

# Of the same run, as an earlier version sealed it.
EARLIER = {
    "played": [
        "300518d38ddf2a6eace98eebde7c3e4cadbb284e82564bb16f35f68f57d42916",
        "f0d8a8834349c7b8ece3873071d39c421b00caf5912f46f564bf07016a050920",
    ],
    "verified": {TRIAL: ["ecdb3854c9bad3911245982afe15e1d64c0d7d529f4fb30e20cd1c19d18511f0"]},
}


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """A run with everything that a seal covers, of an earlier version in all but its seal."""
    specs = trials(parse_competition(FILE, tmp_path / "spring.toml"), b"nobody knows")
    with Store.create(tmp_path / "run", specs, FILES) as made:
        seal.seal(made)
        journal.append(made.directory, LINE)
        (made.directory / SEAL_FILE).unlink()
        seal.seal(made)
        made.record(TRIAL, EpisodeResult(1, 2.0, 3, True, 0.5))
        seal.record_outcome(made, TRIAL, TrialEnd(None, b"digest"))
        seal.record_verdict(made, TRIAL, ReplayVerdict(b"digest", None, 2.0))
        yield made


def update(store: Store, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(store.directory / "results.sqlite")) as database, database:
        assert database.execute(statement, values).rowcount == 1


EDITS: dict[str, tuple[str, Callable[[Store], None]]] = {
    "verdicts": ("verdicts", lambda store: update(store, "UPDATE verdicts SET score = 9")),
    "episodes": ("verdicts", lambda store: update(store, "UPDATE episodes SET steps = 9")),
    "outcomes": ("outcomes", lambda store: update(store, "UPDATE outcomes SET reason = 'it left'")),
    "trials": ("trials", lambda store: update(store, "UPDATE trials SET seed = 9")),
    "a trial less": ("trials", lambda store: update(store, "DELETE FROM trials")),
    "journal": ("lines", lambda store: journal.append(store.directory, b"{}\n")),
    "file": ("competition.toml", lambda store: _append(store.directory / "competition.toml")),
    "about": ("run.json", lambda store: _append(store.directory / "run.json")),
}


def _append(path: Path) -> None:
    path.write_text(path.read_text() + "\n")


@pytest.mark.parametrize("earlier", [False, True], ids=["now", "earlier"])
@pytest.mark.parametrize("edit", EDITS)
def test_what_was_changed_is_named(edit: str, earlier: bool, store: Store) -> None:
    if earlier:
        (store.directory / SEAL_FILE).write_text(json.dumps(EARLIER))
    assert seal.broken(store) == ""
    what, change = EDITS[edit]
    change(store)
    assert what in seal.broken(store)
    with pytest.raises(ExperimentError, match="were changed since"):
        seal.check_seal(store)


def test_an_earlier_seal_is_replaced_with_the_first_thing_that_is_recorded(store: Store) -> None:
    (store.directory / SEAL_FILE).write_text(json.dumps(EARLIER))
    assert seal.seal(store)
    assert json.loads((store.directory / SEAL_FILE).read_text()) == EARLIER
    seal.record_acts(store, [act(ANNOUNCE, EVERYBODY, "hello")])
    assert "now" in json.loads((store.directory / SEAL_FILE).read_text())
    seal.check_seal(store)
    assert [one.act for one in journal.acts_of(store.directory)] == ["enter", ANNOUNCE]


@pytest.mark.parametrize("earlier", [False, True], ids=["now", "earlier"])
def test_verify_makes_changed_verdicts_right_and_seals_them(earlier: bool, store: Store) -> None:
    if earlier:
        (store.directory / SEAL_FILE).write_text(json.dumps(EARLIER))
    EDITS["episodes"][1](store)
    assert verify(store, {"walk": 0}, lambda line: None) == 1  # there is no record
    seal.check_seal(store)
    EDITS["outcomes"][1](store)
    verify(store, {"walk": 0}, lambda line: None)
    assert seal.broken(store) == "outcomes of trials"


@pytest.mark.parametrize("earlier", [False, True], ids=["now", "earlier"])
def test_a_signature_is_of_the_newest_digests_alone(earlier: bool, store: Store) -> None:
    """Anybody can write others beside them, as of a change that a killed process has not made."""
    pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")
    from glue.client.libzmq import new_pair

    pair, path = new_pair(), store.directory / SEAL_FILE
    if earlier:
        path.write_text(json.dumps(EARLIER))
    seal.sign(store.directory, pair)
    seal.check_signature(store.directory, pair.public)
    signed = json.loads(path.read_text())
    EDITS["outcomes"][1](store)
    EDITS["verdicts"][1](store)
    if earlier:
        (verdict,) = store.verdicts().items()
        signed["played"].insert(0, seal._earlier_played(store))
        signed["verified"][TRIAL].insert(0, seal._digest(*seal._verified(store, *verdict)[1:]))
    else:
        path.unlink()
        seal.seal(store)
        signed["before"] = json.loads(path.read_text())["now"]
    path.write_text(json.dumps(signed))
    seal.check_seal(store)
    with pytest.raises(ExperimentError, match="or was changed since"):
        seal.check_signature(store.directory, pair.public)


OTHER = "has another environment or length than its task"


@pytest.mark.parametrize(
    ("column", "value", "why"),
    [
        ("id", "../../ann/walk/0", "is not the id of"),
        ("id", "/ann/walk/0", "is not the id of"),
        ("id", "../walk/0", "is not the id of"),
        ("id", "ann/other/0", "is of a task that"),
        ("id", "ann", "is not the id of"),
        ("episodes", 10**12, OTHER),
        ("max_steps", 7, OTHER),
        ("steps", 10**12, OTHER),
        ("environment", '{"name":"mines","options":{},"label":"walk"}', OTHER),
        ("environment", None, OTHER),
    ],
)
def test_a_trial_that_the_competition_does_not_have_leads_nowhere(
    column: str, value: object, why: str, store: Store
) -> None:
    """Verification would play it, however long."""

    def check() -> None:
        course_of(store.directory).check_trials(record.spec for record in store.trials())
        verify(store, {"walk": 0}, lambda line: None)

    check()
    update(store, f"UPDATE trials SET {column} = ?", value)
    with pytest.raises(ExperimentError, match=why):
        check()


def test_a_bundle_holds_no_file_that_a_run_only_names(store: Store) -> None:
    directory = store.directory
    (directory.parent / "0.traj").write_bytes(b"not of this run")
    update(store, "UPDATE trials SET id = '../../0'")
    (directory / SEAL_FILE).unlink()
    seal.seal(store)
    store.close()
    with pytest.raises(ExperimentError, match="is not the id of"):
        bundle(directory, directory.parent / "bundle")
    assert not (directory.parent / "bundle").exists()


class Killed(Exception):
    pass


_SPECS = trials(parse_competition(FILE.replace("ann", "bob"), Path("spring.toml")), b"nobody knows")
RECORDED: dict[str, Callable[[Store], None]] = {
    "append": lambda store: seal.record_acts(store, [act(ANNOUNCE, EVERYBODY, "hello")]),
    "extend": lambda store: seal.add_trials(store, _SPECS),
    "record_outcome": lambda store: seal.record_outcome(store, "bob/walk/0", TrialEnd("it left", b"")),
    "record_verdict": lambda store: seal.record_verdict(store, TRIAL, ReplayVerdict(b"", "it differs", 0.0)),
}


@pytest.mark.parametrize("what", RECORDED)
def test_a_process_killed_after_it_sealed_leaves_a_valid_seal(
    what: str, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise Killed

    if what == "record_outcome":
        seal.add_trials(store, _SPECS)
    with monkeypatch.context() as patched:
        patched.setattr(journal if what == "append" else Store, what, killed)
        with pytest.raises(Killed):
            RECORDED[what](store)
    seal.check_seal(store)
    assert seal.seal(store)
    RECORDED[what](store)
    seal.check_seal(store)


def test_a_seal_is_renewed_without_a_look_at_what_is_there(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And stays as small as it was."""

    def look(*_: object) -> None:
        raise AssertionError("all of it is read")

    seal.add_trials(store, _SPECS)
    small = (store.directory / SEAL_FILE).stat().st_size
    with monkeypatch.context() as patched:
        for name in ("trials", "outcomes", "verdicts"):
            patched.setattr(Store, name, look)
        patched.setattr(journal, "content", look)
        for number in range(50):
            seal.record_acts(store, [act(ANNOUNCE, EVERYBODY, f"hello {number}")])
        seal.record_outcome(store, "bob/walk/0", TrialEnd("it left", b"digest"))
        seal.record_verdict(store, "bob/walk/0", ReplayVerdict(b"digest", None, 0.0))
    assert abs((store.directory / SEAL_FILE).stat().st_size - small) < 20
    seal.check_seal(store)


def test_an_incomplete_line_of_the_journal_is_replaced(tmp_path: Path) -> None:
    for size in (10, 70_000, 200_000):
        path = tmp_path / "journal.jsonl"
        path.write_bytes(b'{"whole": 1}\n' + size * b"x")
        journal.append(tmp_path, b'{"next": 1}\n')
        assert path.read_bytes() == b'{"whole": 1}\n{"next": 1}\n'
    path.write_bytes(100 * b"x")
    journal.append(tmp_path, b"{}\n")
    assert path.read_bytes() == b"{}\n"

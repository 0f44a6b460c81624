"""The seal of a competition: digests of everything that its board shows, in the run's file `seal.json`.

`played` covers the competition's file, the journal, the trials and their outcomes, and is renewed with each
act of the organiser and each outcome; `verified` covers each verdict and the episodes behind it. An edit of
the directory breaks the seal. Anyone who may write to the directory can also make a new seal; only a
signature shows who made it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final

import msgspec

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import Act
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.database import KEPT, reported
from experiment_runner.store.layout import (
    ABOUT_FILE,
    COMPETITION_FILE,
    JOURNAL_FILE,
    SEAL_FILE,
    replace_flushed,
)
from experiment_runner.store.records import ReplayVerdict, TrialEnd
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from glue.files import MOST_TEXT, read_regular
from glue.keys.certificates import KeyPair, encode

_MOST_BYTES: Final = 2**24
_TRIES: Final = 3

_Digests = Annotated[list[str], msgspec.Meta(min_length=1)]
"""The digest of something, after the one before its last change, if that is known."""


class _Seal(msgspec.Struct, omit_defaults=True):
    """A seal, its public key and the signature by it, if it was signed."""

    played: _Digests
    verified: dict[str, _Digests]
    key: str = ""
    signature: str = ""


def seal(store: Store) -> bool:
    """Seal a competition as it is, if it has no seal yet; return whether it had one."""
    sealed = (store.directory / SEAL_FILE).exists()
    if not sealed:
        verified = {name: [_verified(store, name, verdict)] for name, verdict in store.verdicts().items()}
        _write(store.directory, _Seal([_played(store)], verified))
    return sealed


# The new digest is written before what it is of, and the old one is kept with it: a process that is killed
# between the two leaves a valid seal.


def record_acts(store: Store, acts: Sequence[Act]) -> None:
    """Renew the seal, and append acts to the journal."""
    added = journal.content(store.directory) + journal.text_of(acts).encode()
    _renew(store, _played(store, acts=added))
    journal.append(store.directory, acts)


def add_trials(store: Store, specs: Sequence[TrialSpec]) -> None:
    """Renew the seal, and store further trials, for which acts of the journal call."""
    _renew(store, _played(store, specs=specs))
    store.extend(specs)


def record_outcome(store: Store, trial_id: str, outcome: TrialEnd) -> None:
    """Renew the seal, and store how a trial ended."""
    _renew(store, _played(store, outcomes={trial_id: outcome}))
    store.record_outcome(trial_id, outcome)


def record_verdict(store: Store, trial_id: str, verdict: ReplayVerdict) -> None:
    """Renew the seal, and store the result of replaying a trial."""
    found = _read(store.directory)
    digests = [_verified(store, trial_id, one) for one in (store.verdicts().get(trial_id), verdict) if one]
    if found.verified.get(trial_id, [])[-1:] != digests[-1:]:
        found.verified[trial_id] = digests
        _write(store.directory, found)
    store.record_verdict(trial_id, verdict)


def _renew(store: Store, digest: str) -> None:
    found = _read(store.directory)
    found.played = [_played(store), digest]
    _write(store.directory, found)


def broken(results: Results) -> str:
    """Return the name of the part that was changed since it was sealed; empty without a change or a seal.

    Raises:
        ExperimentError: the seal cannot be read.
    """
    directory = results.directory
    if not (directory / SEAL_FILE).exists():  # of version 0.1.0
        return ""
    verdicts = results.verdicts()
    # While a competition is held, an outcome may be stored between reading the seal and the database.
    for found in (_read(directory) for _ in range(_TRIES)):
        if _played(results) in found.played:
            break
    else:
        return f"{COMPETITION_FILE}, {ABOUT_FILE}, {JOURNAL_FILE}, the trials or their outcomes"
    for name, verdict in verdicts.items():
        if _verified(results, name, verdict) not in found.verified.get(name, ()):
            return f"the verdict or the episodes of {name}"
    return ""


def check_seal(results: Results) -> None:
    """Check that nothing was changed since it was sealed.

    Raises:
        ExperimentError: something was, or the seal cannot be read.
    """
    if changed := broken(results):
        raise ExperimentError(
            f"{changed} were changed since they were written: put them back in {results.directory}, or try "
            f"glue-compete verify {results.directory}"
        )


def sign(directory: Path, pair: KeyPair) -> None:
    """Sign the seal of a competition.

    Raises:
        ConfigError: PyNaCl is not installed.
    """
    from glue.keys import signing

    found = _read(directory)
    found.key, found.signature = encode(pair.public), signing.sign(pair.secret, _message(found)).hex()
    _write(directory, found)


def check_signature(directory: Path, public: bytes) -> None:
    """Check that a competition was signed with the pair of a public key, and has not changed since.

    Raises:
        ConfigError: PyNaCl is not installed.
        ExperimentError: it was not, or the seal cannot be read or has no signature.
    """
    from glue.keys.signing import is_signed

    found = _read(directory)
    try:
        signature = bytes.fromhex(found.signature)
    except ValueError:
        signature = b""
    if not signature:
        raise ExperimentError(f"{directory} is not signed: glue-compete verify can sign it")
    if not is_signed(public, _message(found), signature):
        raise ExperimentError(f"{directory} was not signed with {encode(public)}, or was changed since")


def _message(found: _Seal) -> bytes:
    last = {name: digests[-1] for name, digests in found.verified.items()}
    return b"glue-compete seal 1\n" + _digest(found.played[-1], last).encode()


def _played(
    results: Results,
    *,
    outcomes: Mapping[str, TrialEnd] = MappingProxyType({}),
    specs: Sequence[TrialSpec] = (),
    acts: bytes | None = None,
) -> str:
    """Return the digest of what was played, with more outcomes, more trials, or another journal."""
    directory = results.directory
    with reported(f"cannot read {directory}"):
        files = [read_regular(directory / name, MOST_TEXT) for name in (COMPETITION_FILE, ABOUT_FILE)]
    if acts := journal.content(directory) if acts is None else acts:  # version 0.3 had no journal
        files.append(acts)
    ended = {**results.outcomes(), **outcomes}
    return _digest(
        [hashlib.sha256(file).hexdigest() for file in files],
        [asdict(spec) for spec in (*(record.spec for record in results.trials()), *specs)],
        {name: [outcome.reason, outcome.digest.hex()] for name, outcome in ended.items()},
    )


def _verified(results: Results, name: str, verdict: ReplayVerdict) -> str:
    episodes = results.episodes(name)
    return _digest(
        [verdict.digest.hex(), verdict.problem, repr(verdict.score)],
        [[row.episode, repr(row.episode_return), row.steps, row.terminal] for row in episodes],
    )


def _digest(*parts: object) -> str:
    whole = hashlib.sha256()
    for chunk in json.JSONEncoder(sort_keys=True).iterencode(parts):
        whole.update(chunk.encode())
    return whole.hexdigest()


def _read(directory: Path) -> _Seal:
    path = directory / SEAL_FILE
    try:
        return msgspec.json.decode(read_regular(path, _MOST_BYTES), type=_Seal)
    except (OSError, ValueError, RecursionError):
        raise ExperimentError(f"{path} is not a seal: put the file back that glue-compete wrote") from None


def _write(directory: Path, made: _Seal) -> None:
    text = json.dumps(msgspec.to_builtins(made), indent=2) + "\n"
    replace_flushed(directory / SEAL_FILE, text, KEPT)

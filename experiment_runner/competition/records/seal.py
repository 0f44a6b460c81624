"""The seal of a competition: digests of everything that its board shows, in the run's file `seal.json`.

It covers the competition's file, the journal, the trials, their outcomes, and each verdict with the episodes
behind it. An edit of the directory breaks the seal. Anyone who may write to the directory can also make a new
seal; only a signature shows who made it.

However much there is, the seal is renewed at the same cost. The digest of the journal is a chain over its
lines. That of a set is the sum of its elements' digests modulo 2**4096: AdHASH of Bellare and Micciancio
(1997), "A New Paradigm for Collision-Free Hashing: Incrementality at Reduced Cost". Against that many bits,
the generalised birthday attack of Wagner (2002) takes about 2**128 steps.

An earlier seal had one digest of everything that was played, and one of each verdict. It remains valid, and
is replaced when something is recorded.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec.structs import replace

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import Act
from experiment_runner.plan.limits import TrialId
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
_SUM_BYTES: Final = 512

_SPEC: Final = ("id", "agent", "environment", "episodes", "max_steps", "seed", "steps")
_UNSET: Final = TrialSpec(TrialId(""), None, None, 0, 0, 0)

_Sum = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]+$", max_length=2 * _SUM_BYTES)]
"""The digest of a set, in hexadecimal."""

_WHAT: Final = {
    "files": f"{COMPETITION_FILE} or {ABOUT_FILE}",
    "acts": f"lines of {JOURNAL_FILE}",
    "trials": "trials",
    "outcomes": "outcomes of trials",
    "verdicts": "verdicts or episodes of trials",
}


class _Digests(msgspec.Struct, frozen=True):
    """The digests of what a seal covers, see `_WHAT`."""

    files: str
    acts: str
    trials: _Sum
    outcomes: _Sum
    verdicts: _Sum


class _Seal(msgspec.Struct, omit_defaults=True):
    """Digests, and those before their last change; the public key and the signature, if they were signed."""

    now: _Digests
    before: _Digests | None = None
    key: str = ""
    signature: str = ""


class _EarlierSeal(msgspec.Struct, omit_defaults=True):
    """A seal as it was before; a digest of something comes after the one before its last change."""

    played: Annotated[list[str], msgspec.Meta(min_length=1)]
    verified: dict[str, Annotated[list[str], msgspec.Meta(min_length=1)]]
    key: str = ""
    signature: str = ""


def seal(store: Store) -> bool:
    """Seal a competition as it is, if it has no seal yet; return whether it had one.

    If something was sealed and then could not be written, because the process was killed or the disk is full,
    this must be called before anything else is recorded.
    """
    if not (store.directory / SEAL_FILE).exists():
        _write(store.directory, _Seal(_digests(store)))
        return False
    found = _read(store.directory)
    if isinstance(found, _Seal) and found.before is not None and _digests(store) == found.before:
        found.now = found.before
        _write(store.directory, found)
    return True


# The new digests are written before what they are of, and the old ones are kept with them: a process that is
# killed between the two leaves a valid seal.


def record_acts(store: Store, acts: Sequence[Act]) -> None:
    """Renew the seal, and append acts to the journal."""
    lines = journal.text_of(acts).encode()
    _renew(store, "acts", lambda chain: _chained(chain, lines))
    journal.append(store.directory, lines)


def add_trials(store: Store, specs: Sequence[TrialSpec]) -> None:
    """Renew the seal, and store further trials, for which acts of the journal call."""
    _renew(store, "trials", lambda total: _sum(map(_planned, specs), total))
    store.extend(specs)


def record_outcome(store: Store, trial_id: str, outcome: TrialEnd) -> None:
    """Renew the seal, and store how a trial ended."""
    _renew(store, "outcomes", lambda total: _sum([_ended(trial_id, outcome)], total))
    store.record_outcome(trial_id, outcome)


def record_verdict(store: Store, trial_id: str, verdict: ReplayVerdict) -> None:
    """Renew the seal, and store the result of replaying a trial, in place of an earlier one."""
    if isinstance(_read(store.directory), _EarlierSeal) and broken(store):
        store.record_verdict(trial_id, verdict)  # `reseal_verdicts` follows
        return
    was, new = store.verdict(trial_id), [_verified(store, trial_id, verdict)]
    old = [] if was is None else [_verified(store, trial_id, was)]
    if old != new:
        _renew(store, "verdicts", lambda total: _sum(new, _sum(old, total, -1)))
        store.record_verdict(trial_id, verdict)


def reseal_verdicts(store: Store) -> None:
    """Seal the verdicts as they are, once every trial that is over has been replayed, and so each of them and
    the episodes behind it are known to be right. What else was changed since it was sealed remains so.
    """
    if broken(store) == _WHAT["verdicts"] and store.verdicts().keys() <= store.outcomes().keys():
        _write(store.directory, _Seal(_digests(store)))


def _renew(store: Store, part: str, change: Callable[[str], str]) -> None:
    """Change the digest of a part, and keep what it was before.

    Raises:
        ExperimentError: the seal cannot be read, or is an earlier one and broken.
    """
    found = _read(store.directory)
    if isinstance(found, _EarlierSeal):
        check_seal(store)
        found = _Seal(_digests(store), None, found.key, found.signature)
    found.before = found.now
    found.now = replace(found.now, **{part: change(getattr(found.now, part))})
    _write(store.directory, found)


def broken(results: Results) -> str:
    """Return the name of what was changed since it was sealed; empty without a change or a seal.

    Raises:
        ExperimentError: the seal cannot be read.
    """
    directory = results.directory
    if not (directory / SEAL_FILE).exists():  # of version 0.1.0
        return ""
    changed = ""
    for _ in range(_TRIES):
        found = _read(directory)
        changed = _changed(results, found)
        if not changed or _read(directory) == found:  # while a run is in progress, its seal is renewed
            break
    return changed


def _changed(results: Results, found: _Seal | _EarlierSeal) -> str:
    if isinstance(found, _EarlierSeal):
        verdicts = results.verdicts()
        if _earlier_played(results) not in found.played:
            return ", ".join(what for part, what in _WHAT.items() if part != "verdicts")
        whole = (_verified(results, *one) for one in verdicts.items())
        sealed = all(_digest(*rest) in found.verified.get(str(trial), ()) for trial, *rest in whole)
        return "" if sealed else _WHAT["verdicts"]
    now = _digests(results)
    if now in (found.now, found.before):
        return ""
    of = [getattr(now, part) == getattr(found.now, part) for part in _WHAT]
    return ", ".join(what for what, same in zip(_WHAT.values(), of, strict=True) if not same)


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

    What a seal holds of before its last change is not signed: only those who can write there vouch for it.

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
    with Results.open(directory) as results:
        changed = _changed(results, _newest_part(found))
    if changed or not is_signed(public, _message(found), signature):
        raise ExperimentError(f"{directory} was not signed with {encode(public)}, or was changed since")


def _newest_part(found: _Seal | _EarlierSeal) -> _Seal | _EarlierSeal:
    """Return a seal without the digests of before its last change."""
    if isinstance(found, _Seal):
        return replace(found, before=None)
    last = {name: digests[-1:] for name, digests in found.verified.items()}
    return replace(found, played=found.played[-1:], verified=last)


def _message(found: _Seal | _EarlierSeal) -> bytes:
    if isinstance(found, _Seal):
        return b"glue-compete seal 2\n" + _digest(msgspec.to_builtins(found.now)).encode()
    last = {name: digests[-1] for name, digests in found.verified.items()}
    return b"glue-compete seal 1\n" + _digest(found.played[-1], last).encode()


def _digests(results: Results) -> _Digests:
    """Return the digests of everything that a run holds."""
    return _Digests(
        _digest(_files(results.directory)),
        _chained("", journal.content(results.directory)),
        _sum(_planned(record.spec) for record in results.trials()),
        _sum(_ended(*one) for one in results.outcomes().items()),
        _sum(_verified(results, *one) for one in results.verdicts().items()),
    )


def _sum(elements: Iterable[object], total: str = "0", sign: int = 1) -> str:
    """Return the digest of a set with elements added to it or, with the sign -1, taken from it."""
    whole = int(total, 16)
    for one in elements:
        drawn = hashlib.shake_256(json.dumps(one, sort_keys=True).encode()).digest(_SUM_BYTES)
        whole += sign * int.from_bytes(drawn)
    return f"{whole % 2 ** (8 * _SUM_BYTES):x}"


def _chained(chain: str, lines: bytes) -> str:
    """Return the digest of a journal to which lines were added."""
    for line in lines.splitlines():
        chain = hashlib.sha256(chain.encode() + line).hexdigest()
    return chain


def _files(directory: Path) -> list[str]:
    with reported(f"cannot read {directory}"):
        files = [read_regular(directory / name, MOST_TEXT) for name in (COMPETITION_FILE, ABOUT_FILE)]
    return [hashlib.sha256(file).hexdigest() for file in files]


def _planned(spec: TrialSpec) -> dict[str, object]:
    """Return the fields of a trial, those that are younger than the first seal only if they are set."""
    return {
        name: value
        for name, value in asdict(spec).items()
        if name in _SPEC or getattr(spec, name) != getattr(_UNSET, name)
    }


def _ended(trial_id: str, outcome: TrialEnd) -> object:
    return trial_id, outcome.reason, outcome.digest.hex()


def _verified(results: Results, trial_id: str, verdict: ReplayVerdict) -> tuple[object, ...]:
    return (
        trial_id,
        [verdict.digest.hex(), verdict.problem, repr(verdict.score)],
        [
            [row.episode, repr(row.episode_return), row.steps, row.terminal]
            for row in results.episodes(trial_id)
        ],
    )


def _earlier_played(results: Results) -> str:
    files = _files(results.directory)
    if acts := journal.content(results.directory):  # version 0.3 had no journal
        files.append(hashlib.sha256(acts).hexdigest())
    return _digest(
        files,
        [_planned(record.spec) for record in results.trials()],
        {name: [outcome.reason, outcome.digest.hex()] for name, outcome in results.outcomes().items()},
    )


def _digest(*parts: object) -> str:
    whole = hashlib.sha256()
    for chunk in json.JSONEncoder(sort_keys=True).iterencode(parts):
        whole.update(chunk.encode())
    return whole.hexdigest()


def _read(directory: Path) -> _Seal | _EarlierSeal:
    path = directory / SEAL_FILE
    try:
        text = read_regular(path, _MOST_BYTES)
        try:
            return msgspec.json.decode(text, type=_Seal)
        except ValueError:
            return msgspec.json.decode(text, type=_EarlierSeal)
    except (OSError, ValueError, RecursionError):
        raise ExperimentError(f"{path} is not a seal: put the file back that glue-compete wrote") from None


def _write(directory: Path, made: _Seal | _EarlierSeal) -> None:
    text = json.dumps(msgspec.to_builtins(made), indent=2) + "\n"
    replace_flushed(directory / SEAL_FILE, text, KEPT)

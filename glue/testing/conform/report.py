"""Verdicts as lines for people, as JSON, and as a scorecard in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from glue.protocol.messages import Role
from glue.testing.conform.hub.rules import Tier
from glue.testing.conform.judge import Outcome, Verdict

__all__ = ["document", "line", "reached", "scorecard", "summary"]

_PAGE: Final = "docs/protocol.md"

_SHOWN: Final = 64
"""Bytes of a frame that a line shows."""

_MARKS: Final = {Outcome.PASSED: "ok", Outcome.FAILED: "FAILED", Outcome.NOT_JUDGED: "-"}


def reached(verdicts: Sequence[Verdict]) -> dict[Tier, bool]:
    """Return for each tier that was judged whether it, and those before it, are reached.

    What a client does not offer is no obstacle. One that does not get as far as a rule has failed another.
    """
    judged = [tier for tier in Tier if any(verdict.rule.tier is tier for verdict in verdicts)]
    found: dict[Tier, bool] = {}
    for tier in judged:
        failed = any(v.rule.tier is tier and v.outcome is Outcome.FAILED for v in verdicts)
        found[tier] = not failed and all(found.values())
    return found


def line(verdict: Verdict) -> str:
    """Return a verdict as a line, and if it is not passed some more with the reason."""
    rule = verdict.rule
    text = (
        f"{_MARKS[verdict.outcome]:<7}{verdict.transport}  {rule.tier:<9} {rule.name}: {rule.text}"
        f" ({_PAGE}#{rule.section})"
    )
    if verdict.outcome is Outcome.NOT_JUDGED:
        return f"{text}\n         not judged: {verdict.expected}"
    if verdict.outcome is Outcome.FAILED:
        text += f"\n         expected: {verdict.expected}\n         received: {verdict.received}"
        for name, frame in zip(("header", "body", "more"), verdict.frames, strict=False):
            text += f"\n         {name + ':':<9} {_clipped(frame) if frame else '(empty)'}"
    return text


def _clipped(hex_bytes: str) -> str:
    """Return the first bytes of some in hex, as many as a person may want to look at."""
    size = (len(hex_bytes) + 1) // 3
    return hex_bytes if size <= _SHOWN else f"{hex_bytes[: 3 * _SHOWN]}... ({size} bytes)"


def summary(verdicts: Sequence[Verdict]) -> str:
    """Return what was reached, in one line."""
    tiers = ", ".join(f"{tier}: {'yes' if yes else 'no'}" for tier, yes in reached(verdicts).items())
    counts = ", ".join(
        f"{sum(v.outcome is outcome for v in verdicts)} {outcome}"
        for outcome in Outcome
        if any(v.outcome is outcome for v in verdicts)
    )
    return f"{tiers} ({counts})"


def document(role: Role, command: Sequence[str], verdicts: Sequence[Verdict]) -> Mapping[str, Any]:
    """Return everything, for JSON."""
    return {
        "role": str(role),
        "command": list(command),
        "tiers": {str(tier): yes for tier, yes in reached(verdicts).items()},
        "rules": [
            {
                "name": verdict.rule.name,
                "tier": str(verdict.rule.tier),
                "section": f"{_PAGE}#{verdict.rule.section}",
                "text": verdict.rule.text,
                "transport": verdict.transport,
                "outcome": str(verdict.outcome),
                "expected": verdict.expected,
                "received": verdict.received,
                "frames": list(verdict.frames),
            }
            for verdict in verdicts
        ],
    }


def scorecard(role: Role, command: Sequence[str], verdicts: Sequence[Verdict]) -> str:
    """Return a table of all rules in Markdown, to be shown beside a client."""
    transports = list(dict.fromkeys(verdict.transport for verdict in verdicts))
    found = {(v.rule.name, v.transport): v for v in verdicts}
    tiers = reached(verdicts)
    lines = [f"# {role}: `{' '.join(command)}`", "", "| tier | reached |", "| --- | --- |"]
    lines += [f"| {tier} | {'yes' if yes else 'no'} |" for tier, yes in tiers.items()]
    heads = " | ".join(transports)
    lines += [
        "",
        f"| tier | rule | what the client does | {heads} |",
        f"| --- | --- | --- |{' --- |' * len(transports)}",
    ]
    for rule in dict.fromkeys(verdict.rule for verdict in verdicts):
        marks = " | ".join(_MARKS[found[rule.name, transport].outcome] for transport in transports)
        lines.append(f"| {rule.tier} | [{rule.name}]({_PAGE}#{rule.section}) | {rule.text} | {marks} |")
    failed = [verdict for verdict in verdicts if verdict.outcome is not Outcome.PASSED]
    if failed:
        lines += ["", *(f"```text\n{line(verdict)}\n```" for verdict in failed)]
    return "\n".join([*lines, ""])

"""Verdicts as lines for people, as JSON, and as a scorecard in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from glue.conform.rules import Outcome, Tier, Verdict

_PAGE: Final = "docs/protocol-reference.md"

_SHOWN: Final = 64
"""Maximum number of bytes of a frame shown in a line."""

_MARKS: Final = {Outcome.PASSED: "ok", Outcome.FAILED: "FAILED", Outcome.NOT_JUDGED: "-"}

_UNSEEN: Final = ", as far as can be told without the mirror"


def _mark(verdict: Verdict) -> str:
    broken = verdict.outcome is Outcome.FAILED
    return "should" if broken and not verdict.violation else _MARKS[verdict.outcome]


def reached(verdicts: Sequence[Verdict]) -> dict[Tier, bool]:
    """Return, for each judged tier, whether it and those before it are reached.

    Rules that were not judged do not prevent that, nor do broken SHOULD rules.
    """
    judged = [tier for tier in Tier if any(verdict.rule.tier is tier for verdict in verdicts)]
    found: dict[Tier, bool] = {}
    for tier in judged:
        found[tier] = all(found.values()) and not any(v.violation for v in verdicts if v.rule.tier is tier)
    return found


def line(verdict: Verdict) -> str:
    """Return a verdict as a line, followed by lines with the reason if it is not passed."""
    rule = verdict.rule
    text = (
        f"{_mark(verdict):<7}{verdict.transport}  {rule.tier:<9} {rule.level:<7} {rule.name}: {rule.text}"
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
    """Return bytes in hex, clipped to the first `_SHOWN` bytes."""
    size = (len(hex_bytes) + 1) // 3
    return hex_bytes if size <= _SHOWN else f"{hex_bytes[: 3 * _SHOWN]}... ({size} bytes)"


def summary(verdicts: Sequence[Verdict]) -> str:
    """Return the tiers reached and the numbers of rules, in one line."""
    unseen = "" if all(verdict.mirror for verdict in verdicts) else _UNSEEN
    tiers = [
        f"{tier}{unseen if tier is Tier.PLAYS else ''}" for tier, yes in reached(verdicts).items() if yes
    ]
    missed = [f"{tier}: no" for tier, yes in reached(verdicts).items() if not yes]
    counts = {
        "passed": sum(v.outcome is Outcome.PASSED for v in verdicts),
        "MUST broken": sum(v.violation for v in verdicts),
        "SHOULD broken": sum(v.outcome is Outcome.FAILED and not v.violation for v in verdicts),
        "not judged": sum(v.outcome is Outcome.NOT_JUDGED for v in verdicts),
    }
    numbers = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return f"{'; '.join([*tiers, *missed])} ({numbers})"


def document(role: str, command: Sequence[str], verdicts: Sequence[Verdict]) -> Mapping[str, Any]:
    """Return all verdicts, for JSON."""
    return {
        "role": role,
        "command": list(command),
        "mirror": all(verdict.mirror for verdict in verdicts),
        "tiers": {str(tier): yes for tier, yes in reached(verdicts).items()},
        "rules": [
            {
                "name": verdict.rule.name,
                "tier": str(verdict.rule.tier),
                "level": str(verdict.rule.level),
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


def scorecard(role: str, command: Sequence[str], verdicts: Sequence[Verdict]) -> str:
    """Return a table of all rules in Markdown, for publication with a client."""
    transports = list(dict.fromkeys(verdict.transport for verdict in verdicts))
    found = {(v.rule.name, v.transport): v for v in verdicts}
    tiers = reached(verdicts)
    lines = [f"# {role}: `{' '.join(command)}`", "", "| tier | reached |", "| --- | --- |"]
    lines += [f"| {tier} | {'yes' if yes else 'no'} |" for tier, yes in tiers.items()]
    heads = " | ".join(transports)
    lines += [
        "",
        f"| tier | level | rule | what the client does | {heads} |",
        f"| --- | --- | --- | --- |{' --- |' * len(transports)}",
    ]
    for rule in dict.fromkeys(verdict.rule for verdict in verdicts):
        marks = " | ".join(_mark(found[rule.name, transport]) for transport in transports)
        lines.append(
            f"| {rule.tier} | {rule.level} | [{rule.name}]({_PAGE}#{rule.section}) | {rule.text} | {marks} |"
        )
    failed = [verdict for verdict in verdicts if verdict.outcome is not Outcome.PASSED]
    if failed:
        lines += ["", *(f"```text\n{line(verdict)}\n```" for verdict in failed)]
    return "\n".join([*lines, ""])

"""The part of a plan that says which extras of the environments are recorded, one number for each episode:

[extras]
mario.coins = "last"   # of the environment with the label mario
score = "mean"         # of any environment
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final, Literal, get_args

from experiment_runner.plan.ids import REMOTE
from experiment_runner.plan.toml import SettingError, shown
from glue.console import did_you_mean

Summary = Literal["first", "last", "sum", "mean", "min", "max"]
"""The number that stands for the values of an episode."""

SUMMARIES: Final = get_args(Summary)


def parse_extras(table: object) -> dict[str, Summary]:
    """Return the summary of each extra by its name, which may follow an environment's label and a dot.

    Args:
        table: `extras` of the plan.

    Raises:
        SettingError: it is not such a table.
    """
    if not isinstance(table, dict):
        raise SettingError('extras must be a table, as in: [extras], then mario.coins = "last"', "extras")
    found: dict[str, Summary] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            found |= {f"{name}.{extra}": _summary(how, name, extra) for extra, how in value.items()}
        else:
            found[name] = _summary(value, name)
    return found


def extra_of(key: str, label: str) -> str:
    """Return the name of the extra that a key means in the environment with this label.

    One that joins from outside has no label of its own: then any is left out.
    """
    return key.partition(".")[2] or key if label == REMOTE else key.removeprefix(f"{label}.")


def check_extras(keys: Collection[str], labels: Iterable[str]) -> None:
    """Check that no two keys mean the same extra of one of the environments with these labels.

    Raises:
        SettingError: two do: one number is recorded of each.
    """
    for label in labels:
        meant: dict[str, str] = {}
        for key in keys:
            other = meant.get(extra_of(key, label))
            meant[extra_of(key, label)] = key
            if other is not None:
                raise SettingError(
                    f"{other} and {key} are the same extra of {label}, and one number is recorded of each: "
                    "leave one out",
                    "extras",
                )


def _summary(value: object, *keys: str) -> Summary:
    if value not in SUMMARIES:
        near = did_you_mean(value if isinstance(value, str) else "", SUMMARIES)
        raise SettingError(
            f"of the extra {'.'.join(keys)!r:.80} an episode's {', '.join(SUMMARIES)} can be recorded, "
            f"not {shown(value)}{near}",
            "extras",
            *keys,
        )
    return value  # type: ignore[return-value]

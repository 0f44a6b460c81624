"""The keywords of another library's constructor as options of a class of ours."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final

from glue.options import Option

_SIMPLE: Final = (bool, int, float, str)


def keywords(
    creator: Any, help_text: str, defaults: Mapping[str, Any] | None = None
) -> list[inspect.Parameter]:
    """Return the parameters with a default that are numbers, texts or truth values.

    Args:
        creator: the constructor: a class or a function.
        help_text: the help text of each parameter.
        defaults: values in place of the constructor's own defaults.
    """
    known = defaults or {}
    signature = inspect.signature(creator)
    try:
        hints = typing.get_type_hints(creator.__init__ if inspect.isclass(creator) else creator)
    except (NameError, TypeError, AttributeError):
        hints = {}
    found = []
    for name, parameter in signature.parameters.items():
        default = known.get(name, parameter.default)
        stated = (hints.get(name), *typing.get_args(hints.get(name)))
        kinds = [one for one in _SIMPLE if one in stated]
        kind: Any = type(default) if isinstance(default, _SIMPLE) else kinds[0] if kinds else None
        if name == "self" or kind is None or default is parameter.empty:
            continue
        default = default if isinstance(default, _SIMPLE) else None
        annotation: Any = Annotated[kind | None, Option(help_text)]
        keyword = inspect.Parameter.KEYWORD_ONLY
        found.append(inspect.Parameter(name, keyword, default=default, annotation=annotation))
    return found


def with_options(construct: Callable[..., None], options: Sequence[inspect.Parameter]) -> Callable[..., None]:
    """Return a constructor that takes any keywords, with these as its options."""
    construct.__annotations__ = {option.name: option.annotation for option in options}
    itself = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    construct.__signature__ = inspect.Signature([itself, *options])  # type: ignore[attr-defined]
    return construct

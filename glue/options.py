"""A class's constructor parameters are its options, or the fields of its dataclass `Options`.

An environment or agent needs no separate configuration: each keyword of its constructor with a default is
an option, on the command line, in a plan file and in `--agent-option name=value`. Its meaning and bounds
are given where it is declared:

    class Walk:
        def __init__(self, *, length: Annotated[int, Option("number of states", low=2)] = 21): ...

Base classes with many options list them once, as a dataclass:

    class Walk:
        @dataclass(kw_only=True)
        class Options:
            length: Annotated[int, Option("number of states", low=2)] = 21

        def __init__(self, **options): self.options = self.Options(**options)
"""

from __future__ import annotations

import contextlib
import inspect
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

from glue.console import did_you_mean
from glue.errors import ConfigError

Value = int | float | str | bool

_SIMPLE: Final = (bool, int, float, str)


@dataclass(frozen=True, slots=True)
class Option:
    """Metadata of a constructor parameter, given by `Annotated`: meaning, unit and bounds (inclusive).

    `flag` is its name on the command line if its own name is taken there, as `render` is by glue-env.
    """

    help: str
    low: float | None = None
    high: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()
    flag: str = ""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One option of a class: its name, type, default and the `Option` it is annotated with."""

    name: str
    type: type
    default: Value | None
    option: Option

    @property
    def flag(self) -> str:
        """Its name on the command line, without the leading dashes."""
        return (self.option.flag or self.name).replace("_", "-")

    @property
    def _called(self) -> str:
        """Its name in messages."""
        alias = f" (--{self.flag})" if self.option.flag else ""
        return f"option {self.name}{alias}"

    @property
    def shown(self) -> str:
        """The default, as a user would type it."""
        if isinstance(self.default, bool):
            return "on" if self.default else "off"
        return str(self.default)

    def parse(self, text: str) -> Value:
        """Return `text` as a value of this parameter.

        Raises:
            ConfigError: the text is not of the type, or the value is out of bounds.
        """
        try:
            value: Value = _TRUTHS[text.lower()] if self.type is bool else self.type(text)
        except (KeyError, ValueError):
            raise ConfigError(f"{self._called} takes {_ARTICLE[self.type]}, not {text!r:.80}") from None
        return self.check(value)

    def check(self, value: Value) -> Value:
        """Return `value`, with an int converted where a float is expected.

        Raises:
            ConfigError: the value is of another type or out of bounds.
        """
        if self.type is float and isinstance(value, int) and not isinstance(value, bool):
            with contextlib.suppress(OverflowError):
                value = float(value)
        if type(value) is not self.type:
            raise ConfigError(f"{self._called} takes {_ARTICLE[self.type]}, not {value!r:.80}")
        option = self.option
        if option.choices and value not in option.choices:
            raise ConfigError(f"{self._called} is one of {', '.join(option.choices)}, not {value!r}")
        if isinstance(value, (int, float)):
            low = -math.inf if option.low is None else option.low
            high = math.inf if option.high is None else option.high
            if not low <= value <= high:
                raise ConfigError(f"{self._called} must be {_bounds(option)}, not {value}")
        return value


def parameters(factory: type) -> dict[str, Parameter]:
    """Return the options of a class, by name, in the order of its constructor.

    Raises:
        ConfigError: a parameter of the constructor has no default, or is not a number, text or bool.
    """
    found: dict[str, Parameter] = {}
    hints = _hints(factory)
    try:
        signature = inspect.signature(getattr(factory, "Options", factory))
    except (TypeError, ValueError) as error:  # a class that is not written in Python
        raise ConfigError(f"{factory.__name__} is not an agent or environment: {error}") from None
    for name, parameter in signature.parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        if parameter.default is parameter.empty or parameter.kind is parameter.POSITIONAL_ONLY:
            raise ConfigError(
                f"{factory.__name__}: constructor parameter {name} must be a keyword with a default"
            )
        found[name] = _parameter(name, hints.get(name), parameter.default)
    return found


def build(factory: type, options: Mapping[str, Value]) -> Any:
    """Return an instance of `factory` made with `options`, checked.

    Raises:
        ConfigError: an option is unknown (near misses are named), of another type or out of bounds.
    """
    known = parameters(factory)
    for name in options:
        if name not in known:
            raise ConfigError(_unknown(factory, name, known))
    abstract: frozenset[str] = getattr(factory, "__abstractmethods__", frozenset())
    if abstract:
        missing = ", ".join(sorted(abstract))
        raise ConfigError(f"{factory.__name__} has no {missing}: an agent or environment needs it")
    return factory(**{name: known[name].check(value) for name, value in options.items()})


def parse_assignments(factory: type, assignments: Iterable[str]) -> dict[str, Value]:
    """Return the options named by texts such as `level_difficulty=1`, parsed by `factory`'s types.

    Raises:
        ConfigError: a text has no `=`, or names an unknown option, or its value does not fit.
    """
    known = parameters(factory)
    values: dict[str, Value] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise ConfigError(f"an option is written name=value, not {assignment!r:.80}")
        if name not in known:
            raise ConfigError(_unknown(factory, name, known))
        values[name] = known[name].parse(text.strip())
    return values


_ARTICLE = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
_TRUTHS = dict.fromkeys(("1", "true", "yes", "on"), True)
_TRUTHS |= dict.fromkeys(("0", "false", "no", "off"), False)


def _hints(factory: type) -> dict[str, Any]:
    try:
        # For a dataclass, the class itself: the annotations of its __init__ are texts from several modules.
        declared = getattr(factory, "Options", None) or inspect.getattr_static(factory, "__init__")
        return typing.get_type_hints(declared, include_extras=True)
    except NameError as error:
        raise ConfigError(
            f"{factory.__name__}: the types of its constructor cannot be read: {error}"
        ) from None


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    option = Option("")
    if typing.get_origin(hint) is typing.Annotated:
        hint, *extras = typing.get_args(hint)
        option = next((extra for extra in extras if isinstance(extra, Option)), option)
    is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    kinds = [kind for kind in (typing.get_args(hint) if is_union else (hint,)) if kind in _ARTICLE]
    kind = kinds[0] if kinds else type(default)
    if kind not in _ARTICLE:
        raise ConfigError(f"constructor parameter {name} cannot be an option: its type is {hint!r}")
    return Parameter(name, kind, default, option)


def _bounds(option: Option) -> str:
    unit = f" {option.unit}" if option.unit else ""
    if option.low is None and option.high is None:
        return "a number"
    if option.low is None:
        return f"at most {_number(option.high)}{unit}"
    if option.high is None:
        return f"at least {_number(option.low)}{unit}"
    return f"from {_number(option.low)} to {_number(option.high)}{unit}"


def _number(bound: float | None) -> str:
    return f"{bound:.15g}" if isinstance(bound, float) else str(bound)


def _unknown(factory: type, name: str, known: Mapping[str, Parameter]) -> str:
    return f"{factory.__name__} has no option {name}{did_you_mean(name, known)}"


def keywords(
    creator: Any,
    help_text: str,
    own: Sequence[inspect.Parameter],
    left_out: str,
    defaults: Mapping[str, Any] | None = None,
) -> list[inspect.Parameter]:
    """Return the parameters with a default that are numbers, texts or truth values, and `own` after them.

    Args:
        creator: the constructor: a class or a function.
        help_text: the help text of each parameter.
        own: further options, in place of parameters of the same names.
        left_out: name of a parameter that is no option.
        defaults: values in place of the constructor's own defaults.
    """
    taken = {"self", left_out, *(each.name for each in own)}
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
        if name in taken or kind is None or default is parameter.empty:
            continue
        default = default if isinstance(default, _SIMPLE) else None
        found.append(option(name, default, Annotated[kind | None, Option(help_text)]))
    return [*found, *own]


def option(name: str, default: Value | None, annotation: Any) -> inspect.Parameter:
    """Return a parameter for `with_options`; its annotation is a type with an `Option`."""
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def with_options(construct: Callable[..., None], options: Sequence[inspect.Parameter]) -> Callable[..., None]:
    """Return a constructor that takes any keywords, with these as its options."""
    construct.__annotations__ = {option.name: option.annotation for option in options}
    itself = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    construct.__signature__ = inspect.Signature([itself, *options])  # type: ignore[attr-defined]
    return construct

"""Constructor parameters as options: glue/options.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Optional

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glue.errors import ConfigError
from glue.options import Option, Parameter, build, parameters, parse_assignments

if TYPE_CHECKING:
    from decimal import Decimal


class Walk:
    """Options of every type."""

    def __init__(
        self,
        *,
        length: Annotated[int, Option("number of states", low=2, high=1000, unit="states")] = 21,
        step_size: Annotated[float, Option("how far to go towards the target", low=0, high=1)] = 0.1,
        slip: float = 0.0,
        name: str = "walk",
        start: Annotated[str, Option("where to begin", choices=("middle", "random"))] = "middle",
        torus: Annotated[bool, Option("whether the ends meet")] = False,
        seed: Annotated[int | None, Option("seed of its own", low=0)] = None,
        limit: Annotated[Optional[float], Option("limit of the return", high=1e9)] = None,  # noqa: UP045
        **unlisted: int,
    ) -> None:
        self.made_of = (length, step_size, slip, name, start, torus, seed, limit)
        self.unlisted = unlisted


DEFAULTS = (21, 0.1, 0.0, "walk", "middle", False, None, None)


# Declaring


def test_parameters_are_those_of_the_constructor_in_order() -> None:
    found = parameters(Walk)
    assert list(found) == ["length", "step_size", "slip", "name", "start", "torus", "seed", "limit"]
    assert found["length"] == Parameter("length", int, 21, Option("number of states", 2, 1000, "states"))
    assert found["slip"] == Parameter("slip", float, 0.0, Option(""))
    assert [parameter.type for parameter in found.values()] == [int, float, float, str, str, bool, int, float]
    assert found["seed"].default is None


def test_class_without_constructor_has_no_options() -> None:
    class Plain:
        pass

    assert parameters(Plain) == {}
    assert isinstance(build(Plain, {}), Plain)


def test_dataclass_fields_are_options() -> None:
    assert build(Settings, {"size": 2}) == Settings(2)
    with pytest.raises(ConfigError, match="option size must be at most 3, not 4"):
        build(Settings, {"size": 4})


@dataclass
class Settings:
    size: Annotated[int, Option("how large", high=3)] = 1


def test_parameter_without_annotation_has_the_type_of_its_default() -> None:
    class Bare:
        def __init__(self, *, size=3):  # type: ignore[no-untyped-def]
            self.size = size

    assert parameters(Bare)["size"].type is int


class NeedsSize:
    def __init__(self, size: int) -> None: ...


class PositionalOnly:
    def __init__(self, size: int = 3, /) -> None: ...


class ListOption:
    def __init__(self, *, sizes: list[int] | None = None) -> None: ...


class TupleOption:
    def __init__(self, *, sizes: tuple[int, ...] = ()) -> None: ...


class UnreadableHint:
    def __init__(self, *, size: Decimal | None = None) -> None: ...


@pytest.mark.parametrize(
    ("factory", "error"),
    [
        (NeedsSize, "NeedsSize: constructor parameter size must be a keyword with a default"),
        (PositionalOnly, "PositionalOnly: constructor parameter size must be a keyword with a default"),
        (ListOption, "constructor parameter sizes cannot be an option: its type is list"),
        (TupleOption, "constructor parameter sizes cannot be an option: its type is tuple"),
        (UnreadableHint, "UnreadableHint: the types of its constructor cannot be read: name 'Decimal'"),
    ],
)
def test_class_whose_constructor_is_no_list_of_options_is_a_config_error(factory: type, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        build(factory, {})


# Building


def test_build_without_options_takes_the_defaults() -> None:
    assert build(Walk, {}).made_of == DEFAULTS


def test_bounds_include_their_ends() -> None:
    for length in (2, 1000):
        assert build(Walk, {"length": length}).made_of[0] == length


def test_int_is_widened_where_a_float_is_expected() -> None:
    assert isinstance(build(Walk, {"slip": 1}).made_of[2], float)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"length": 1}, "option length must be from 2 to 1000 states, not 1"),
        ({"length": 1001}, "option length must be from 2 to 1000 states, not 1001"),
        ({"seed": -1}, "option seed must be at least 0, not -1"),
        ({"limit": 2e9}, "option limit must be at most 1000000000, not 2000000000.0"),
        ({"step_size": float("nan")}, "option step_size must be from 0 to 1, not nan"),
        ({"slip": float("nan")}, "option slip must be a number, not nan"),
        ({"slip": 10**400}, "option slip takes a number, not 1000"),
        ({"length": 3.0}, "option length takes a whole number, not 3.0"),
        ({"length": True}, "option length takes a whole number, not True"),
        ({"length": "3"}, "option length takes a whole number, not '3'"),
        ({"length": None}, "option length takes a whole number, not None"),
        ({"length": np.int64(3)}, "option length takes a whole number, not np.int64"),
        ({"slip": True}, "option slip takes a number, not True"),
        ({"torus": 1}, "option torus takes true or false, not 1"),
        ({"name": 1}, "option name takes a text, not 1"),
        ({"start": "left"}, "option start is one of middle, random, not 'left'"),
        ({"step-size": 0.1}, "Walk has no option step-size; did you mean step_size?"),
        ({"lenght": 3}, "Walk has no option lenght; did you mean length?"),
        ({"colour": 3}, r"Walk has no option colour; choose from length, step_size, slip, name, "),
        ({"unlisted": 3}, "Walk has no option unlisted"),
    ],
)
def test_wrong_option_is_a_config_error(options: dict[str, Any], error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        build(Walk, options)


def test_long_bound_is_shown_in_full() -> None:
    class Seeded:
        def __init__(self, *, seed: Annotated[int, Option("", low=0, high=2**63 - 1)] = 0) -> None: ...

    with pytest.raises(ConfigError, match="from 0 to 9223372036854775807, not 9223372036854775808"):
        build(Seeded, {"seed": 2**63})


# Reading texts


def test_assignments_are_read_by_type() -> None:
    texts = ["length=30", "step_size=1e-3", "slip = 1", "name= a=b ", "torus=Yes", "seed=7", "limit=-5"]
    values = parse_assignments(Walk, texts)
    assert [type(value) for value in values.values()] == [int, float, float, str, bool, int, float]
    assert build(Walk, values).made_of == (30, 0.001, 1.0, "a=b", "middle", True, 7, -5.0)


def test_assignment_takes_dashes_and_the_last_of_two() -> None:
    assert parse_assignments(Walk, ["step-size=0.5", "step_size=0.25"]) == {"step_size": 0.25}


@pytest.mark.parametrize("text", ["1", "true", "YES", "on", "0", "False", "no", "OFF"])
def test_texts_that_are_true_or_false(text: str) -> None:
    assert parse_assignments(Walk, [f"torus={text}"]) == {"torus": text in ("1", "true", "YES", "on")}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("length", "an option is written name=value, not 'length'"),
        ("", "an option is written name=value, not ''"),
        ("=3", "an option is written name=value, not '=3'"),
        ("length=", "option length takes a whole number, not ''"),
        ("length=3.0", "option length takes a whole number, not '3.0'"),
        ("length=9" + "9" * 5000, "option length takes a whole number, not '9999"),
        ("length=1", "option length must be from 2 to 1000 states, not 1"),
        ("slip=fast", "option slip takes a number, not 'fast'"),
        ("slip=nan", "option slip must be a number, not nan"),
        ("torus=maybe", "option torus takes true or false, not 'maybe'"),
        ("start=left", "option start is one of middle, random, not 'left'"),
        ("steps=3", r"Walk has no option steps; did you mean step_size\?"),
    ],
)
def test_wrong_assignment_is_a_config_error(text: str, error: str) -> None:
    with pytest.raises(ConfigError, match=error) as caught:
        parse_assignments(Walk, [text])
    assert len(str(caught.value)) < 200


@given(
    st.lists(
        st.text(max_size=20) | st.builds("{}={}".format, st.sampled_from(list(parameters(Walk))), st.text())
    )
)
def test_any_assignments_are_read_or_refused(texts: list[str]) -> None:
    try:
        values = parse_assignments(Walk, texts)
    except ConfigError:
        return
    assert set(build(Walk, values).made_of) <= {*DEFAULTS, *values.values()}

"""Adapters of other packages' objects, whose options are the keywords of the objects' constructor."""

from __future__ import annotations

import inspect
from typing import Annotated, Any, ClassVar, Final

from glue.errors import ConfigError
from glue.options import Option, keywords, with_options

_SEED: Final = "seed"
_UNSTATED: Final = "VERSION rlglue"
_TaskSpec = Annotated[str, Option("the task spec, if the environment has none")]


class Adapter:
    """The base of the adapters.

    Args:
        options: keywords of the constructor of `source`.
    """

    source: ClassVar[type]
    """The class of the other package."""

    seeded_by: ClassVar[str]
    """The method by which an experiment seeds the adapter."""

    needs_seed: ClassVar[bool] = False
    """Whether the constructor has a parameter `seed` without default; if no seed is given, it is 0."""

    own_options: ClassVar[tuple[inspect.Parameter, ...]] = ()
    """Options of the adapter itself."""

    def __init__(self, **options: Any) -> None:
        self._options = options
        if self.needs_seed:
            self._options[_SEED] = 0
        self._made: Any = None

    def _new(self) -> Any:
        """Return a new object of the class."""
        self._made = self.source(**self._options)
        return self._made

    def _same(self) -> Any:
        """Return the object made last; make the first one if there is none."""
        return self._new() if self._made is None else self._made

    def _seed(self, seed: int) -> None:
        """Make the next object with this seed."""
        self._options[_SEED] = seed
        self._made = None


class EnvironmentAdapter(Adapter):
    """The base of the adapters of environments, many of which have no task spec.

    Args:
        task_spec: a task spec, for agents that need one.
        options: keywords of the environment's constructor.
    """

    seeded_by: ClassVar[str] = "env_seed"
    own_options: ClassVar[tuple[inspect.Parameter, ...]] = (
        inspect.Parameter("task_spec", inspect.Parameter.KEYWORD_ONLY, default="", annotation=_TaskSpec),
    )

    def __init__(self, *, task_spec: str = "", **options: Any) -> None:
        super().__init__(**options)
        self._task_spec = task_spec or _UNSTATED


def adapted(adapter: type[Adapter], source: type) -> type[Adapter]:
    """Return the class of adapters for objects of `source`.

    If the constructor of `source` has a parameter `seed`, the experiment's seed is its value.

    Raises:
        ConfigError: another parameter has no default.
    """
    signature = inspect.signature(source).parameters
    for name, parameter in signature.items():
        several = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if parameter.default is parameter.empty and not several and name != _SEED:
            raise ConfigError(
                f"{source.__name__}: constructor parameter {name} has no default: "
                "derive a class whose constructor takes no arguments, and name that one"
            )

    def __init__(self: Adapter, **options: Any) -> None:
        adapter.__init__(self, **options)

    of_source = keywords(source, f"keyword of {source.__name__}")
    options = [*(each for each in of_source if each.name != _SEED), *adapter.own_options]
    members: dict[str, Any] = {
        "__doc__": source.__doc__,
        "__init__": with_options(__init__, options),
        "__module__": source.__module__,  # repeatability without a seed is up to its author
        "source": source,
    }
    if _SEED in signature:
        members[adapter.seeded_by] = Adapter._seed
        members["needs_seed"] = signature[_SEED].default is inspect.Parameter.empty
    return type(source.__name__, (adapter,), members)

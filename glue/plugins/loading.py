"""Find an agent or environment by name, and the model of an environment; agents that have learned before.

A name has one of four forms: an installed entry point (group `glue.agents` or `glue.environments`),
`module:Class`, `path/to/file.py:Class`, or `adapter:NAME` for an object of another library, such as
`gymnasium:CartPole-v1`. The entry point of an adapter is a function from NAME to a class.

A file called random.py or agents.py in the user's folder shadows no module: the folder is searched
after everything that is installed.

Files of two folders may import modules of the same name, each that of its own folder: the modules of the
other folder are set aside. An import that is executed later, in a method, finds those of the folder that was
used last.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Mapping
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from glue.console import did_you_mean, show_failure
from glue.errors import ConfigError, GlueError, PeerFailed, described
from glue.files import read_regular
from glue.installed import entry_points
from glue.options import Value, build
from glue.roles import Agent, SaveableAgent, Wrapper, completed, offers
from glue.wire.messages import Role

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from glue.roles import Environment

PACKAGES: Final = ("glue", "env_server", "agents", "experiment_runner")
"""The packages of this program."""


_MAX_LEARNED: Final = 2**30
"""Bytes of the largest file of a learned state."""

_ADAPTERS: Final = {Role.AGENT: "glue.agent_adapters", Role.ENVIRONMENT: "glue.environment_adapters"}
_GYMNASIUM_ID: Final = re.compile(r"([\w.-]+/)?[\w.-]+-v\d+")
_WORD: Final = re.compile(r"([\w-]+/)?[\w-]+")
_GROUPS: Final = {Role.AGENT: "glue.agents", Role.ENVIRONMENT: "glue.environments"}


def make(name: str, /, **options: Value) -> Environment:
    """Return the environment called `name`, as in `make("mario", level_seed=3)`.

    Args:
        name: installed, or `module:Class`, or `path/to/file.py:Class`.
        options: of its constructor; `glue-env NAME --help` lists them.

    Raises:
        ConfigError: there is no such environment, or an option is unknown, of another type or out of bounds.
    """
    environment: Environment = build(find(Role.ENVIRONMENT, name), options)
    return environment


def make_agent(name: str, /, **options: Value) -> Agent:
    """Return the agent called `name`, as in `make_agent("sarsa", epsilon=0.1)`; otherwise as `make`."""
    agent: Agent = build(find(Role.AGENT, name), options)
    return agent


def construct(factory: type, options: Mapping[str, Value]) -> Any:
    """Return an instance of `factory` for a command; if its constructor fails, print the traceback.

    If the player takes no seed, Python's and NumPy's global generators are seeded instead.

    Raises:
        ConfigError: an option is unknown, of another type or out of bounds.
        PeerFailed: the constructor raised an exception, whose traceback has been printed.
    """
    from glue.global_seeds import take_seeds  # NumPy, which completion does not need

    try:
        player = build(factory, options)
    except GlueError:
        raise
    except Exception as error:
        show_failure(error)
        raise PeerFailed(f"{factory.__name__} raised in its constructor: {described(error)}") from None
    take_seeds(player)
    return player


def find_model(name: str) -> Any:
    """Return the model of the environment called `name`: a module of compiled functions.

    Raises:
        ConfigError: no installed package offers one.
    """
    for point in entry_points("glue.models").select(name=name):
        return point.load()
    raise ConfigError(
        f"no model of {name} is installed: agents that plan take it from the package of the environment, "
        "by its entry-point group glue.models"
    )


class Trained(Wrapper):
    """`agent`, with `learned` loaded after every init; otherwise unchanged.

    Args:
        agent: an agent with the capability `save`.
        learned: the result of `agent_save` of the same class.
    """

    def __init__(self, agent: Any, learned: bytes) -> None:
        self.__wrapped__: Any = completed(agent, Agent)
        self._learned = learned

    def agent_init(self, task_spec: str) -> None:
        self.__wrapped__.agent_init(task_spec)
        self.__wrapped__.agent_load(self._learned)


def load_trained(agent: Any, path: Path) -> Trained:
    """Return `agent` with the state in the file at `path`, as `glue-results agent` writes it.

    Raises:
        ConfigError: the agent cannot load, or the file cannot be read.
    """
    if not offers(agent, SaveableAgent):
        raise ConfigError(f"{type(agent).__name__} cannot load what was learned: it has no agent_load")
    try:
        return Trained(agent, read_regular(path, _MAX_LEARNED, follow=True))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error


def without_seed(role: Role, label: str, factory: type) -> str | None:
    """Return a line that says that players of a user's class take no seed; None if they do.

    Classes of this program without a seed are deterministic; the contract tests check that.

    Args:
        role: agent or environment.
        label: the player's name in the line.
        factory: the class.
    """
    method = "env_seed" if role is Role.ENVIRONMENT else "agent_seed"
    if callable(getattr(factory, method, None)) or factory.__module__.partition(".")[0] in PACKAGES:
        return None
    return (
        f"the {role} {label} has no {method}: the trial's seed goes to Python's and NumPy's global "
        "generators; numbers that it draws from others cannot be repeated"
    )


def names(role: Role) -> list[str]:
    """Return the names of the installed agents or environments, sorted."""
    return sorted(_installed(role))


def example(role: Role) -> str:
    """Return the name that messages suggest: that of the role's entry point in the group `glue.examples`.

    The default is NAME.
    """
    suggested = {point.name: point.value for point in entry_points("glue.examples")}.get(role)
    return next((name for name, point in _installed(role).items() if point.value == suggested), "NAME")


def summaries(role: Role) -> dict[str, str]:
    """Return the docstring of each installed agent or environment, by name, without importing it.

    It is empty where there is no docstring, or no source to read it from.
    """
    points = sorted(_installed(role).items())
    modules = {module: _class_docstrings(module) for module in {point.module for _, point in points}}
    return {name: modules[point.module].get(point.attr, "") for name, point in points}


def find(role: Role, name: str) -> type:
    """Return the class called `name`.

    Raises:
        ConfigError: there is none, or its module cannot be imported; near misses are named.
    """
    entry_point = _installed(role).get(name)
    if entry_point is not None:
        return _class_of(_import(entry_point.module), entry_point.attr, entry_point.module)
    prefix, _, rest = name.partition(":")
    adapter = {point.name: point for point in entry_points(_ADAPTERS[role])}.get(prefix)
    if adapter is not None:
        if not rest:
            raise ConfigError(f"{name!r} is not complete: write {prefix}:NAME, as {prefix} names the {role}")
        adapted: type = getattr(_import(adapter.module), adapter.attr)(rest)
        return adapted
    source, _, attribute = name.rpartition(":")
    if not source or not attribute:
        meant = _classes_in_file(name) or _adapted_name(role, name) or did_you_mean(name, names(role))
        raise ConfigError(
            f"no {role} is called {name!r}{meant} (your own is named module:Class or path/to/file.py:Class)"
        )
    module = _import_file(Path(source)) if source.endswith(".py") else import_user_module(source)
    return _class_of(module, attribute, source)


def _adapter_names() -> set[str]:
    return {point.name for group in _ADAPTERS.values() for point in entry_points(group)}


def is_installed(name: str) -> bool:
    """Return whether a name leads to installed players alone: one of ours, or `adapter:NAME` of one word.

    Any other may lead to code that the name's author chose, as `module:Class` to a file in this folder.
    """
    prefix, _, rest = name.partition(":")
    return any(name in names(role) for role in _GROUPS) or (
        prefix in _adapter_names() and _WORD.fullmatch(rest) is not None
    )


def short_name(name: str) -> str:
    """Return the last part of a name: its class, or of `adapter:http://host:port` host and port."""
    return name.rpartition("://" if "://" in name else ":")[2]


def file_in(name: str) -> str:
    """Return the file of a name like `path/to/file.py:Class` or `adapter:path/to/file.py:Class`, or ""."""
    source = name.rpartition(":")[0]
    if not source.endswith(".py"):
        return ""
    prefix, colon, rest = source.partition(":")
    if not colon:
        return source
    return rest if prefix in _adapter_names() else source


def located(name: str, folder: Path) -> str:
    """Return a name in which a relative path of a file is resolved against `folder`."""
    file = file_in(name)
    return name.replace(file, str(folder.absolute() / file), 1) if file else name


def import_user_module(name: str) -> ModuleType:
    """Return a module that is installed or lies in the working directory.

    Raises:
        ConfigError: there is none, or it cannot be imported.
    """
    _look_in(Path.cwd())
    return _import(name)


def all_modules() -> list[tuple[str, ModuleType]]:
    """Return the name and module of everything that is imported, and of what is set aside."""
    return [*sys.modules.items(), *(one for modules in _aside.values() for one in modules.items())]


def _adapted_name(role: Role, name: str) -> str:
    """Return the suggestion for a name like Gymnasium's CartPole-v1; empty for any other."""
    known = any(point.name == "gymnasium" for point in entry_points(_ADAPTERS[role]))
    return f"; did you mean gymnasium:{name}?" if known and _GYMNASIUM_ID.fullmatch(name) else ""


def _classes_in_file(name: str) -> str:
    """Return a suggestion for the name of a file without a class; empty if there is no such file."""
    path = Path(f"{name.removesuffix('.py')}.py")
    try:
        classes = list(_docstrings(path))
    except (OSError, SyntaxError, ValueError):
        return ""
    return f"; did you mean {' or '.join(f'{path}:{found}' for found in classes)}?" if classes else ""


def _installed(role: Role) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(_GROUPS[role])}


def _class_docstrings(module: str) -> dict[str, str]:
    spec = _spec(module)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return {}
    return _docstrings(Path(spec.origin))


def _docstrings(path: Path) -> dict[str, str]:
    """Return the docstring of each class in a file, which is not executed."""
    body = ast.parse(path.read_bytes()).body
    return {node.name: ast.get_docstring(node) or "" for node in body if isinstance(node, ast.ClassDef)}


def _spec(module: str) -> ModuleSpec | None:
    """Return the spec of a module. Unlike importlib's `find_spec`, this does not import its packages."""
    package, _, _ = module.rpartition(".")
    if not package:
        return importlib.util.find_spec(module)
    parent = _spec(package)
    locations = None if parent is None else parent.submodule_search_locations
    return None if locations is None else PathFinder.find_spec(module, list(locations))


def _import(module: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ConfigError:
        raise  # its message says what it needs
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            raise ConfigError(f"there is no module {module!r} here") from None
        raise ConfigError(_broken(module, error)) from error


def _import_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ConfigError(f"there is no file {path}")
    name = f"_glue_user_{path.stem}"
    _look_in(path.resolve().parent, name)
    spec = importlib.util.spec_from_file_location(name, path.resolve())
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ConfigError(_broken(str(path), error)) from error
    return module


_aside: Final[dict[Path, dict[str, ModuleType]]] = {}
"""By each of the user's folders, its modules that are set aside."""

_searched: Final[list[str]] = []
"""The user's folders that we have added to `sys.path`."""


def _look_in(folder: Path, own: str = "") -> None:
    """Let modules of `folder` be imported, unless something of that name is installed.

    Modules of the user's other folders are set aside if `folder` has one of the same name. They return when
    their folder is used again.

    Args:
        folder: absolute, without links.
        own: name of a module that will be made of a file in `folder`.
    """
    here = str(folder)
    for top in {name.partition(".")[0] for name in sys.modules}:
        home = _home(sys.modules.get(top))
        if home in _aside and home != folder and (top == own or PathFinder.find_spec(top, [here])):
            for name in [name for name in sys.modules if name == top or name.startswith(f"{top}.")]:
                _aside[home][name] = sys.modules.pop(name)
    sys.modules.update(_aside.get(folder, {}))
    _aside[folder] = {}
    if here in _searched or here not in sys.path:
        sys.path[:] = [path for path in sys.path if path not in _searched]
        _searched[:] = [here, *(path for path in _searched if path != here)]
        sys.path += _searched


def _home(module: ModuleType | None) -> Path | None:
    """Return the folder that holds a module or package; None if that is not known."""
    variables = getattr(module, "__dict__", {})  # without a module's `__getattr__`, which may import
    place = next(iter(variables.get("__path__") or ()), variables.get("__file__"))
    return Path(place).parent if isinstance(place, str) else None


def _broken(source: str, error: BaseException) -> str:
    if isinstance(error, SyntaxError):  # shown as Python does: file, line and a caret
        return f"{source} cannot be imported:\n{''.join(traceback.format_exception_only(error)).rstrip()}"
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{source} cannot be imported: {described(error)} ({last.filename}, line {last.lineno})"


def _class_of(module: ModuleType, attribute: str, source: str) -> type:
    found = getattr(module, attribute, None)
    if not isinstance(found, type):
        classes = [value for value in vars(module).values() if isinstance(value, type)]
        own = [value.__name__ for value in classes if value.__module__ == module.__name__]
        raise ConfigError(f"{source} has no class {attribute!r}{did_you_mean(attribute, own)}")
    return found

"""Find an agent or environment by name.

A name is one of three: that of an installed entry point (group `glue.agents` or `glue.environments`),
`module:Class`, or `path/to/file.py:Class`.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import traceback
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from glue.errors import ConfigError
from glue.protocol.messages import Role
from glue.suggestions import did_you_mean

__all__ = ["find", "names"]

_GROUPS = {Role.AGENT: "glue.agents", Role.ENVIRONMENT: "glue.environments"}


def names(role: Role) -> list[str]:
    """Return the names of the installed agents or environments, sorted."""
    return sorted(_installed(role))


def find(role: Role, name: str) -> type:
    """Return the class that `name` stands for.

    Raises:
        ConfigError: there is none, or its module cannot be imported; near misses are named.
    """
    entry_point = _installed(role).get(name)
    if entry_point is not None:
        return _class_of(_import(entry_point.module), entry_point.attr, entry_point.module)
    source, _, attribute = name.rpartition(":")
    if not source or not attribute:
        raise ConfigError(_unknown(role, name))
    module = _import_file(Path(source)) if source.endswith(".py") else _import(source)
    return _class_of(module, attribute, source)


def _installed(role: Role) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=_GROUPS[role])}


def _unknown(role: Role, name: str) -> str:
    return (
        f"no {role} is called {name!r}{did_you_mean(name, names(role))} "
        "(your own is named module:Class or path/to/file.py:Class)"
    )


def _import(module: str) -> ModuleType:
    _look_in(Path.cwd())
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(error.name + ".")):
            raise ConfigError(f"there is no module {module!r} here") from None
        raise ConfigError(_broken(module, error)) from error
    except (Exception, SystemExit) as error:
        raise ConfigError(_broken(module, error)) from error


def _import_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ConfigError(f"there is no file {path}")
    _look_in(path.resolve().parent)
    name = f"_glue_user_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
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


def _look_in(folder: Path) -> None:
    """Let modules of `folder` be imported, as those beside a program are that Python itself is given."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def _broken(source: str, error: BaseException) -> str:
    where = ""
    if not isinstance(error, SyntaxError):  # which says itself where it is
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f" ({last.filename}, line {last.lineno})"
    return f"{source} cannot be imported: {type(error).__name__}: {error}{where}"


def _class_of(module: ModuleType, attribute: str, source: str) -> type:
    found = getattr(module, attribute, None)
    if not isinstance(found, type):
        classes = [value for value in vars(module).values() if isinstance(value, type)]
        own = [value.__name__ for value in classes if value.__module__ == module.__name__]
        raise ConfigError(f"{source} has no class {attribute!r}{did_you_mean(attribute, own)}")
    return found

"""The entrance to glue-rl where another distribution has a package called `glue` or `agents`.

    from glue_rl import Agent, serve_agent

Installers mix the files of distributions that share a name. So a wheel keeps our packages in a folder of
their own, `glue_rl/packages`, the last entry of the module path (`glue_rl.pth`): `import glue` finds ours
unless another distribution has one, and nobody's files are overwritten. Importing `glue_rl` moves the folder
to the front. Commands begin here too, so each of them finds our packages whole. In a checkout the folder is
the checkout.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # not imported: see glue.cli.entry
if TYPE_CHECKING:
    from typing import Any, Final

    from glue.api import *  # noqa: F403

__all__ = ["HOME"]

_FOLDER: Final = os.path.dirname(os.path.abspath(__file__))
_INSTALLED: Final = os.path.join(_FOLDER, "packages")
HOME: Final = _INSTALLED if os.path.isdir(_INSTALLED) else os.path.dirname(_FOLDER)
"""The folder of our packages."""


def _claim() -> None:
    """Let the short names be ours in this process.

    Raises:
        ImportError: another package called `glue` has been imported before.
    """
    file = getattr(sys.modules.get("glue"), "__file__", None)
    if file is not None and os.path.dirname(os.path.dirname(os.path.realpath(file))) != os.path.realpath(
        HOME
    ):
        raise ImportError(
            f"{file}, a package of another distribution, is already imported: import glue_rl first"
        )
    sys.path[:] = [HOME, *(entry for entry in sys.path if entry != HOME)]


_claim()


def __getattr__(name: str) -> Any:
    if name.startswith("_") and name != "__version__":
        raise AttributeError(f"module 'glue_rl' has no attribute {name!r}")
    import glue

    return getattr(glue, name)

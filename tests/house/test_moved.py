"""What the documents of version 0.1.0 said to import, and has moved, says where it is now."""

from __future__ import annotations

import re
from importlib import import_module

import pytest


@pytest.mark.parametrize("module", ["glue.local", "env_server.batch", "env_server.drawing"])
def test_the_message_has_the_import_that_works(module: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=f"^{module} has moved") as raised:
        import_module(module)
    works = re.search("`(.*)`", str(raised.value))
    assert works is not None
    exec(works[1], {})

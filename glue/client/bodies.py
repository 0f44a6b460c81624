"""Convert bodies of messages to and from the values that players and experiments see."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from glue.engine.metrics import pack_metrics
from glue.errors import LocalProtocolError
from glue.types import AbstractType, Action, Observation, body_size
from glue.wire.messages import Body


def _read_both(body: bytes) -> tuple[Observation, Action]:
    size = body_size(body)
    return Observation._wrap(body[:size]), Action._wrap(body[size:])


# The codec has already checked these bodies.
READ: Final[Mapping[Body, Callable[[bytes], Any]]] = {
    Body.NONE: lambda body: None,
    Body.OBSERVATION: Observation._wrap,
    Body.ACTION: Action._wrap,
    Body.OBSERVATION_ACTION: _read_both,
    # Original RL-Glue programs send arbitrary bytes, which survive the round trip.
    Body.TEXT: lambda body: body.decode("utf-8", "surrogateescape"),
    Body.BLOB: bytes,
}


def write(value: Any) -> bytes:
    if isinstance(value, AbstractType):
        return value._body
    if value is None:
        return b""
    if isinstance(value, dict):
        return pack_metrics(value).body
    if type(value) is str:
        try:
            return value.encode("utf-8", "surrogateescape")
        except UnicodeEncodeError as error:
            raise LocalProtocolError(
                f"{value!r:.80} is not a text that UTF-8 can carry: {error.reason}"
            ) from None
    data: bytes = value
    return data

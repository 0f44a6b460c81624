"""The examples of docs/protocol-reference.md: the meaning and the bytes of every message."""

from __future__ import annotations

import json
import re
from typing import Any, Final, NamedTuple

from glue.wire.codec import FROM_HUB, TO_HUB
from glue.wire.messages import Kind
from tests.pages import DOCS, blocks

TEXT: Final = (DOCS / "protocol-reference.md").read_text(encoding="utf-8")


class Example(NamedTuple):
    """One example: its meaning and its bytes."""

    kind: Kind
    sender: str
    receiver: str
    meant: list[Any]
    frames: tuple[bytes, ...]
    comments: list[str]

    @property
    def shapes(self) -> Any:
        return TO_HUB if self.receiver == "hub" else FROM_HUB

    def __str__(self) -> str:
        return f"{self.kind.name}-{self.sender}-to-{self.receiver}"


def read_example(block: str) -> Example:
    title, meant, *lines = block.splitlines()
    name, sender, receiver = re.fullmatch(r"(\w+)  (\w+) → (\w+)", title).groups()  # type: ignore[union-attr]
    frames: list[bytes] = []
    comments: list[str] = []
    for line in lines:
        label, rest = line[:8].strip(), line[8:]
        data, _, comment = rest.partition(";")
        if label:
            assert label == ["header", "body"][len(frames)]
            frames.append(b"")
        frames[-1] += bytes.fromhex(data)
        if comment:
            comments.append(comment.strip())
    return Example(Kind[name], sender, receiver, read_array(meant), tuple(frames), comments)


def read_array(text: str) -> list[Any]:
    """Read JSON, with binaries as <00 11 22>."""
    binaries = [bytes.fromhex(found) for found in re.findall(r"<([0-9a-f ]+)>", text)]
    values: list[Any] = json.loads(re.sub(r"<[0-9a-f ]+>", "null", text))
    return [binaries.pop(0) if value is None and binaries else value for value in values]


EXAMPLES: Final = [read_example(block) for _, _, block in blocks(TEXT, "message")]

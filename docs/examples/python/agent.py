"""An agent that walks away from where it started, written from docs/protocol.md alone.

Usage: python agent.py [tcp://127.0.0.1:4097] [session]
"""

from typing import Any

from peer import Answer, UnknownKind, read, serve, write

INIT, START, STEP, END, CLEANUP, MESSAGE = 4, 5, 6, 7, 8, 10


class Walker:
    """Goes up (1) if its first int says that it is not below its start, else down (0)."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.start = 0
        self.episodes = 0
        self.total = 0.0
        self.seen = write()

    def act(self, observation: bytes) -> bytes:
        self.seen = observation
        return write(ints=[1 if read(observation)[0][0] >= self.start else 0])

    def describe(self) -> str:
        ints, doubles, chars = read(self.seen)
        return (
            f"{self.episodes} episodes, {self.total:g} in all; last seen: "
            f"{len(ints)} ints, {len(doubles)} doubles that sum to {sum(doubles):g}, {len(chars)} chars"
        )

    def answer(self, kind: int, scalars: list[Any], body: bytes) -> Answer:
        if kind in (STEP, END):
            self.total += scalars[0]
        if kind == INIT:
            self.forget()
        elif kind == START:
            self.start = read(body)[0][0]
            return [], self.act(body)
        elif kind == STEP:
            return [], self.act(body)
        elif kind == END:
            self.episodes += 1
        elif kind == MESSAGE:
            return [], self.describe().encode()
        elif kind != CLEANUP:
            raise UnknownKind
        return [], None


if __name__ == "__main__":
    serve("agent", "walker", Walker().answer)

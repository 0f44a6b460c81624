"""RL-Glue's skeleton environment, a walk along 21 states, written from docs/protocol.md alone.

Usage: python environment.py [tcp://127.0.0.1:4097] [session]
"""

from typing import Any

from peer import Answer, UnknownKind, read, serve, write

INIT, START, STEP, CLEANUP, MESSAGE = 11, 12, 13, 14, 19

TASK_SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 "
    "OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA a walk"
)


class Walk:
    """From state 10, action 0 goes down and 1 goes up; 0 ends with reward -1, 20 with +1."""

    def __init__(self) -> None:
        self.state = 10

    def answer(self, kind: int, scalars: list[Any], body: bytes) -> Answer:
        if kind == INIT:
            return [], TASK_SPEC.encode()
        if kind == START:
            self.state = 10
            return [], write(ints=[self.state])
        if kind == STEP:
            self.state += 1 if read(body)[0][0] else -1
            reward = {0: -1.0, 20: 1.0}.get(self.state, 0.0)
            return [reward, reward != 0.0], write(ints=[self.state])
        if kind == CLEANUP:
            return [], None
        if kind == MESSAGE:
            return [], b""
        raise UnknownKind


if __name__ == "__main__":
    serve("environment", "walk", Walk().answer)

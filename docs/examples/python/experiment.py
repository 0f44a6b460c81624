"""An experiment of a few episodes at a hub of its own (glue-hub), written from docs/protocol.md alone.

Usage: python experiment.py [tcp://127.0.0.1:4097] [session]
"""

import sys
from typing import Any

import msgpack
from peer import ERROR, GOODBYE, HEARTBEAT, HUB, REFUSE, SESSION, WELCOME, Connection

NOTICE = 70
INIT, CLEANUP, RETURN, NUM_STEPS, EPISODE, AGENT_MESSAGE = 20, 23, 24, 25, 27, 33


class EpisodeVoid(Exception):
    """A player went away in mid-episode; start the episode again."""


class Experiment:
    def __init__(self, hub: str, session: str) -> None:
        self.session = session
        self.seq = 0
        self.answered = False
        self.connection = Connection("experiment", "a few episodes", hub, session)

    def ask(self, kind: int, *scalars: object, body: bytes | None = None) -> tuple[list[Any], bytes]:
        """Return the scalars and the body of the reply to a request, however often the network fails."""
        self.seq += 1
        request = [msgpack.packb([kind, self.session, self.seq, *scalars])]
        if body is not None:
            request.append(body)
        if self.connection.welcomed:
            self.connection.send(*request)
        while True:
            (_, *rest), answered, seq, values = self.connection.receive()
            if answered == WELCOME:
                _, resumed, *_ = values
                if not resumed and self.answered:
                    sys.exit("the hub is another one; the experiment is lost")
                self.connection.send(*request)
            elif answered in (REFUSE, GOODBYE):
                sys.exit(f"the hub says: {values[-1]}")
            elif answered == NOTICE:
                print(f"{values[1]} {values[2]} {values[0]}", file=sys.stderr)
            elif answered == HEARTBEAT or seq != self.seq:
                continue
            elif answered == ERROR:
                self.answered = True
                if values[0] == "peer-lost":
                    raise EpisodeVoid(values[1])
                sys.exit(f"the hub says: {values[1]}")
            else:
                self.answered = True
                return values, rest[0] if rest else b""


def main(hub: str = HUB, session: str = SESSION) -> None:
    glue = Experiment(hub, session)
    task_spec = glue.ask(INIT, None)[1]
    print(task_spec.decode())
    done = 0
    while done < 3:
        try:
            (terminal,) = glue.ask(EPISODE, 1000)[0]
        except EpisodeVoid as why:
            print(f"again, because {why}", file=sys.stderr)
            continue
        done += 1
        ((total,), _), ((steps,), _) = glue.ask(RETURN), glue.ask(NUM_STEPS)
        print(f"episode {done}: return {total:g}, {steps} steps, {'ended' if terminal else 'cut off'}")
    print(glue.ask(AGENT_MESSAGE, body=b"how was it?")[1].decode())
    glue.ask(CLEANUP)
    glue.connection.close("all done")


if __name__ == "__main__":
    main(*sys.argv[1:3])

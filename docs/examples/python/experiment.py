"""An experiment of a few episodes at a hub of its own (glue-hub), written from docs/protocol.md alone.

Usage: python experiment.py [tcp://127.0.0.1:4097] [session]
"""

import sys
from typing import Any

import msgpack
import zmq
from peer import ERROR, GOODBYE, HEARTBEAT, HUB, REFUSE, SESSION, SILENCE_MS, WELCOME, connect

NOTICE = 70
INIT, CLEANUP, RETURN, NUM_STEPS, EPISODE, AGENT_MESSAGE = 20, 23, 24, 25, 27, 33


class EpisodeVoid(Exception):
    """A player went away in mid-episode; start the episode again."""


class Experiment:
    def __init__(self, hub: str, session: str) -> None:
        self.session = session
        self.seq = 0
        self.socket, self.hello = connect("experiment", "a few episodes", hub, session)

    def ask(self, kind: int, *scalars: object, body: bytes | None = None) -> tuple[list[Any], bytes]:
        """Return the scalars and the body of the reply to a request, however often the network fails."""
        self.seq += 1
        request = [msgpack.packb([kind, self.session, self.seq, *scalars])]
        if body is not None:
            request.append(body)
        self.socket.send_multipart(request)
        while True:
            if not self.socket.poll(SILENCE_MS):
                self.socket.send(self.hello)
                continue
            header, *rest = self.socket.recv_multipart()
            answered, _, seq, *values = msgpack.unpackb(header)
            if answered == WELCOME:
                _, resumed, *_ = values
                if not resumed and self.seq > 1:
                    sys.exit("the hub is another one; the experiment is lost")
                self.socket.send_multipart(request)
            elif answered in (REFUSE, GOODBYE):
                sys.exit(f"the hub says: {values[-1]}")
            elif answered == NOTICE:
                print(f"{values[1]} {values[2]} {values[0]}", file=sys.stderr)
            elif answered == ERROR and values[0] == "unknown-peer":
                self.socket.send(self.hello)
            elif answered == HEARTBEAT or seq != self.seq:
                continue
            elif answered == ERROR:
                if values[0] == "peer-lost":
                    raise EpisodeVoid(values[1])
                sys.exit(f"the hub says: {values[1]}")
            else:
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
    glue.socket.send(msgpack.packb([GOODBYE, session, 0, "all done"]))
    glue.socket.close()
    zmq.Context.instance().term()  # Waits until the goodbye has left.


if __name__ == "__main__":
    main(*sys.argv[1:3])

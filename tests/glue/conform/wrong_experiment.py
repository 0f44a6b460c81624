"""The experiment of `wrong`."""

from __future__ import annotations

import struct
from typing import Any

import msgpack

from tests.glue.conform.wrong import ERROR, GOODBYE, NOTICE, Client, Quit

VERBS = {
    "RL_INIT": 20,
    "RL_START": 21,
    "RL_STEP": 22,
    "RL_CLEANUP": 23,
    "RL_RETURN": 24,
    "RL_NUM_STEPS": 25,
    "RL_NUM_EPISODES": 26,
    "RL_EPISODE": 27,
    "RL_AGENT_MESSAGE": 33,
    "RL_ENV_MESSAGE": 34,
    "RL_ENV_START": 36,
    "RL_ENV_STEP": 37,
    "RL_AGENT_START": 38,
    "RL_AGENT_STEP": 39,
    "RL_AGENT_END": 40,
    "RL_AGENT_METRICS": 94,
    "RL_AGENT_SAVE": 90,
    "RL_AGENT_LOAD": 91,
    "RL_ENV_SAVE": 92,
    "RL_ENV_LOAD": 93,
}
ENV_STEP = 37


class Failed(Exception):
    """A request failed."""


ABSTRACT = {
    *("RL_START", "RL_STEP", "RL_ENV_START", "RL_ENV_STEP", "RL_AGENT_START", "RL_AGENT_STEP"),
    "RL_AGENT_METRICS",
}


class Asking(Client):
    """An experiment that carries out the orders in its observations."""

    def __init__(self, hub: str, session: str, fault: str) -> None:
        super().__init__("experiment", hub, session, fault)
        self.seq = -1 if self.wrong("counts requests from 0") else 0
        self.pending: list[bytes] = []
        self.answered = False
        self.notices: list[str] = []

    def was_welcomed(self, resumed: bool) -> None:
        if not resumed and self.hellos > 1 and self.wrong("gives up after `resumed` false"):
            raise Quit(1)
        if not resumed and self.answered and not self.wrong("goes on when it was forgotten"):
            print("the hub has forgotten this experiment")
            raise Quit(1)
        lost = self.wrong("loses its request with the connection") and self.hellos > 1
        if lost and self.pending and msgpack.unpackb(self.pending[0])[0] != ENV_STEP:
            return
        if self.pending and self.welcomed:
            self.send(*self.pending)
            if self.wrong("asks twice over a new connection") and self.hellos > 1:
                self.send(*self.pending)

    def shake_hands(self) -> None:
        super().shake_hands()
        if self.pending and self.hellos > 1 and self.wrong("asks ahead of WELCOME"):
            self.send(*self.pending)

    def request(self, kind: int, scalars: list[Any], body: bytes | None) -> tuple[list[Any], bytes]:
        if body is not None and len(body) > self.max_body:
            print("that is too large")
            raise Quit(1)
        self.seq += 1
        header = msgpack.packb([kind, self.session, self.seq, *scalars])
        self.pending = [header] if body is None else [header, body]
        if self.welcomed:
            try:
                self.send(*self.pending)
            except ConnectionError:
                self.connected = False
        while True:
            frames, received, seq, got = self.next()
            if received == NOTICE:
                if not (self.wrong("drops a notice") and kind != ENV_STEP):
                    self.notices.append(" ".join(got))
            elif seq != self.seq and not (self.wrong("takes any reply for its own") and received == kind):
                if received == 63 and self.wrong("dies of an unknown kind"):
                    raise Quit(1)
            elif received == ERROR:
                self.answered, self.pending = True, []
                raise Failed("a request failed" if self.wrong("shows no code of an error") else " ".join(got))
            elif received == kind:
                self.answered, self.pending = True, []
                return got, frames[1] if len(frames) > 1 else b""

    def ask_on(self) -> int:
        try:
            shown = self.write([], [], b"ready")
            while True:
                (reward, _), body = self.request(ENV_STEP, [], shown)
                ints, doubles, chars = self.runs(body)
                verb, _, argument = chars.partition(b" ")
                if verb == b"end":
                    if not self.wrong("leaves without GOODBYE"):
                        self.send(msgpack.packb([GOODBYE, self.session, 0, "the end"]))
                    return 0
                try:
                    shown = self.result(*self.carry_out(verb.decode(), argument, reward, ints, doubles))
                except Failed as failure:
                    shown = self.result(chars=f"ERROR {failure}".encode())
        except Quit as end:
            return int(end.args[0])

    def result(
        self, ints: list[int] | None = None, doubles: list[float] | None = None, chars: bytes = b""
    ) -> bytes:
        return self.write(ints or [], [*(doubles or []), float(sum(ints or []))], chars)

    def carry_out(
        self, verb: str, argument: bytes, reward: float, ints: list[int], doubles: list[float]
    ) -> tuple[list[int], list[float], bytes]:
        if verb == "notices":
            lines, self.notices = "\n".join(self.notices).encode(), []
            return [], [], lines
        scalars: list[Any] = []
        body = None
        if verb == "RL_INIT":
            scalars = [int(argument) if argument else None]
        elif verb == "RL_EPISODE":
            scalars = [int(argument)]
        elif verb in ("RL_AGENT_STEP", "RL_AGENT_END"):
            scalars = [reward]
        if verb in ("RL_AGENT_MESSAGE", "RL_ENV_MESSAGE", "RL_AGENT_LOAD", "RL_ENV_LOAD"):
            body = argument
        elif verb in ("RL_ENV_STEP", "RL_AGENT_START", "RL_AGENT_STEP"):
            body = self.write(ints, doubles, argument)
        got, reply = self.request(VERBS[verb], scalars, body)
        if verb in ("RL_NUM_STEPS", "RL_NUM_EPISODES"):
            number = got[0] & 0xFFFFFFFF if self.wrong("reads numbers of steps in 32 bits") else got[0]
            return [], [], str(number).encode()
        if verb == "RL_EPISODE":
            if len(got) != 1 and self.wrong("offers to be told the outcome, and dies of it"):
                raise Quit(1)
            told = self.wrong("shows 2 for an episode that was cut off")
            return [int(got[0]) if told else int(bool(got[0]) and self.terminal_of(got[0]) != 2)], [], b""
        if verb == "RL_RETURN":
            return [], [float(got[0])], b""
        if verb in ABSTRACT:
            return self.abstract(reply, got)
        return [], [], reply

    def terminal_of(self, got: bool | int) -> int:
        if got == 2 and type(got) is int:
            return 0 if self.wrong("goes on after a cut-off") else 2
        return int(bool(got))

    def abstract(self, reply: bytes, got: list[Any]) -> tuple[list[int], list[float], bytes]:
        all_ints, all_doubles, all_chars = [], [], b""
        while reply:
            i, d, c, _ = struct.unpack_from("<4I", reply)
            size = 16 + 8 * d + 4 * i + c
            if self.wrong("takes a body with a byte behind it") and len(reply) == size + 1:
                reply = reply[:-1]
            ints, doubles, chars = self.runs(reply[:size])
            reply = reply[size:]
            all_ints += ints
            all_doubles += doubles
            all_chars += chars
        if got:
            if type(got[1]) is not bool and self.wrong("takes an integer terminal for an error"):
                print("terminal is not a bool")
                raise Quit(1)
            all_ints.append(self.terminal_of(got[1]))
            all_doubles.append(float(got[0]))
        return all_ints, all_doubles, all_chars

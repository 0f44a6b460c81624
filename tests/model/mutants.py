"""Mistakes of a hub or a peer, as changes of docs/model/Glue.tla, and the promise that each breaks."""

from __future__ import annotations

from typing import Final, NamedTuple


class Mutant(NamedTuple):
    """A change of the model, and the promise that it breaks."""

    mistake: str
    before: str
    """Text that occurs in the model exactly once."""

    after: str
    breaks: str
    """Name of the invariant or property that TLC refutes."""


MUTANTS: Final = (
    Mutant(
        "a player does not answer a repeated call",
        "repeated == again \\/ c.seq = last[p].seq",
        "repeated == again",
        "RequestsEnd",
    ),
    Mutant(
        "a player drops its last answer on `resumed` false",
        "IF last[p].seq = 0 THEN @ ELSE last[p]]",
        "Nothing]",
        "ExactlyOnce",
    ),
    Mutant(
        "a player keeps its numbers on `resumed` false",
        "ELSE /\\ last' = [last EXCEPT ![p] = Nothing]",
        "ELSE /\\ last' = last",
        "RequestsEnd",
    ),
    Mutant(
        "a player answers over another connection than the call's, before WELCOME",
        "IF whole[p] THEN Append(@, Answer(a))",
        "IF up[p] THEN Append(@, Answer(a))",
        "NoStaleAnswer",
    ),
    Mutant(
        "an experiment does not repeat its request after WELCOME",
        "IF waiting /\\ ~forgotten THEN Append(@, Request(request)) ELSE @",
        "@",
        "RequestsEnd",
    ),
    Mutant(
        "the hub does not repeat a call to a player that came back",
        "IF call.to = p THEN <<Call(call.seq, call.what)>> ELSE <<>>",
        "<<>>",
        "RequestsEnd",
    ),
    Mutant(
        "the hub does not repeat its last reply",
        'IF ~busy /\\ outcome # "none" THEN <<Reply(taken, outcome)>> ELSE <<>>',
        "<<>>",
        "RequestsEnd",
    ),
    Mutant(
        "the hub accepts an answer of any number",
        "good == call.to = p /\\ call.seq = a.seq",
        "good == call.to = p",
        "NoStaleAnswer",
    ),
    Mutant(
        "the hub voids no episode when a player is lost",
        "IF busy THEN EndVoid ELSE UNCHANGED",
        "IF FALSE THEN EndVoid ELSE UNCHANGED",
        "LostThenVoid",
    ),
    Mutant(
        "the hub gives a role away whose holder is reachable",
        "/\\ seat[p] = 0 \\/ away[p]",
        "/\\ TRUE",
        "LostThenVoid",
    ),
    Mutant(
        "the hub begins a repeated request again",
        "IF n > taken /\\ ~busy",
        "IF n >= taken /\\ ~busy",
        "RequestOnce",
    ),
    Mutant(
        "the hub voids an episode when a connection breaks",
        "/\\ outcome' = outcome",
        '/\\ outcome\' = IF busy THEN "void" ELSE outcome',
        "VoidOnlyIfLost",
    ),
)

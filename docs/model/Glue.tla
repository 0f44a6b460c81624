------------------------------- MODULE Glue -------------------------------
(***************************************************************************)
(* One session of docs/protocol-reference.md: a hub, an experiment, an environment   *)
(* and an agent.  Connections break, programs are killed and started       *)
(* again, the hub is restarted, peers stay away beyond the timeout.        *)
(*                                                                         *)
(* A request is an episode of Stages calls, to the environment and the     *)
(* agent in turn; a newcomer is initialised before its first other call.   *)
(* Left out: bodies, observers, batches, GOODBYE (it is a loss without the wait) and         *)
(* malformed messages (they end a connection, as a break does).            *)
(*                                                                         *)
(* A comment "MUST: ..." quotes the sentence of docs/protocol-reference.md that an   *)
(* action implements; tests/model/ holds the two texts together.           *)
(***************************************************************************)
EXTENDS Naturals, Sequences, FiniteSets

CONSTANTS
    Stages,      \* calls of an episode
    Requests,    \* episodes that the experiment asks for
    Breaks,      \* connections that break, at most
    Kills,       \* players that are killed and started again, at most
    Restarts,    \* restarts of the hub, at most
    Losses,      \* peers given up by the hub after the timeout, at most
    Faults       \* all of these together, at most

Players == {"environment", "agent"}
Peers == Players \cup {"experiment"}

None == [to |-> "nobody", seq |-> 0, what |-> 0]
Initialise == 99  \* the content of a call, which is its stage or this

VARIABLES
    \* The hub's state, all of it lost by a restart.
    hub,         \* generation of the hub: 1, 2, ... after each restart
    seat,        \* [Peers -> instance that holds the role, 0 if none]
    reached,     \* [Peers -> whether a connection is attached to the role]
    heard,       \* [Peers -> whether a numbered message followed the WELCOME]
    away,        \* [Peers -> whether the holder was given up, and is remembered]
    count,       \* sequence number of the last call to a player
    fresh,       \* [Players -> whether the holder is to be initialised]
    call,        \* the outstanding call: [to, seq, what]
    stage,       \* number of calls of the request that were answered
    taken,       \* number of the last request received, 0 if none
    busy,        \* whether that request is under way
    outcome,     \* reply to it: "none", "done" or "void"
    \* The peers.
    instance,    \* [Peers -> instance of the running program]
    welcomed,    \* [Peers -> whether WELCOME arrived over this connection]
    last,        \* [Players -> [seq, hub, by] of the last call answered]
    kept,        \* [Players -> that answer, kept after `resumed` false]
    work,        \* [Players -> call in progress: [seq, hub, stage], seq 0 if none]
    whole,       \* [Players -> whether the connection of that call still stands]
    request,     \* number of the experiment's request, 0 before the first
    waiting,     \* whether that request has no reply yet
    answered,    \* whether any request was answered since `resumed` false
    \* The network: one connection a peer, two channels, first in, first out.
    up, toHub, toPeer,
    \* Faults left.
    breaks, kills, restarts, losses,
    \* Ghosts: what happened, for the invariants only.
    carried,     \* set of [role, instance, hub, seq] of calls carried out
    twice,       \* whether one of them was carried out again
    stale,       \* whether the hub accepted an answer to another call
    lost,        \* whether a player was lost since the request began
    mixed,       \* [Players -> instances that answered a call of the request]
    begun,       \* set of <<hub, n>>: requests begun since the hub met the experiment
    begunTwice,  \* whether one of them was begun again
    met,         \* set of [role, instance, hub] of WELCOMEs that were read
    trusted      \* whether `resumed` true was said to an instance that read none

hubState == <<hub, seat, reached, heard, away, count, fresh, call, stage, taken, busy, outcome>>
peerState == <<instance, welcomed, last, kept, work, whole, request, waiting, answered>>
network == <<up, toHub, toPeer>>
faults == <<breaks, kills, restarts, losses>>
ghosts == <<carried, twice, stale, lost, mixed, begun, begunTwice, met, trusted>>
vars == <<hubState, peerState, network, faults, ghosts>>

Nothing == [seq |-> 0, hub |-> 0, by |-> 0, stage |-> 0]

Hello(p) == [kind |-> "hello", instance |-> instance[p]]

Init ==
    /\ hub = 1
    /\ seat = [p \in Peers |-> 0]
    /\ reached = [p \in Peers |-> FALSE]
    /\ heard = [p \in Peers |-> FALSE]
    /\ away = [p \in Peers |-> FALSE]
    /\ fresh = [p \in Players |-> TRUE]
    /\ count = 0 /\ call = None /\ stage = 0 /\ taken = 0 /\ busy = FALSE /\ outcome = "none"
    /\ instance = [p \in Peers |-> 1]
    /\ welcomed = [p \in Peers |-> FALSE]
    /\ last = [p \in Players |-> Nothing]
    /\ kept = [p \in Players |-> Nothing]
    /\ work = [p \in Players |-> Nothing]
    /\ whole = [p \in Players |-> FALSE]
    /\ request = 0 /\ waiting = FALSE /\ answered = FALSE
    /\ up = [p \in Peers |-> TRUE]
    /\ toHub = [p \in Peers |-> <<Hello(p)>>]
    /\ toPeer = [p \in Peers |-> <<>>]
    /\ breaks = Breaks /\ kills = Kills /\ restarts = Restarts /\ losses = Losses
    /\ carried = {} /\ twice = FALSE /\ stale = FALSE /\ lost = FALSE
    /\ mixed = [p \in Players |-> {}]
    /\ begun = {} /\ begunTwice = FALSE /\ met = {} /\ trusted = FALSE

---------------------------------------------------------------------------
(* Messages *)

Welcome(resumed) == [kind |-> "welcome", resumed |-> resumed]
Refuse == [kind |-> "refuse"]
Call(seq, s) == [kind |-> "call", seq |-> seq, hub |-> hub, stage |-> s]
Answer(a) == [kind |-> "answer", seq |-> a.seq, hub |-> a.hub, by |-> a.by, stage |-> a.stage]
Request(n) == [kind |-> "request", n |-> n]
Reply(n, o) == [kind |-> "reply", n |-> n, outcome |-> o]
Unknown == [kind |-> "unknown-peer"]

CalledAt(s) == IF s % 2 = 0 THEN "environment" ELSE "agent"

---------------------------------------------------------------------------
(* The peers *)

\* MUST: greet with HELLO before anything else, with an instance that is random
\* MUST: say HELLO over each new connection, and when it gets `unknown-peer`
Connect(p) ==
    /\ ~up[p]
    /\ up' = [up EXCEPT ![p] = TRUE]
    /\ toHub' = [toHub EXCEPT ![p] = <<Hello(p)>>]
    /\ UNCHANGED <<hubState, peerState, toPeer, faults, ghosts>>

\* MUST: forget its numbers on WELCOME with `resumed` false
\* SHOULD: keep the last call that it answered, and that answer, after `resumed` false too
PlayerWelcomed(p) ==
    /\ p \in Players
    /\ toPeer[p] # <<>> /\ Head(toPeer[p]).kind = "welcome"
    /\ work[p].seq = 0
    /\ welcomed' = [welcomed EXCEPT ![p] = TRUE]
    /\ met' = met \cup {[role |-> p, instance |-> instance[p], hub |-> hub]}
    /\ IF Head(toPeer[p]).resumed
       THEN UNCHANGED <<last, kept>>
       ELSE /\ last' = [last EXCEPT ![p] = Nothing]
            /\ kept' = [kept EXCEPT ![p] = IF last[p].seq = 0 THEN @ ELSE last[p]]
    /\ toPeer' = [toPeer EXCEPT ![p] = Tail(@)]
    /\ UNCHANGED <<hubState, instance, work, whole, request, waiting, answered, up, toHub, faults,
                   carried, twice, stale, lost, mixed, begun, begunTwice, trusted>>

\* MUST: follow [the rule](#calls-and-how-each-happens-exactly-once) of its role about sequence numbers
PlayerCalled(p) ==
    /\ p \in Players
    /\ toPeer[p] # <<>> /\ Head(toPeer[p]).kind = "call"
    /\ work[p].seq = 0
    /\ LET c == Head(toPeer[p])
           again == last[p].seq = 0 /\ c.seq = kept[p].seq /\ c.stage = kept[p].stage
           answer == IF again THEN kept[p] ELSE last[p]
           repeated == again \/ c.seq = last[p].seq
           new == c.seq > last[p].seq IN
        /\ toPeer' = [toPeer EXCEPT ![p] = Tail(@)]
        /\ IF repeated
           THEN /\ toHub' = [toHub EXCEPT ![p] = Append(@, Answer(answer))]
                /\ last' = [last EXCEPT ![p] = answer]
                /\ UNCHANGED <<work, whole>>
           ELSE /\ IF new
                   THEN /\ work' = [work EXCEPT ![p] =
                                      [seq |-> c.seq, hub |-> c.hub, by |-> 0, stage |-> c.stage]]
                        /\ whole' = [whole EXCEPT ![p] = TRUE]
                   ELSE UNCHANGED <<work, whole>>
                /\ UNCHANGED <<toHub, last>>
    /\ UNCHANGED <<hubState, instance, welcomed, kept, request, waiting, answered, up, faults, ghosts>>

\* MUST: answer every call of its role, if only with ERROR `unknown-kind` or `exception`
\* MUST NOT: send an answer behind the HELLO of a new connection before it has been welcomed over it
PlayerFinishes(p) ==
    /\ p \in Players
    /\ work[p].seq # 0
    /\ LET a == [seq |-> work[p].seq, hub |-> work[p].hub, by |-> instance[p], stage |-> work[p].stage]
           deed == [role |-> p, instance |-> instance[p], hub |-> a.hub, seq |-> a.seq] IN
        /\ last' = [last EXCEPT ![p] = a]
        /\ twice' = (twice \/ deed \in carried)
        /\ carried' = carried \cup {deed}
        /\ toHub' = [toHub EXCEPT ![p] = IF whole[p] THEN Append(@, Answer(a)) ELSE @]
    /\ work' = [work EXCEPT ![p] = Nothing]
    /\ UNCHANGED <<hubState, instance, welcomed, kept, whole, request, waiting, answered, up, toPeer, faults,
                   stale, lost, mixed, begun, begunTwice, met, trusted>>

\* MUST: each request MUST have a greater number than the one before
\* MUST: send requests only over a connection over which it has been welcomed
Ask ==
    /\ ~waiting /\ request < Requests
    /\ up["experiment"] /\ welcomed["experiment"]
    /\ request' = request + 1
    /\ waiting' = TRUE
    /\ toHub' = [toHub EXCEPT !["experiment"] = Append(@, Request(request + 1))]
    /\ UNCHANGED <<hubState, instance, welcomed, last, kept, work, whole, answered, up, toPeer, faults, ghosts>>

\* MUST NOT: send a request over a connection before it has been welcomed over it
\* The pending request is sent again after WELCOME, unless the hub knows nothing of this experiment any more.
ExperimentWelcomed ==
    /\ toPeer["experiment"] # <<>> /\ Head(toPeer["experiment"]).kind = "welcome"
    /\ welcomed' = [welcomed EXCEPT !["experiment"] = TRUE]
    /\ LET forgotten == ~Head(toPeer["experiment"]).resumed /\ answered IN
        /\ waiting' = (waiting /\ ~forgotten)
        /\ answered' = (answered /\ ~forgotten)
        /\ toHub' = [toHub EXCEPT !["experiment"] =
                        IF waiting /\ ~forgotten THEN Append(@, Request(request)) ELSE @]
    /\ met' = met \cup {[role |-> "experiment", instance |-> instance["experiment"], hub |-> hub]}
    /\ toPeer' = [toPeer EXCEPT !["experiment"] = Tail(@)]
    /\ UNCHANGED <<hubState, instance, last, kept, work, whole, request, up, faults,
                   carried, twice, stale, lost, mixed, begun, begunTwice, trusted>>

ExperimentAnswered ==
    /\ toPeer["experiment"] # <<>> /\ Head(toPeer["experiment"]).kind = "reply"
    /\ LET r == Head(toPeer["experiment"]) IN
        IF waiting /\ r.n = request
        THEN waiting' = FALSE /\ answered' = TRUE
        ELSE UNCHANGED <<waiting, answered>>
    /\ toPeer' = [toPeer EXCEPT !["experiment"] = Tail(@)]
    /\ UNCHANGED <<hubState, instance, welcomed, last, kept, work, whole, request, up, toHub, faults, ghosts>>

\* MUST: say HELLO over each new connection, and when it gets `unknown-peer`
\* After REFUSE `role-taken` a peer may greet again.
GreetAgain(p) ==
    /\ toPeer[p] # <<>> /\ Head(toPeer[p]).kind \in {"unknown-peer", "refuse"}
    /\ toPeer' = [toPeer EXCEPT ![p] = Tail(@)]
    /\ toHub' = [toHub EXCEPT ![p] = Append(@, Hello(p))]
    /\ UNCHANGED <<hubState, peerState, up, faults, ghosts>>

---------------------------------------------------------------------------
(* The hub *)

Received(p, kind) == toHub[p] # <<>> /\ Head(toHub[p]).kind = kind
Consume(p) == toHub' = [toHub EXCEPT ![p] = Tail(@)]
Send(p, messages) == toPeer' = [toPeer EXCEPT ![p] = @ \o messages]

\* Sends the outstanding call to player `p`, or the last reply to the experiment, again.
Repeat(p) ==
    IF p = "experiment"
    THEN IF ~busy /\ outcome # "none" THEN <<Reply(taken, outcome)>> ELSE <<>>
    ELSE IF call.to = p THEN <<Call(call.seq, call.what)>> ELSE <<>>

\* The holder of the role comes back: over a new connection, or after it was given up.
Resume(p) ==
    /\ Received(p, "hello")
    /\ seat[p] = Head(toHub[p]).instance
    /\ reached' = [reached EXCEPT ![p] = TRUE]
    /\ away' = [away EXCEPT ![p] = FALSE]
    /\ trusted' = (trusted \/ (heard[p] /\ [role |-> p, instance |-> seat[p], hub |-> hub] \notin met))
    /\ Consume(p)
    /\ Send(p, <<Welcome(heard[p])>> \o Repeat(p))
    /\ UNCHANGED <<hub, seat, heard, count, fresh, call, stage, taken, busy, outcome, peerState, up, faults,
                   carried, twice, stale, lost, mixed, begun, begunTwice, met>>

\* An instance that the hub does not know takes a free role.
Admit(p) ==
    /\ Received(p, "hello")
    /\ seat[p] # Head(toHub[p]).instance
    /\ seat[p] = 0 \/ away[p]
    /\ seat' = [seat EXCEPT ![p] = Head(toHub[p]).instance]
    /\ reached' = [reached EXCEPT ![p] = TRUE]
    /\ heard' = [heard EXCEPT ![p] = FALSE]
    /\ away' = [away EXCEPT ![p] = FALSE]
    /\ fresh' = IF p \in Players THEN [fresh EXCEPT ![p] = TRUE] ELSE fresh
    /\ Consume(p)
    /\ IF call.to = p
       THEN /\ call' = [to |-> p, seq |-> count + 1, what |-> Initialise]
            /\ count' = count + 1
            /\ Send(p, <<Welcome(FALSE), Call(count + 1, Initialise)>>)
       ELSE /\ UNCHANGED <<call, count>>
            /\ Send(p, <<Welcome(FALSE)>>)
    /\ UNCHANGED <<hub, stage, taken, busy, outcome, peerState, up, faults, ghosts>>

EndVoid ==
    /\ busy' = FALSE /\ outcome' = "void" /\ call' = None
    /\ toPeer' = [toPeer EXCEPT !["experiment"] =
                    IF reached["experiment"] THEN Append(@, Reply(taken, "void")) ELSE @]

\* The holder of a role is lost: the hub forgets the experiment, and voids the episode of a player.
Lose(p) ==
    IF p = "experiment"
    THEN /\ taken' = 0 /\ busy' = FALSE /\ outcome' = "none" /\ call' = None /\ stage' = 0
         /\ begun' = {}
         /\ UNCHANGED <<toPeer, lost>>
    ELSE /\ lost' = TRUE
         /\ UNCHANGED <<stage, taken, begun>>
         /\ IF busy THEN EndVoid ELSE UNCHANGED <<busy, outcome, call, toPeer>>

\* A role is free at once when its holder's connection has ended: the newcomer's HELLO makes the holder lost.
Replace(p) ==
    /\ Received(p, "hello")
    /\ seat[p] \notin {0, Head(toHub[p]).instance}
    /\ ~reached[p] /\ ~away[p]
    /\ away' = [away EXCEPT ![p] = TRUE]
    /\ UNCHANGED <<hub, seat, reached, heard, count, fresh, peerState, up, toHub, faults, carried, twice, stale,
                   mixed, begunTwice, met, trusted>>
    /\ Lose(p)

RefuseRole(p) ==
    /\ Received(p, "hello")
    /\ seat[p] \notin {0, Head(toHub[p]).instance}
    /\ reached[p]
    /\ Consume(p)
    /\ Send(p, <<Refuse>>)
    /\ UNCHANGED <<hubState, peerState, up, faults, ghosts>>

\* A connection without a role is told to greet.
TurnAway(p) ==
    /\ toHub[p] # <<>> /\ Head(toHub[p]).kind # "hello"
    /\ ~reached[p]
    /\ Consume(p)
    /\ Send(p, <<Unknown>>)
    /\ UNCHANGED <<hubState, peerState, up, faults, ghosts>>

\* The next call: to the player of stage `s`, which is initialised first if it is new.
NextCall(s, new) ==
    LET p == CalledAt(s) IN
    [to |-> p, seq |-> count + 1, what |-> IF new[p] THEN Initialise ELSE s]

Issue(s, new) ==
    LET c == NextCall(s, new) IN
    /\ count' = count + 1
    /\ call' = c
    /\ stage' = s
    /\ toPeer' = [toPeer EXCEPT ![c.to] = IF reached[c.to] THEN Append(@, Call(c.seq, c.what)) ELSE @]

TakeRequest ==
    /\ Received("experiment", "request") /\ reached["experiment"]
    /\ LET n == Head(toHub["experiment"]).n IN
        IF n > taken /\ ~busy
        THEN /\ taken' = n /\ busy' = TRUE /\ outcome' = "none"
             /\ heard' = [heard EXCEPT !["experiment"] = TRUE]
             /\ Issue(0, fresh)
             /\ lost' = FALSE /\ mixed' = [p \in Players |-> {}]
             /\ begunTwice' = (begunTwice \/ <<hub, n>> \in begun)
             /\ begun' = begun \cup {<<hub, n>>}
        ELSE UNCHANGED <<taken, busy, outcome, heard, count, call, stage, lost, mixed, begun, begunTwice, toPeer>>
    /\ Consume("experiment")
    /\ UNCHANGED <<hub, seat, reached, away, fresh, peerState, up, faults, carried, twice, stale, met, trusted>>

\* An answer counts only if it names the call that is outstanding and comes from the peer that holds the role called.
\* An answer to any call that the hub has made, even to one that was dropped with its episode, shows that the player
\* has been welcomed.
TakeAnswer(p) ==
    /\ p \in Players
    /\ Received(p, "answer") /\ reached[p]
    /\ LET a == Head(toHub[p])
           good == call.to = p /\ call.seq = a.seq
           next == IF call.what = Initialise THEN stage ELSE stage + 1
           new == [fresh EXCEPT ![p] = FALSE] IN
        /\ Consume(p)
        /\ heard' = [heard EXCEPT ![p] = @ \/ a.seq <= count]
        /\ IF ~good
           THEN UNCHANGED <<busy, outcome, count, fresh, call, stage, toPeer, stale, mixed>>
           ELSE /\ stale' = (stale \/ (a.hub # hub /\ heard[p]) \/ a.stage # call.what)
                /\ mixed' = [mixed EXCEPT ![p] = @ \cup {a.by}]
                /\ fresh' = new
                /\ IF next < Stages
                   THEN Issue(next, new) /\ UNCHANGED <<busy, outcome>>
                   ELSE /\ busy' = FALSE /\ outcome' = "done" /\ call' = None
                        /\ toPeer' = [toPeer EXCEPT !["experiment"] =
                                        IF reached["experiment"]
                                        THEN Append(@, Reply(taken, "done")) ELSE @]
                        /\ UNCHANGED <<count, stage>>
    /\ UNCHANGED <<hub, seat, reached, away, taken, peerState, up, faults, carried, twice, lost, begun,
                   begunTwice, met, trusted>>

---------------------------------------------------------------------------
(* Faults *)

Cut(p) ==
    /\ up' = [up EXCEPT ![p] = FALSE]
    /\ welcomed' = [welcomed EXCEPT ![p] = FALSE]
    /\ reached' = [reached EXCEPT ![p] = FALSE]
    /\ toHub' = [toHub EXCEPT ![p] = <<>>]
    /\ toPeer' = [toPeer EXCEPT ![p] = <<>>]
    /\ whole' = IF p \in Players THEN [whole EXCEPT ![p] = FALSE] ELSE whole

Break(p) ==
    /\ breaks > 0 /\ up[p]
    /\ breaks' = breaks - 1
    /\ Cut(p)
    /\ outcome' = outcome
    /\ UNCHANGED <<hub, seat, heard, away, count, fresh, call, stage, taken, busy, instance, last, kept,
                   work, request, waiting, answered, kills, restarts, losses, ghosts>>

\* MUST NOT: be kept across restarts of the program
Kill(p) ==
    /\ kills > 0 /\ p \in Players
    /\ kills' = kills - 1
    /\ Cut(p)
    /\ instance' = [instance EXCEPT ![p] = @ + 1]
    /\ last' = [last EXCEPT ![p] = Nothing]
    /\ kept' = [kept EXCEPT ![p] = Nothing]
    /\ work' = [work EXCEPT ![p] = Nothing]
    /\ UNCHANGED <<hub, seat, heard, away, count, fresh, call, stage, taken, busy, outcome,
                   request, waiting, answered, breaks, restarts, losses, ghosts>>

\* The hub gives a peer up that stayed away for longer than the timeout.
GiveUp(p) ==
    /\ losses > 0
    /\ seat[p] # 0 /\ ~reached[p] /\ ~away[p]
    /\ losses' = losses - 1
    /\ UNCHANGED <<hub, reached, heard, count, fresh, peerState, up, toHub, breaks, kills, restarts, carried, twice,
                   stale, mixed, begunTwice, met, trusted>>
    /\ IF p = "experiment"
       THEN seat' = [seat EXCEPT ![p] = 0] /\ away' = away
       ELSE away' = [away EXCEPT ![p] = TRUE] /\ seat' = seat
    /\ Lose(p)

RestartHub ==
    /\ restarts > 0
    /\ restarts' = restarts - 1
    /\ hub' = hub + 1
    /\ seat' = [p \in Peers |-> 0]
    /\ reached' = [p \in Peers |-> FALSE]
    /\ heard' = [p \in Peers |-> FALSE]
    /\ away' = [p \in Peers |-> FALSE]
    /\ fresh' = [p \in Players |-> TRUE]
    /\ count' = 0 /\ call' = None /\ stage' = 0 /\ taken' = 0 /\ busy' = FALSE /\ outcome' = "none"
    /\ up' = [p \in Peers |-> FALSE]
    /\ welcomed' = [p \in Peers |-> FALSE]
    /\ toHub' = [p \in Peers |-> <<>>]
    /\ toPeer' = [p \in Peers |-> <<>>]
    /\ whole' = [p \in Players |-> FALSE]
    /\ lost' = FALSE /\ mixed' = [p \in Players |-> {}]
    /\ UNCHANGED <<instance, last, kept, work, request, waiting, answered, breaks, kills, losses, carried,
                   twice, stale, begun, begunTwice, met, trusted>>

---------------------------------------------------------------------------

PeerActs(p) ==
    \/ Connect(p) \/ PlayerWelcomed(p) \/ PlayerCalled(p) \/ PlayerFinishes(p) \/ GreetAgain(p)

HubActs(p) ==
    \/ Resume(p) \/ Admit(p) \/ Replace(p) \/ RefuseRole(p) \/ TurnAway(p) \/ TakeAnswer(p)

Progress ==
    \/ \E p \in Peers : PeerActs(p) \/ HubActs(p)
    \/ Ask \/ ExperimentWelcomed \/ ExperimentAnswered \/ TakeRequest

Left == breaks + kills + restarts + losses

Fault ==
    /\ Breaks + Kills + Restarts + Losses - Left < Faults
    /\ RestartHub \/ \E p \in Peers : Break(p) \/ Kill(p) \/ GiveUp(p)

Next == Progress \/ Fault

Fairness ==
    /\ \A p \in Peers :
        /\ WF_vars(Connect(p)) /\ WF_vars(PlayerWelcomed(p)) /\ WF_vars(PlayerCalled(p))
        /\ WF_vars(PlayerFinishes(p)) /\ WF_vars(GreetAgain(p)) /\ WF_vars(HubActs(p))
    /\ WF_vars(Ask) /\ WF_vars(ExperimentWelcomed) /\ WF_vars(ExperimentAnswered) /\ WF_vars(TakeRequest)

Safety == Init /\ [][Next]_vars

Spec == Safety /\ Fairness

---------------------------------------------------------------------------
(* What is promised *)

\* No program carries a call out twice.
ExactlyOnce == ~twice

\* A hub begins a request once, however often it is sent.
RequestOnce == ~begunTwice

\* The hub accepts no answer to another call than the outstanding one.  The answer to the first call of a hub may
\* be one that the player gave to the same first call of an earlier hub: docs/protocol-reference.md lets it keep that answer.
NoStaleAnswer == ~stale

\* At most one call is outstanding, and only while a request is under way.
OneCall == (call # None) <=> busy

\* An episode ends void only if a player was lost in it.
VoidOnlyIfLost == outcome = "void" => lost

\* In an episode that is not void, each role was played by one program.
LostThenVoid == outcome = "done" => \A p \in Players : Cardinality(mixed[p]) <= 1

\* `resumed` true is said only to an instance that the hub has heard.
ResumedOnlyIfKnown == ~trusted

\* A request ends, one way or the other.
RequestsEnd == waiting ~> ~waiting

=============================================================================

------------------------------- MODULE Trace -------------------------------
(***************************************************************************)
(* Runs of the simulator (tests/simulation), each a behaviour of Glue: TLC  *)
(* prints the number of every run that it can follow to its end.           *)
(*                                                                         *)
(* A run begins behind RL_INIT, with every peer welcomed and heard.  What a *)
(* line does not say, such as the moment at which a peer reads a message,   *)
(* TLC chooses.  A connection breaks in the model just before the hub acts  *)
(* on its end: nothing that was under way arrives after that.              *)
(***************************************************************************)
EXTENDS Glue, TLC, Simulated  \* Runs: sequences of lines; First: the number of the last call before each

VARIABLES run, at

Line == Runs[run][at]

TraceInit ==
    /\ run \in 1..Len(Runs) /\ at = 1
    /\ hub = 1
    /\ seat = [p \in Peers |-> 1]
    /\ reached = [p \in Peers |-> TRUE]
    /\ heard = [p \in Peers |-> TRUE]
    /\ away = [p \in Peers |-> FALSE]
    /\ fresh = [p \in Players |-> FALSE]
    /\ count = First[run] /\ call = None /\ stage = 0 /\ taken = 1 /\ busy = FALSE /\ outcome = "done"
    /\ instance = [p \in Peers |-> 1]
    /\ welcomed = [p \in Peers |-> TRUE]
    /\ last = [p \in Players |-> [seq |-> First[run], hub |-> 1, by |-> 1, stage |-> Initialise]]
    /\ kept = [p \in Players |-> Nothing]
    /\ work = [p \in Players |-> Nothing]
    /\ whole = [p \in Players |-> FALSE]
    /\ request = 1 /\ waiting = FALSE /\ answered = TRUE
    /\ up = [p \in Peers |-> TRUE]
    /\ toHub = [p \in Peers |-> <<>>]
    /\ toPeer = [p \in Peers |-> <<>>]
    /\ breaks = Breaks /\ kills = Kills /\ restarts = Restarts /\ losses = Losses
    /\ carried = {} /\ twice = FALSE /\ stale = FALSE /\ lost = FALSE
    /\ mixed = [p \in Players |-> {}]
    /\ begun = {} /\ begunTwice = FALSE
    /\ met = {[role |-> p, instance |-> 1, hub |-> 1] : p \in Peers} /\ trusted = FALSE

\* What the hub knows after a line: whether a request is under way, and whether the last one ended void.
Told == busy' = Line.busy /\ (~Line.busy => (outcome' = "void") = Line.void)

Logged ==
    LET p == Line.peer IN
    \/ /\ Line.event = "welcome" /\ (Resume(p) \/ Admit(p))
       /\ seat'[p] = Line.instance
    \/ Line.event = "refuse" /\ RefuseRole(p)
    \/ Line.event = "replace" /\ Replace(p) /\ Told
    \/ Line.event = "lost" /\ GiveUp(p) /\ Told
    \/ Line.event = "request" /\ TakeRequest /\ Head(toHub[p]).n = Line.number /\ Told
    \/ Line.event = "answer" /\ TakeAnswer(p) /\ Head(toHub[p]).seq = Line.number /\ Told
    \/ Line.event = "call" /\ PlayerCalled(p) /\ work'[p].seq = Line.number
    \/ Line.event = "kill" /\ Kill(p)

\* A connection ends where the next line cannot be explained without.
Ends(p) == Line.peer = p /\ Line.event \in {"welcome", "refuse", "replace", "lost"}

Unlogged ==
    \E p \in Peers :
        \/ Ends(p) /\ toHub[p] # <<Hello(p)>> /\ Break(p)
        \/ Ends(p) /\ Connect(p)
        \/ PlayerWelcomed(p)
        \/ PlayerCalled(p) /\ work' = work
        \/ PlayerFinishes(p)
        \/ GreetAgain(p)
        \/ TurnAway(p)
        \/ p = "experiment" /\ (Ask \/ ExperimentWelcomed \/ ExperimentAnswered)

TraceNext ==
    /\ at <= Len(Runs[run])
    /\ \/ Logged /\ at' = at + 1 /\ (at' > Len(Runs[run]) => PrintT(<<"followed", run>>))
       \/ Unlogged /\ UNCHANGED at
    /\ UNCHANGED run

TraceSpec == TraceInit /\ [][TraceNext]_<<vars, run, at>>
=============================================================================

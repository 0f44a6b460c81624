"""The rules for hubs, in the order in which they are judged: each is a scene that scripted peers play."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

from glue.conform.forms import SPOILED, SPOILED_BODIES, header
from glue.conform.hubs.scripted import TASK_SPEC, Scene, ScriptedPeer, did, number, reward, saw
from glue.conform.messages import described
from glue.conform.rules import Broken, Rules, Tier
from glue.types import Action, Observation
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import (
    BESIDE,
    EXTRAS,
    MASK,
    OUTCOME,
    PROTOCOL_VERSION,
    THREE_ROLES,
    ErrorCode,
    Event,
    Kind,
    Message,
    Role,
)

RULES: Final = Rules()


@RULES.add(Tier.PLAYS, "greeting")
def greeting(scene: Scene) -> None:
    """HELLO is answered with WELCOME and the same seq."""
    # HELLO, twice, in each role.
    for seq, peer in enumerate((scene.agent, scene.environment, scene.experiment), start=5):
        version, _, heartbeat, timeout, max_body = map(number, peer.join(seq=seq).scalars)
        peer.check(version == PROTOCOL_VERSION, f"version {version:g} was chosen")
        peer.check(heartbeat > 0, f"the heartbeat is {heartbeat:g} s")
        peer.check(timeout >= heartbeat, f"the timeout is {timeout:g} s, the heartbeat {heartbeat:g} s")
        peer.check(max_body > 0, f"the largest body is {max_body:g} bytes")
        peer.join(resumed=True)  # The same HELLO over the same connection changes nothing.


@RULES.add(Tier.PLAYS, "greeting")
def heartbeat(scene: Scene) -> None:
    """Each connection gets a HEARTBEAT every heartbeat, and a peer's own is answered."""
    # A HEARTBEAT from either side.
    heartbeat = number(scene.agent.join().scalars[2])
    scene.agent.send(Kind.HEARTBEAT, seq=9)
    scene.agent.expects(Kind.HEARTBEAT, 9)
    for _ in range(2):
        scene.agent.expects(Kind.HEARTBEAT, wait=2 * heartbeat + scene.wait, session="")


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def calls(scene: Scene) -> None:
    """A request calls the players in RL-Glue's order and passes everything on unchanged."""
    # Every request that reaches the players, in the middle of episodes and between them.
    scene.begin()
    scene.step(1)
    scene.step(2, terminal=True)
    scene.start()  # The episode is abandoned without AGENT_END.
    scene.step(1)
    scene.episode(0, 3)
    scene.relay(Kind.RL_ENV_START, gives=saw(0))
    scene.relay(Kind.RL_AGENT_START, body=saw(4), gives=did(4))
    scene.relay(Kind.RL_ENV_STEP, body=did(5), reply=(0.1, False), gives=saw(6))
    scene.relay(Kind.RL_AGENT_STEP, -0.3, body=saw(7), gives=did(8))
    scene.relay(Kind.RL_AGENT_END, 1e300)
    scene.experiment.ask(Kind.RL_CLEANUP)
    scene.environment.answers(Kind.ENV_CLEANUP)
    scene.agent.answers(Kind.AGENT_CLEANUP)
    scene.experiment.expects_reply(Kind.RL_CLEANUP)


@RULES.add(Tier.PLAYS, "calls-and-how-each-happens-exactly-once")
def numbers(scene: Scene) -> None:
    """The calls of a session have growing numbers."""
    # Two experiments, one after the other.
    scene.init()
    scene.episode(0, 3)
    scene.experiment.leave()
    scene.experiment.seq = 0
    scene.experiment.join()
    scene.episode(0, 3)
    for before, call in pairwise(scene.calls):
        if call.seq <= before.seq:
            raise Broken("calls with growing numbers", f"{described(call)} after call {before.seq}")


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def counters(scene: Scene) -> None:
    """Return, steps and episodes are counted as RL-Glue counts them."""
    # RL_RETURN, RL_NUM_STEPS and RL_NUM_EPISODES, after each request.
    scene.init()
    scene.counted(0.0, 0, 0)
    scene.start()
    scene.counted(0.0, 1, 0)
    scene.step(1)
    scene.counted(reward(1), 2, 0)
    scene.step(2)
    scene.step(3, terminal=True)
    scene.counted(reward(1) + reward(2) + reward(3), 3, 1)
    scene.start()
    scene.counted(0.0, 1, 1)
    scene.episode(0, 2)
    scene.counted(reward(1) + reward(2), 2, 2)
    scene.initialise()
    scene.counted(0.0, 0, 0)


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def cutoff(scene: Scene) -> None:
    """RL_EPISODE ends at its limit of steps, without AGENT_END, and is not counted."""
    # RL_EPISODE with each limit around the episode's length.
    scene.init()
    ended = 0
    for limit in (1, 2, 3, 4, 5, 0):
        scene.episode(limit, 3)
        last = 3 if limit == 0 else min(3, limit - 1)
        ended += last == 3
        scene.counted(sum(map(reward, range(1, last + 1))), min(last + 1, 3), ended)


@RULES.add(Tier.COMPLETE, "capabilities")
def outcome(scene: Scene) -> None:
    """RL_EPISODE's reply tells return and steps only to an experiment with the capability outcome."""
    # RL_EPISODE of an experiment with the capability `outcome`, which an older hub does not know.
    scene.experiment = scene.peer(Role.EXPERIMENT, OUTCOME)
    scene.init()
    for limit, length in ((0, 3), (2, 3)):
        ended = scene.played(limit, length)
        message = scene.experiment.expects(Kind.RL_EPISODE, scene.experiment.seq)
        steps = length if ended else limit
        told = ended, sum(map(reward, range(1, steps + ended))), steps
        scene.experiment.check(
            message.scalars in (told, told[:1]), f"{described(message)} received, and the outcome is {told}"
        )
        scene.counted(*told[1:], 1)


@RULES.add(Tier.COMPLETE, "an-environment-that-does-not-wait")
def pace(scene: Scene) -> None:
    """A late agent is called again only when it has answered, with all rewards since; its answer counts."""
    # An episode of an agent with the capability `pace`, which answers the first step after the third.
    scene.agent, scene.experiment = (scene.peer(role, "pace") for role in (Role.AGENT, Role.EXPERIMENT))
    scene.begin()
    number = scene.first_step()
    scene.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
    late = scene.agent.expects(Kind.AGENT_STEP)
    told = [value for value in late.scalars if isinstance(value, float) and value >= 0]
    scene.agent.check(
        late.scalars[:1] == (reward(1),) and len(late.scalars) in (1, 3) and late.body == saw(1),
        f"{described(late)} received, and the reward is {reward(1)}",
    )
    if len(late.scalars) == 1:  # this hub waits for its agents
        scene.agent.send(Kind.AGENT_STEP, seq=late.seq, body=did(1))
        scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
        return
    scene.agent.check(len(told) >= 2, f"{described(late)} received, with a time before now")
    for step in (2, 3):
        _step_of_late_agent(scene, step)
    scene.agent.expects_nothing()
    scene.agent.send(Kind.AGENT_STEP, seq=late.seq, body=did(1))
    newest = scene.agent.expects(Kind.AGENT_STEP)
    sums = reward(2) + reward(3)
    scene.agent.check(
        newest.scalars[0] == sums and newest.body == saw(3),
        f"{described(newest)} received, and the rewards since the answered observation are {sums}",
    )
    # Step 4 may have been due before that answer came.
    actions = _step_of_late_agent(scene, 4), _step_of_late_agent(scene, 5, terminal=True)
    scene.experiment.check(did(1) in actions, "two steps have not carried out the answer of the late agent")
    scene.agent.expects_nothing()
    scene.agent.send(Kind.AGENT_STEP, seq=newest.seq, body=did(3))
    scene.agent.answers(Kind.AGENT_END, reward(4) + reward(5))
    scene.experiment.expects_reply(Kind.RL_STEP, reward(5), True, body=saw(5) + actions[1])


def _step_of_late_agent(scene: Scene, step: int, terminal: bool = False) -> bytes:
    """Carry out step `step` as soon as it is due, which ends RL_STEP before it; return its action."""
    action = scene.experiment.expects(Kind.RL_STEP, scene.experiment.seq).body[len(saw(step)) :]
    scene.experiment.ask(Kind.RL_NUM_STEPS)
    counts = scene.experiment.expects(Kind.RL_NUM_STEPS, scene.experiment.seq)
    scene.experiment.check(
        counts.scalars in ((step,), (step, step - 1)),
        f"{described(counts)} received; {step - 1} actions were late",
    )
    scene.experiment.ask(Kind.RL_STEP)
    scene.environment.answers(Kind.ENV_STEP, body=action, reply=(reward(step), terminal), gives=saw(step))
    return action


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def last_action(scene: Scene) -> None:
    """RL_STEP executes the last action, also past the end of an episode."""
    # RL_STEP before any start, and past the end.
    scene.init()
    nothing = Action().body
    scene.experiment.ask(Kind.RL_STEP)  # Before any start: the empty action.
    scene.environment.answers(Kind.ENV_STEP, body=nothing, reply=(0.0, True), gives=saw(1))
    scene.agent.answers(Kind.AGENT_END, 0.0)
    scene.experiment.expects_reply(Kind.RL_STEP, 0.0, True, body=saw(1) + nothing)
    scene.start()
    scene.step(1)
    for _ in range(2):
        scene.step(2, terminal=True)
    scene.experiment.gets(Kind.RL_NUM_EPISODES, 3)


@RULES.add(Tier.PLAYS, "what-the-calls-mean")
def messages(scene: Scene) -> None:
    """Messages reach the players at any time, even before RL_INIT, and their answers come back."""
    # Messages before RL_INIT: empty, long, with zero bytes.
    scene.gather()
    texts = {b"": b"nothing?", ("größer\n" * 50).encode(): b"", b"a\0b": b"c\0d"}
    for request in (Kind.RL_AGENT_MESSAGE, Kind.RL_ENV_MESSAGE):
        for text, answer in texts.items():
            scene.relay(request, body=text, gives=answer)


@RULES.add(Tier.COMPLETE, "greeting")
def version(scene: Scene) -> None:
    """A peer that speaks no version of the hub's is refused with version."""
    # HELLO with an unknown version, alone and with a known one.
    scene.agent.hello(versions=(PROTOCOL_VERSION + 98,), seq=3)
    _refused(scene.agent, ErrorCode.VERSION, 3)
    scene.environment.hello(versions=(PROTOCOL_VERSION + 98, PROTOCOL_VERSION))
    scene.environment.expects(Kind.WELCOME)


@RULES.add(Tier.COMPLETE, "breaks-replacements-and-void-episodes")
def role_taken(scene: Scene) -> None:
    """A second peer in a role is refused with role-taken, and the first stays."""
    # A second peer in each role, while the first plays.
    scene.init()
    for role in THREE_ROLES:
        second = scene.peer(role)
        second.hello()
        _refused(second, ErrorCode.ROLE_TAKEN, 0)
    scene.episode(0, 2)


@RULES.add(Tier.SURVIVES, "errors")
def unknown_peer(scene: Scene) -> None:
    """A connection without a HELLO gets the error unknown-peer."""
    # A message over a connection without a HELLO, and from a known instance over a new connection.
    for seq, peer in enumerate((scene.agent, scene.environment, scene.experiment), start=5):
        peer.send(Kind.HEARTBEAT, seq=seq)
        peer.expects_error(ErrorCode.UNKNOWN_PEER, seq)
    scene.init()
    scene.agent.connect()
    scene.agent.send(Kind.HEARTBEAT, seq=1)
    scene.agent.expects_error(ErrorCode.UNKNOWN_PEER, 1)


@RULES.add(Tier.COMPLETE, "capabilities")
def seed(scene: Scene) -> None:
    """Players with the capability seed are given numbers made from the seed, others are passed over."""
    # RL_INIT with a seed, for an environment that takes one and an agent that does not.
    scene.environment = scene.peer(Role.ENVIRONMENT, "seed", "a capability that nobody knows")
    scene.gather()
    given = []
    for seed in (2026, 2026, 7):
        scene.experiment.ask(Kind.RL_INIT, seed)
        call = scene.environment.expects(Kind.ENV_SEED)
        scene.environment.send(Kind.ENV_SEED, seq=call.seq)
        scene.initialised()
        given.append(call.scalars)
    same, different = given[0] == given[1], given[1] != given[2]
    scene.environment.check(same and different, f"{given} received for the seeds 2026, 2026, 7")
    scene.initialise()


@RULES.add(Tier.COMPLETE, "capabilities")
def unsupported(scene: Scene) -> None:
    """Save and load reach players with the capability save; for others the error is unsupported."""
    # Save and load, for an environment that can and an agent that cannot.
    scene.environment = scene.peer(Role.ENVIRONMENT, "save")
    scene.init()
    saved = bytes(range(256))
    scene.relay(Kind.RL_ENV_SAVE, gives=saved)
    scene.relay(Kind.RL_ENV_LOAD, body=saved)
    for kind in (Kind.RL_AGENT_SAVE, Kind.RL_AGENT_LOAD):
        scene.experiment.ask(kind, body=saved)
        scene.experiment.expects_error(ErrorCode.UNSUPPORTED, scene.experiment.seq)
    scene.episode(0, 2)


@RULES.add(Tier.COMPLETE, "overview")
def sessions(scene: Scene) -> None:
    """One connection may take part in several sessions, and none disturbs another."""
    # An agent in two sessions over one connection; one continues while the other waits.
    scene.begin()
    names = scene.session, f"{scene.session}-{'🏃' * 200}"  # of over 800 bytes
    second = scene.peer(Role.EXPERIMENT)
    second.session = scene.agent.session = names[1]
    second.join()
    scene.agent.join()
    scene.experiment.ask(Kind.RL_STEP)  # It stays under way while the other session continues.
    second.ask(Kind.RL_AGENT_MESSAGE, body=b"two")
    call = scene.agent.expects(Kind.AGENT_MESSAGE)
    scene.agent.send(Kind.AGENT_MESSAGE, seq=call.seq, body=call.body)
    second.expects_reply(Kind.RL_AGENT_MESSAGE, body=b"two")
    scene.agent.leave()
    second.expects_notice(Event.LOST, Role.AGENT)
    scene.agent.session = names[0]
    scene.stepped(1)
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))


@RULES.add(Tier.COMPLETE, "calls-and-how-each-happens-exactly-once")
def busy(scene: Scene) -> None:
    """A request while another is under way gets the error busy, and is not carried out."""
    # A request in the middle of another.
    scene.init()
    scene.experiment.ask(Kind.RL_START)
    under_way = scene.experiment.seq
    scene.experiment.ask(Kind.RL_CLEANUP)
    scene.experiment.expects_error(ErrorCode.BUSY, scene.experiment.seq)
    scene.started()
    scene.experiment.expects(Kind.RL_START, under_way)
    scene.step(1)


@RULES.add(Tier.SURVIVES, "calls-and-how-each-happens-exactly-once")
def repeated(scene: Scene) -> None:
    """A repeated message changes nothing."""
    # A request and an answer sent twice, and a request after its reply.
    scene.begin()
    scene.experiment.ask(Kind.RL_STEP)
    scene.experiment.send(Kind.RL_STEP, seq=scene.experiment.seq)
    number = scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    scene.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
    scene.finish_first_step(number)
    scene.experiment.send(Kind.RL_STEP, seq=scene.experiment.seq)
    for peer in (scene.experiment, scene.environment, scene.agent):
        peer.expects_nothing()
    scene.counted(reward(1), 2, 0)
    scene.step(2)


@RULES.add(Tier.COMPLETE, "errors")
def not_asked(scene: Scene) -> None:
    """A message that a peer may not send gets the error not-asked, and changes nothing."""
    # A player's call from the experiment, an answer to no call, an answer in another's turn.
    scene.begin()
    scene.experiment.seq += 1
    scene.experiment.send(Kind.AGENT_STEP, seq=scene.experiment.seq, body=did(9))
    scene.experiment.expects_error(ErrorCode.NOT_ASKED, scene.experiment.seq)
    scene.agent.send(Kind.AGENT_STEP, seq=10**6, body=did(9))
    scene.agent.expects_error(ErrorCode.NOT_ASKED, 10**6)
    number = scene.first_step()
    scene.agent.send(Kind.ENV_STEP, 100.0, True, seq=number, body=saw(9))  # It is not the agent's turn.
    scene.agent.expects_error(ErrorCode.NOT_ASKED, number)
    scene.finish_first_step(number)
    scene.counted(reward(1), 2, 0)


@RULES.add(Tier.COMPLETE, "errors")
def unknown_kind(scene: Scene) -> None:
    """An unknown kind gets the error unknown-kind, and changes nothing."""
    # A kind that does not exist, from each role.
    scene.begin()
    for peer in (scene.agent, scene.environment, scene.experiment):
        peer.send_frames([header(63, peer.session, 5, [])])
        peer.expects_error(ErrorCode.UNKNOWN_KIND, 5)
    scene.step(1)


@RULES.add(Tier.COMPLETE, "errors")
def exception(scene: Scene) -> None:
    """A player's exception ends the request with peer-failed, and the player stays."""
    # A player fails in a call, and continues.
    scene.begin()
    number = scene.first_step()
    scene.environment.send(Kind.ERROR, "exception", "division by zero", seq=number)
    scene.experiment.expects_error(ErrorCode.PEER_FAILED, scene.experiment.seq)
    scene.episode(0, 2)


@RULES.add(Tier.COMPLETE, "errors")
def malformed(scene: Scene) -> None:
    """A malformed message gets the error malformed, and costs only its sender its place."""
    # Malformed bytes from an unknown peer, and answers malformed in each way that calls to clients are.
    scene.begin()
    unknown = scene.peer(Role.AGENT)
    unknown.send_frames([b"\xc1"])
    unknown.expects_error(ErrorCode.MALFORMED, 0, session="")
    scene.step(1)
    for change in (*SPOILED.values(), *SPOILED_BODIES.values()):
        scene.experiment.ask(Kind.RL_STEP)
        number = scene.environment.expects_call(Kind.ENV_STEP, body=did(1))
        answer = Message(Kind.ENV_STEP, scene.session, number, (0.0, False), saw(2))
        scene.environment.send_frames(change(encode(answer, TO_HUB)))
        scene.environment.expects_error(ErrorCode.MALFORMED, 0, session="")
        scene.experiment.expects_error(ErrorCode.PEER_FAILED, scene.experiment.seq)
        scene.experiment.expects_notice(Event.LOST, Role.ENVIRONMENT)
        scene.environment.send(Kind.HEARTBEAT, seq=4)
        scene.environment.expects_error(ErrorCode.UNKNOWN_PEER, 4)
        scene.environment.join(resumed=True)
        scene.episode(0, 2)
        scene.start()
        scene.step(1)


@RULES.add(Tier.SURVIVES, "breaks-replacements-and-void-episodes")
def resumed(scene: Scene) -> None:
    """An instance that returns over a new connection continues where it was."""
    # Environment and experiment come back over new connections in the middle of a step.
    scene.begin()
    number = scene.first_step()
    scene.environment.rejoin()
    again = scene.environment.expects(Kind.ENV_STEP)
    scene.environment.check(
        (again.seq, again.body) == (number, did(0)), f"{described(again)} received instead of call {number}"
    )
    scene.finish_first_step(number)
    scene.experiment.rejoin()
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
    scene.step(2)
    scene.counted(reward(1) + reward(2), 3, 0)


@RULES.add(Tier.SURVIVES, "greeting")
def welcome_lost(scene: Scene) -> None:
    """An instance is unknown until it has sent a request or an answer."""
    # Each peer's first connections end before it has sent anything with a number.
    for peer in (scene.experiment, scene.agent, scene.environment):
        for _ in range(2):
            peer.rejoin(resumed=False)
            peer.join(resumed=True)
    scene.experiment.ask(Kind.RL_INIT, None)
    number = scene.environment.expects_call(Kind.ENV_INIT)
    scene.environment.rejoin(resumed=False)
    again = scene.environment.expects(Kind.ENV_INIT)
    scene.environment.check(again.seq == number, f"{described(again)} received instead of call {number}")
    scene.environment.send(Kind.ENV_INIT, seq=number, body=TASK_SPEC.encode())
    scene.agent.answers(Kind.AGENT_INIT, body=TASK_SPEC.encode())
    scene.experiment.expects_reply(Kind.RL_INIT, body=TASK_SPEC.encode())
    for peer in (scene.experiment, scene.agent, scene.environment):
        peer.rejoin()


@RULES.add(Tier.PLAYS, "greeting")
def goodbye(scene: Scene) -> None:
    """GOODBYE frees a role at once, and the experiment's ends players that offered one-run."""
    # An agent leaves, then the experiment; an environment offers one-run.
    scene.environment = scene.peer(Role.ENVIRONMENT, "one-run")
    scene.init()
    scene.agent.leave()
    scene.experiment.expects_notice(Event.LOST, Role.AGENT)
    scene.peer(Role.AGENT).join()
    scene.experiment.leave()
    scene.environment.expects(Kind.GOODBYE)
    second = scene.peer(Role.EXPERIMENT)
    second.join()
    second.gets(Kind.RL_NUM_EPISODES, 0)


@RULES.add(Tier.SURVIVES, "breaks-replacements-and-void-episodes")
def lost(scene: Scene) -> None:
    """A player that leaves in mid-episode makes it void: NOTICE lost, error peer-lost."""
    # An agent leaves in the middle of a step, and comes back.
    scene.init()
    scene.episode(0, 2)
    scene.start()
    scene.step(1)
    scene.experiment.ask(Kind.RL_STEP)
    scene.environment.answers(Kind.ENV_STEP, body=did(1), reply=(0.0, False), gives=saw(2))
    scene.agent.expects_call(Kind.AGENT_STEP, 0.0, body=saw(2))
    scene.agent.leave()
    scene.experiment.expects_error(ErrorCode.PEER_LOST, scene.experiment.seq)
    scene.experiment.expects_notice(Event.LOST, Role.AGENT)
    for kind in (Kind.RL_STEP, Kind.RL_ENV_STEP, Kind.RL_AGENT_START):
        scene.experiment.ask(kind, body=did(1))
        scene.experiment.expects_error(ErrorCode.PEER_LOST, scene.experiment.seq)
    scene.experiment.gets(Kind.RL_NUM_EPISODES, 1)
    scene.agent.join(resumed=True)
    scene.experiment.expects_notice(Event.RETURNED, Role.AGENT)
    scene.episode(0, 2)
    scene.experiment.gets(Kind.RL_NUM_EPISODES, 2)


@RULES.add(Tier.SURVIVES, "breaks-replacements-and-void-episodes")
def silent(scene: Scene) -> None:
    """A player whose connection ended is lost after `timeout`."""
    # An environment's connection ends without GOODBYE.
    scene.begin()
    heartbeat, timeout = map(number, scene.agent.join(resumed=True).scalars[2:4])
    scene.first_step()
    scene.environment.vanish()
    scene.wait += timeout + 2 * heartbeat
    scene.experiment.expects_error(ErrorCode.PEER_LOST, scene.experiment.seq)
    scene.experiment.expects_notice(Event.LOST, Role.ENVIRONMENT)


@RULES.add(Tier.SURVIVES, "breaks-replacements-and-void-episodes")
def replaced(scene: Scene) -> None:
    """A new player is initialised before its first other call, and announced."""
    # New peers take the roles of environment and agent.
    scene.init()
    scene.environment.leave()
    scene.experiment.expects_notice(Event.LOST, Role.ENVIRONMENT)
    scene.experiment.ask(Kind.RL_START)  # It waits until the role is filled.
    scene.environment = scene.peer(Role.ENVIRONMENT)
    scene.environment.join()
    scene.experiment.expects_notice(Event.JOINED, Role.ENVIRONMENT)
    scene.environment.answers(Kind.ENV_INIT, gives=TASK_SPEC.encode())
    scene.started()
    scene.experiment.expects_reply(Kind.RL_START, body=saw(0) + did(0))
    scene.agent.leave()
    scene.agent = scene.peer(Role.AGENT)
    scene.agent.join()
    scene.experiment.expects_notice(Event.JOINED, Role.AGENT)
    scene.experiment.ask(Kind.RL_EPISODE, 1)
    scene.environment.answers(Kind.ENV_START, gives=saw(0))
    scene.agent.answers(Kind.AGENT_INIT, body=TASK_SPEC.encode())
    scene.agent.answers(Kind.AGENT_START, body=saw(0), gives=did(0))
    scene.experiment.expects_reply(Kind.RL_EPISODE, False)


def _refused(peer: ScriptedPeer, code: ErrorCode, seq: int) -> None:
    refuse = peer.expects(Kind.REFUSE, seq)
    peer.check(refuse.scalars[0] == code, f"{described(refuse)} received instead of the code {code}")


@RULES.add(Tier.COMPLETE, "beside-the-observation")
def beside(scene: Scene) -> None:
    """A mask reaches peers that offer mask, extras those that offer extras, and never an agent."""
    # An environment that sends both, an agent that reads masks, then one that reads none.
    scene.environment = scene.peer(Role.ENVIRONMENT, MASK, EXTRAS)
    scene.experiment = scene.peer(Role.EXPERIMENT, MASK, EXTRAS)
    confirmed = scene.environment.join().scalars[5:]
    if not confirmed:
        return  # an older hub
    known = isinstance(confirmed[0], tuple) and {*confirmed[0]} == BESIDE
    scene.environment.check(known, f"{confirmed!r} was confirmed to one that offers mask and extras")
    scene.agent = scene.peer(Role.AGENT, MASK)
    confirmed = scene.agent.join().scalars[5:]
    scene.agent.check(confirmed == ((MASK,),), f"{confirmed!r} was confirmed to an agent that offers mask")
    scene.experiment.join()
    scene.initialise()
    _play_beside(scene, masked=Observation([7], mask=[True, False, True]).body)
    scene.agent.leave()
    scene.experiment.expects_notice(Event.LOST, Role.AGENT)
    scene.agent = scene.peer(Role.AGENT)
    confirmed = scene.agent.join().scalars[5:]
    scene.agent.check(not confirmed, f"{confirmed!r} was confirmed to an agent that offers nothing")
    scene.initialise()
    _play_beside(scene, masked=Observation([7]).body)


@RULES.add(Tier.COMPLETE, "beside-the-observation")
def unoffered(scene: Scene) -> None:
    """An environment that sends extras or a mask without offering them has failed."""
    # Extras from an environment that offers masks.
    scene.environment = scene.peer(Role.ENVIRONMENT, MASK)
    if not scene.environment.join().scalars[5:]:
        return  # an older hub
    scene.agent.join()
    scene.experiment.join()
    scene.initialise()
    scene.experiment.ask(Kind.RL_ENV_START)
    call = scene.environment.expects_call(Kind.ENV_START)
    scene.environment.send(Kind.ENV_START, seq=call, body=Observation([7], extras={"a": 1}).body)
    scene.experiment.expects_error(ErrorCode.PEER_FAILED, scene.experiment.seq)
    scene.environment.expects_error(ErrorCode.UNSUPPORTED, call)


def _play_beside(scene: Scene, masked: bytes) -> None:
    """Play a start, a step and half steps; the agent sees `masked` of observations with a mask and extras."""
    full = Observation([7], mask=[True, False, True], extras={"coins": 3, "x": 0.5}).body
    agent, environment, experiment = scene.agent, scene.environment, scene.experiment
    experiment.ask(Kind.RL_START)
    environment.answers(Kind.ENV_START, gives=full)
    agent.answers(Kind.AGENT_START, body=masked, gives=did(0))
    experiment.expects_reply(Kind.RL_START, body=full + did(0))
    experiment.ask(Kind.RL_STEP)
    environment.answers(Kind.ENV_STEP, body=did(0), reply=(reward(1), False), gives=full)
    agent.answers(Kind.AGENT_STEP, reward(1), body=masked, gives=did(1))
    experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=full + did(1))
    scene.relay(Kind.RL_ENV_STEP, body=did(2), reply=(reward(2), False), gives=full)
    experiment.ask(Kind.RL_AGENT_STEP, reward(2), body=full)
    agent.answers(Kind.AGENT_STEP, reward(2), body=masked, gives=did(3))
    experiment.expects_reply(Kind.RL_AGENT_STEP, body=did(3))

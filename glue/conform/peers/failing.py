"""Scenes of failures: peers that err, fail, repeat messages, leave and return.

Each scene is a function; `glue.conform.peers.checking` has its rule.
"""

from __future__ import annotations

from glue.conform.hub.comparing import shown
from glue.conform.peers.scripted import TASK_SPEC, Scene, did, number, reward, saw
from glue.conform.scenes.forms import SPOILED, SPOILED_BODIES
from glue.wire.codec import TO_HUB, encode
from glue.wire.messages import ErrorCode, Event, Kind, Message, Role


def unknown_peer(scene: Scene) -> None:
    """A message over a connection without a HELLO, and from a known instance over a new connection."""
    for seq, peer in enumerate((scene.agent, scene.environment, scene.experiment), start=5):
        peer.send(Kind.HEARTBEAT, seq=seq)
        peer.expects_error(ErrorCode.UNKNOWN_PEER, seq)
    scene.init()
    scene.agent.connect()
    scene.agent.send(Kind.HEARTBEAT, seq=1)
    scene.agent.expects_error(ErrorCode.UNKNOWN_PEER, 1)


def busy(scene: Scene) -> None:
    """A request in the middle of another."""
    scene.init()
    scene.experiment.ask(Kind.RL_START)
    under_way = scene.experiment.seq
    scene.experiment.ask(Kind.RL_CLEANUP)
    scene.experiment.expects_error(ErrorCode.BUSY, scene.experiment.seq)
    scene.started()
    scene.experiment.expects(Kind.RL_START, under_way)
    scene.step(1)


def repeated(scene: Scene) -> None:
    """A request and an answer sent twice, and a request after its reply."""
    scene.init()
    scene.start()
    scene.experiment.ask(Kind.RL_STEP)
    scene.experiment.send(Kind.RL_STEP, seq=scene.experiment.seq)
    number = scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    for _ in range(2):
        scene.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
    scene.agent.answers(Kind.AGENT_STEP, reward(1), body=saw(1), gives=did(1))
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
    scene.experiment.send(Kind.RL_STEP, seq=scene.experiment.seq)
    for peer in (scene.experiment, scene.environment, scene.agent):
        peer.expects_nothing()
    scene.counted(reward(1), 2, 0)
    scene.step(2)


def not_asked(scene: Scene) -> None:
    """A player's call from the experiment, an answer to no call, an answer in another's turn."""
    scene.init()
    scene.start()
    scene.experiment.seq += 1
    scene.experiment.send(Kind.AGENT_STEP, seq=scene.experiment.seq, body=did(9))
    scene.experiment.expects_error(ErrorCode.NOT_ASKED, scene.experiment.seq)
    scene.agent.send(Kind.AGENT_STEP, seq=10**6, body=did(9))
    scene.agent.expects_error(ErrorCode.NOT_ASKED, 10**6)
    scene.experiment.ask(Kind.RL_STEP)
    number = scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    scene.agent.send(Kind.ENV_STEP, 100.0, True, seq=number, body=saw(9))  # It is not the agent's turn.
    scene.agent.expects_error(ErrorCode.NOT_ASKED, number)
    scene.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
    scene.agent.answers(Kind.AGENT_STEP, reward(1), body=saw(1), gives=did(1))
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
    scene.counted(reward(1), 2, 0)


def unknown_kind(scene: Scene) -> None:
    """A kind that does not exist, from each role."""
    scene.init()
    scene.start()
    for peer in (scene.agent, scene.environment, scene.experiment):
        peer.send_frames([_unknown(peer.session)])
        peer.expects_error(ErrorCode.UNKNOWN_KIND, 5)
    scene.step(1)


def _unknown(session: str) -> bytes:
    """Return a header of kind 63, which does not exist, and number 5: the array [63, session, 5]."""
    name = session.encode()
    return bytes([0x93, 63, 0xD9, len(name), *name, 5])


def exception(scene: Scene) -> None:
    """A player fails in a call, and continues."""
    scene.init()
    scene.start()
    scene.experiment.ask(Kind.RL_STEP)
    number = scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    scene.environment.send(Kind.ERROR, "exception", "division by zero", seq=number)
    scene.experiment.expects_error(ErrorCode.PEER_FAILED, scene.experiment.seq)
    scene.episode(0, 2)


def malformed(scene: Scene) -> None:
    """Malformed bytes from an unknown peer, and answers malformed in each way that calls to clients are."""
    scene.init()
    scene.start()
    unknown = scene.peer(Role.AGENT)
    unknown.send_frames([b"\xc1"])
    unknown.expects_malformed()
    scene.step(1)
    for change in (*SPOILED.values(), *SPOILED_BODIES.values()):
        scene.experiment.ask(Kind.RL_STEP)
        number = scene.environment.expects_call(Kind.ENV_STEP, body=did(1))
        answer = Message(Kind.ENV_STEP, scene.session, number, (0.0, False), saw(2))
        scene.environment.send_frames(change(encode(answer, TO_HUB)))
        scene.environment.expects_malformed()
        scene.experiment.expects_error(ErrorCode.PEER_FAILED, scene.experiment.seq)
        scene.experiment.expects_notice(Event.LOST, Role.ENVIRONMENT)
        scene.environment.send(Kind.HEARTBEAT, seq=4)
        scene.environment.expects_error(ErrorCode.UNKNOWN_PEER, 4)
        scene.environment.join(resumed=True)
        scene.episode(0, 2)
        scene.start()
        scene.step(1)


def resumed(scene: Scene) -> None:
    """Environment and experiment come back over new connections in the middle of a step."""
    scene.init()
    scene.start()
    scene.experiment.ask(Kind.RL_STEP)
    number = scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    scene.environment.connect()
    scene.environment.join(resumed=True)
    again = scene.environment.expects(Kind.ENV_STEP)
    scene.environment.check(
        (again.seq, again.body) == (number, did(0)), f"{shown(again)} received instead of call {number}"
    )
    scene.environment.send(Kind.ENV_STEP, reward(1), False, seq=number, body=saw(1))
    scene.agent.answers(Kind.AGENT_STEP, reward(1), body=saw(1), gives=did(1))
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
    scene.experiment.connect()
    scene.experiment.join(resumed=True)
    scene.experiment.expects_reply(Kind.RL_STEP, reward(1), False, body=saw(1) + did(1))
    scene.step(2)
    scene.counted(reward(1) + reward(2), 3, 0)


def welcome_lost(scene: Scene) -> None:
    """Each peer's first connections end before it has sent anything with a number."""
    for peer in (scene.experiment, scene.agent, scene.environment):
        for _ in range(2):
            peer.connect()
            peer.join(resumed=False)
            peer.join(resumed=True)
    scene.experiment.ask(Kind.RL_INIT, None)
    number = scene.environment.expects_call(Kind.ENV_INIT)
    scene.environment.connect()
    scene.environment.join(resumed=False)
    again = scene.environment.expects(Kind.ENV_INIT)
    scene.environment.check(again.seq == number, f"{shown(again)} received instead of call {number}")
    scene.environment.send(Kind.ENV_INIT, seq=number, body=TASK_SPEC.encode())
    scene.agent.answers(Kind.AGENT_INIT, body=TASK_SPEC.encode())
    scene.experiment.expects_reply(Kind.RL_INIT, body=TASK_SPEC.encode())
    for peer in (scene.experiment, scene.agent, scene.environment):
        peer.connect()
        peer.join(resumed=True)


def lost(scene: Scene) -> None:
    """An agent leaves in the middle of a step, and comes back."""
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


def silent(scene: Scene) -> None:
    """An environment's connection ends without GOODBYE."""
    scene.init()
    scene.start()
    heartbeat, timeout = map(number, scene.agent.join(resumed=True).scalars[2:4])
    scene.experiment.ask(Kind.RL_STEP)
    scene.environment.expects_call(Kind.ENV_STEP, body=did(0))
    scene.environment.vanish()
    scene.wait += timeout + 2 * heartbeat
    scene.experiment.expects_error(ErrorCode.PEER_LOST, scene.experiment.seq)
    scene.experiment.expects_notice(Event.LOST, Role.ENVIRONMENT)


def replaced(scene: Scene) -> None:
    """New peers take the roles of environment and agent."""
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

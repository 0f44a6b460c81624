"""Scenes of a hub's usual work: greetings, episodes, counters, sessions.

Each scene is a function; `glue.conform.peers.checking` has its rule.
"""

from __future__ import annotations

from itertools import pairwise

from glue.conform.hub.comparing import shown
from glue.conform.hub.rules import Broken
from glue.conform.peers.scripted import Scene, ScriptedPeer, did, number, reward, saw
from glue.types import Action
from glue.wire.messages import OUTCOME, PROTOCOL_VERSION, THREE_ROLES, ErrorCode, Event, Kind, Role


def greeting(scene: Scene) -> None:
    """HELLO, twice, in each role."""
    for seq, peer in enumerate((scene.agent, scene.environment, scene.experiment), start=5):
        version, _, heartbeat, timeout, max_body = map(number, peer.join(seq=seq).scalars)
        peer.check(version == PROTOCOL_VERSION, f"version {version:g} was chosen")
        peer.check(heartbeat > 0, f"the heartbeat is {heartbeat:g} s")
        peer.check(timeout >= heartbeat, f"the timeout is {timeout:g} s, the heartbeat {heartbeat:g} s")
        peer.check(max_body > 0, f"the largest body is {max_body:g} bytes")
        peer.join(resumed=True)  # The same HELLO over the same connection changes nothing.


def version(scene: Scene) -> None:
    """HELLO with an unknown version, alone and with a known one."""
    scene.agent.hello(versions=(PROTOCOL_VERSION + 98,), seq=3)
    _refused(scene.agent, ErrorCode.VERSION, 3)
    scene.environment.hello(versions=(PROTOCOL_VERSION + 98, PROTOCOL_VERSION))
    scene.environment.expects(Kind.WELCOME)


def role_taken(scene: Scene) -> None:
    """A second peer in each role, while the first plays."""
    scene.init()
    for role in THREE_ROLES:
        second = scene.peer(role)
        second.hello()
        _refused(second, ErrorCode.ROLE_TAKEN, 0)
    scene.episode(0, 2)


def heartbeat(scene: Scene) -> None:
    """A HEARTBEAT from either side."""
    heartbeat = number(scene.agent.join().scalars[2])
    scene.agent.send(Kind.HEARTBEAT, seq=9)
    scene.agent.expects(Kind.HEARTBEAT, 9)
    for _ in range(2):
        scene.agent.expects(Kind.HEARTBEAT, wait=2 * heartbeat + scene.wait, session="")


def calls(scene: Scene) -> None:
    """Every request that reaches the players, in the middle of episodes and between them."""
    scene.init()
    scene.start()
    scene.step(1)
    scene.step(2, terminal=True)
    scene.start()  # The episode is abandoned without AGENT_END.
    scene.step(1)
    scene.episode(0, 3)
    scene.experiment.ask(Kind.RL_ENV_START)
    scene.environment.answers(Kind.ENV_START, gives=saw(0))
    scene.experiment.expects_reply(Kind.RL_ENV_START, body=saw(0))
    scene.experiment.ask(Kind.RL_AGENT_START, body=saw(4))
    scene.agent.answers(Kind.AGENT_START, body=saw(4), gives=did(4))
    scene.experiment.expects_reply(Kind.RL_AGENT_START, body=did(4))
    scene.experiment.ask(Kind.RL_ENV_STEP, body=did(5))
    scene.environment.answers(Kind.ENV_STEP, body=did(5), reply=(0.1, False), gives=saw(6))
    scene.experiment.expects_reply(Kind.RL_ENV_STEP, 0.1, False, body=saw(6))
    scene.experiment.ask(Kind.RL_AGENT_STEP, -0.3, body=saw(7))
    scene.agent.answers(Kind.AGENT_STEP, -0.3, body=saw(7), gives=did(8))
    scene.experiment.expects_reply(Kind.RL_AGENT_STEP, body=did(8))
    scene.experiment.ask(Kind.RL_AGENT_END, 1e300)
    scene.agent.answers(Kind.AGENT_END, 1e300)
    scene.experiment.expects_reply(Kind.RL_AGENT_END)
    scene.experiment.ask(Kind.RL_CLEANUP)
    scene.environment.answers(Kind.ENV_CLEANUP)
    scene.agent.answers(Kind.AGENT_CLEANUP)
    scene.experiment.expects_reply(Kind.RL_CLEANUP)


def numbers(scene: Scene) -> None:
    """Two experiments, one after the other."""
    scene.init()
    scene.episode(0, 3)
    scene.experiment.leave()
    scene.experiment.seq = 0
    scene.experiment.join()
    scene.episode(0, 3)
    for before, call in pairwise(scene.calls):
        if call.seq <= before.seq:
            raise Broken("calls with growing numbers", f"{shown(call)} after call {before.seq}")


def counters(scene: Scene) -> None:
    """RL_RETURN, RL_NUM_STEPS and RL_NUM_EPISODES, after each request."""
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
    scene.experiment.ask(Kind.RL_INIT, None)
    scene.environment.answers(Kind.ENV_INIT)
    scene.agent.answers(Kind.AGENT_INIT)
    scene.experiment.expects_reply(Kind.RL_INIT)
    scene.counted(0.0, 0, 0)


def cutoff(scene: Scene) -> None:
    """RL_EPISODE with each limit around the episode's length."""
    scene.init()
    ended = 0
    for limit in (1, 2, 3, 4, 5, 0):
        scene.episode(limit, 3)
        last = 3 if limit == 0 else min(3, limit - 1)
        ended += last == 3
        scene.counted(sum(map(reward, range(1, last + 1))), min(last + 1, 3), ended)


def outcome(scene: Scene) -> None:
    """RL_EPISODE of an experiment with the capability `outcome`, which an older hub does not know."""
    scene.experiment = scene.peer(Role.EXPERIMENT, OUTCOME)
    scene.init()
    for limit, length in ((0, 3), (2, 3)):
        ended = scene.played(limit, length)
        message = scene.experiment.expects(Kind.RL_EPISODE, scene.experiment.seq)
        steps = length if ended else limit
        told = ended, sum(map(reward, range(1, steps + ended))), steps
        scene.experiment.check(
            message.scalars in (told, told[:1]), f"{shown(message)} received, and the outcome is {told}"
        )
        scene.counted(*told[1:], 1)


def last_action(scene: Scene) -> None:
    """RL_STEP before any start, and past the end."""
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


def messages(scene: Scene) -> None:
    """Messages before RL_INIT: empty, long, with zero bytes."""
    scene.gather()
    texts = {b"": b"nothing?", ("größer\n" * 50).encode(): b"", b"a\0b": b"c\0d"}
    for kind, call, player in (
        (Kind.RL_AGENT_MESSAGE, Kind.AGENT_MESSAGE, scene.agent),
        (Kind.RL_ENV_MESSAGE, Kind.ENV_MESSAGE, scene.environment),
    ):
        for text, answer in texts.items():
            scene.experiment.ask(kind, body=text)
            player.answers(call, body=text, gives=answer)
            scene.experiment.expects_reply(kind, body=answer)


def seed(scene: Scene) -> None:
    """RL_INIT with a seed, for an environment that takes one and an agent that does not."""
    scene.environment = scene.peer(Role.ENVIRONMENT, "seed", "a capability that nobody knows")
    scene.gather()
    given = []
    for seed in (2026, 2026, 7):
        scene.experiment.ask(Kind.RL_INIT, seed)
        call = scene.environment.expects(Kind.ENV_SEED)
        scene.environment.send(Kind.ENV_SEED, seq=call.seq)
        scene.environment.answers(Kind.ENV_INIT)
        scene.agent.answers(Kind.AGENT_INIT)
        scene.experiment.expects_reply(Kind.RL_INIT)
        given.append(call.scalars)
    same, different = given[0] == given[1], given[1] != given[2]
    scene.environment.check(same and different, f"{given} received for the seeds 2026, 2026, 7")
    scene.experiment.ask(Kind.RL_INIT, None)
    scene.environment.answers(Kind.ENV_INIT)
    scene.agent.answers(Kind.AGENT_INIT)
    scene.experiment.expects_reply(Kind.RL_INIT)


def unsupported(scene: Scene) -> None:
    """Save and load, for an environment that can and an agent that cannot."""
    scene.environment = scene.peer(Role.ENVIRONMENT, "save")
    scene.init()
    saved = bytes(range(256))
    scene.experiment.ask(Kind.RL_ENV_SAVE)
    scene.environment.answers(Kind.ENV_SAVE, gives=saved)
    scene.experiment.expects_reply(Kind.RL_ENV_SAVE, body=saved)
    scene.experiment.ask(Kind.RL_ENV_LOAD, body=saved)
    scene.environment.answers(Kind.ENV_LOAD, body=saved)
    scene.experiment.expects_reply(Kind.RL_ENV_LOAD)
    for kind in (Kind.RL_AGENT_SAVE, Kind.RL_AGENT_LOAD):
        scene.experiment.ask(kind, body=saved)
        scene.experiment.expects_error(ErrorCode.UNSUPPORTED, scene.experiment.seq)
    scene.episode(0, 2)


def sessions(scene: Scene) -> None:
    """An agent in two sessions over one connection; one continues while the other waits."""
    scene.init()
    scene.start()
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


def goodbye(scene: Scene) -> None:
    """An agent leaves, then the experiment; an environment offers one-run."""
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


def _refused(peer: ScriptedPeer, code: ErrorCode, seq: int) -> None:
    refuse = peer.expects(Kind.REFUSE, seq)
    peer.check(refuse.scalars[0] == code, f"{shown(refuse)} received instead of the code {code}")

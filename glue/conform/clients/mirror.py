"""The mirror: the player or experiment that a client is compared with; docs/clients.md describes it.

    python -m glue.testing.mirror agent            (or environment, experiment)
    python -m glue.testing.mirror agent --libzmq

The mirror finds its hub by GLUE_HUB and GLUE_SESSION. `glue-conform` compares clients with these classes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from glue.client.experiment import ERRORS, connect
from glue.client.players import serve_agent, serve_environment
from glue.client.target import find_target
from glue.engine.experiment import Experiment
from glue.errors import GlueError, HubClosed, PeerFailed, PeerLost, Unsupported
from glue.roles import Agent, Environment
from glue.types import CUT_OFF, AbstractType, Action, Observation, Step
from glue.wire.messages import THREE_ROLES, Event, Role

if TYPE_CHECKING:
    from glue.client.libzmq import Context

NAME: Final = "mirror"
"""The name that every mirror declares in HELLO."""

TASK_SPEC: Final = "a mirror, größer than it is"
FAIL: Final = "fail"
FAILURE: Final = "asked to fail"
END: Final = b"!"
"""The last char of an action that ends the episode."""
CUT: Final = b"?"
"""The last char of an action that cuts the episode off."""
BESIDE: Final = b"&"
"""The last char of an action that is answered with a mask and extras."""


class _Mirror:
    """The common part of agent and environment: `count`, `seed`, and their changes."""

    def __init__(self) -> None:
        self.count: int = 0
        self.seed: int = 0

    def message(self, message: str) -> str:
        if message == FAIL:
            raise RuntimeError(FAILURE)
        return message

    def save(self) -> bytes:
        return f"{self.count} {self.seed}".encode()

    def load(self, saved: bytes) -> None:
        self.count, self.seed = map(int, saved.split())

    def runs(self, seen: AbstractType, *more: float) -> tuple[list[int], list[float], bytes]:
        """Return the mirrored ints, doubles and chars of `seen`, with the mirror's additions."""
        ints, doubles, chars = shown(seen)
        if not ints and not doubles and not chars:
            return [], [], b""
        return [*ints[::-1], self.count], [*doubles[::-1], total(ints), *more], chars[::-1]


class MirrorAgent(_Mirror, Agent):
    """The mirror's agent."""

    agent_masks = True
    _told: tuple[float, ...] = ()

    def agent_init(self, task_spec: str) -> None:
        self.count: int = 0

    def agent_start(self, observation: Observation) -> Action:
        return self.agent_step(0.0, observation)

    def agent_pace(self, deadline: float, latency: float) -> None:
        self._told = (deadline, latency)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.count += 1
        told, self._told = self._told, ()
        return Action(*self.runs(observation, reward, *told))

    def agent_end(self, reward: float) -> None:
        self.count += 1

    # Written out, as no type checker knows the types of an attribute of two bases.
    def agent_message(self, message: str) -> str:
        return self.message(message)

    def agent_save(self) -> bytes:
        return self.save()

    def agent_load(self, saved: bytes) -> None:
        self.load(saved)

    def agent_seed(self, seed: int) -> None:
        self.seed = seed

    def agent_metrics(self) -> dict[str, float]:
        return {"count": float(self.count), "half the count": self.count / 2}


class MirrorEnvironment(_Mirror, Environment):
    """The mirror's environment."""

    env_masks = True
    env_extras = True

    def env_init(self) -> str:
        self.count: int = 0
        return TASK_SPEC

    def env_start(self) -> Observation:
        self.count += 1
        return Observation([self.count])

    def env_step(self, action: Action) -> Step:
        self.count += 1
        reward = float(action.doubles[0]) if len(action.doubles) else 0.0
        last = action.chars[-1:]
        runs = self.runs(action)
        observation = Observation(*runs, **self._beside(action)) if last == BESIDE else Observation(*runs)
        return Step(reward, observation, last in (END, CUT), last == CUT)

    def _beside(self, action: Action) -> dict[str, Any]:
        return {
            "mask": action.ints != 0 if len(action.ints) else None,
            "extras": {
                "count": self.count,
                "half": self.count + 0.5,
                "text": "größer",
                "chars": action.chars,
                "ints": action.ints,
                "doubles": action.doubles,
            },
        }

    # Written out, as no type checker knows the types of an attribute of two bases.
    def env_message(self, message: str) -> str:
        return self.message(message)

    def env_save(self) -> bytes:
        return self.save()

    def env_load(self, saved: bytes) -> None:
        self.load(saved)

    def env_seed(self, seed: int) -> None:
        self.seed = seed


def shown(value: AbstractType) -> tuple[list[int], list[float], bytes]:
    """Return the runs of an action, or of an observation with what is beside it behind them."""
    ints, doubles, chars = value.ints.tolist(), value.doubles.tolist(), value.chars
    if not isinstance(value, Observation):
        return ints, doubles, chars
    if value.mask is not None:
        ints += value.mask.nonzero()[0].tolist()
    for name, extra in sorted(value.extras.items()):
        chars += f"\n{name}=".encode()
        match extra:
            case bytes():
                chars += extra
            case str():
                chars += extra.encode()
            case _:
                numbers = extra if isinstance(extra, tuple) else (extra,)
                doubles += [number for number in numbers if isinstance(number, float)]
                chars += b" ".join(b"%d" % number for number in numbers if isinstance(number, int))
    return ints, doubles, chars


def total(ints: Sequence[int]) -> float:
    """Return the sum of ints, exact as long as there are fewer than 2^22 of them."""
    return float(sum(ints))


def result(ints: Sequence[int] = (), doubles: Sequence[float] = (), chars: bytes = b"") -> Action:
    """Return the report of a verb's values."""
    return Action(ints, [*doubles, total(ints)], chars)


def play(glue: Experiment, notices: list[str]) -> None:
    """Carry out orders until one is `end`; `notices` is filled elsewhere."""
    shown = Action(chars=b"ready")
    while True:
        reward, order, *_ = glue.rl_env_step(shown)
        verb, _, argument = order.chars.partition(b" ")
        if verb == b"end":
            return
        try:
            shown = carry_out(glue, verb.decode(), argument, reward, order, notices)
        except (PeerLost, PeerFailed, Unsupported) as error:
            shown = result(chars=f"ERROR {_CODES[type(error)]} {error}".encode())


_CODES: Final = {error: code for code, error in ERRORS.items()}


def carry_out(
    glue: Experiment, verb: str, argument: bytes, reward: float, order: Observation, notices: list[str]
) -> Action:
    """Carry out one order; return its result."""
    text = argument.decode("utf-8", "surrogateescape")
    given = Observation(order.ints, order.doubles, argument, mask=order.mask)
    match verb:
        case "RL_INIT":
            return result(chars=glue.rl_init(int(text) if text else None).encode("utf-8", "surrogateescape"))
        case "RL_START":
            return _both(*glue.rl_start())
        case "RL_STEP":
            return _outcome(glue.rl_step())
        case "RL_EPISODE":
            return result([int(glue.rl_episode(int(text)))])
        case "RL_RETURN":
            return result(doubles=[glue.rl_return()])
        case "RL_NUM_STEPS":
            return result(chars=str(glue.rl_num_steps()).encode())
        case "RL_NUM_EPISODES":
            return result(chars=str(glue.rl_num_episodes()).encode())
        case "RL_AGENT_MESSAGE":
            return result(chars=glue.rl_agent_message(text).encode("utf-8", "surrogateescape"))
        case "RL_ENV_MESSAGE":
            return result(chars=glue.rl_env_message(text).encode("utf-8", "surrogateescape"))
        case "RL_CLEANUP":
            glue.rl_cleanup()
        case "RL_ENV_START":
            return _both(glue.rl_env_start(), Action())
        case "RL_ENV_STEP":
            return _outcome(glue.rl_env_step(Action(order.ints, order.doubles, argument)))
        case "RL_AGENT_START":
            return _both(Observation(), glue.rl_agent_start(given))
        case "RL_AGENT_STEP":
            return _both(Observation(), glue.rl_agent_step(reward, given))
        case "RL_AGENT_END":
            glue.rl_agent_end(reward)
        case "RL_AGENT_SAVE":
            return result(chars=glue.rl_agent_save())
        case "RL_ENV_SAVE":
            return result(chars=glue.rl_env_save())
        case "RL_AGENT_METRICS":
            metrics = glue.rl_agent_metrics()
            return result(doubles=[*metrics.values()], chars="\n".join(metrics).encode())
        case "RL_AGENT_LOAD":
            glue.rl_agent_load(argument)
        case "RL_ENV_LOAD":
            glue.rl_env_load(argument)
        case "notices":
            lines, notices[:] = "\n".join(notices), []
            return result(chars=lines.encode())
        case _:
            raise HubClosed(f"the mirror was ordered to do {verb!r}, which it does not know")
    return result()


def _outcome(step: Step) -> Action:
    terminal = CUT_OFF if step.truncated else int(step.terminal)
    return _both(step.observation, step.action, [terminal], [step.reward])


def _both(
    observation: Observation, action: Action, ints: Sequence[int] = (), doubles: Sequence[float] = ()
) -> Action:
    seen, done = shown(observation), shown(action)
    return result([*seen[0], *done[0], *ints], [*seen[1], *done[1], *doubles], seen[2] + done[2])


def run_mirror(role: Role, hub: str, session: str, context: Context | None = None) -> int:
    """Take part in a session until the hub says goodbye, or refuses; return the exit code."""
    notices: list[str] = []

    def keep(event: str, role: str, name: str) -> None:
        if event != Event.SLOW:
            notices.append(f"{event} {role} {name}")

    try:
        if role is Role.AGENT:
            print(serve_agent(MirrorAgent(), hub, session, context=context, name=NAME))
        elif role is Role.ENVIRONMENT:
            print(serve_environment(MirrorEnvironment(), hub, session, context=context, name=NAME))
        else:
            with connect(hub, session, name=NAME, context=context, on_notice=keep) as glue:
                play(glue, notices)
    except HubClosed as goodbye:
        print(goodbye)
    except GlueError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
    return 0


def main(arguments: Sequence[str]) -> int:
    """Run a mirror in the given role."""
    parser = argparse.ArgumentParser(prog="python -m glue.testing.mirror")
    parser.add_argument("role", choices=[str(role) for role in THREE_ROLES])
    parser.add_argument("--libzmq", action="store_true", help="connect with libzmq, not with plain sockets")
    options = parser.parse_args(arguments)
    context = None
    if options.libzmq:
        from glue.client.libzmq import Context  # libzmq is slow to load and rarely needed

        context = Context()
    target = find_target(None, None, None, None)
    return run_mirror(Role(options.role), target.hub, target.session, context)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Steps per second of three programs, compared with the original and with other libraries."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

from benchmarks.measure import Rate, Table, count, rate, rates, ratio
from benchmarks.original import SERVER, compiler, original_programs, original_server, through_the_gateway
from benchmarks.peers import async_vector_env, dm_env_rpc_stream, installed
from benchmarks.players import MASKED, SIZES, Still, Walk, serving
from benchmarks.raw import socket_round_trips, zmq_round_trips
from glue.client.experiment import connect_over
from glue.client.libzmq import new_pair
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.hub.config import Bind, HubConfig, Keys, Permit
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.keys.certificates import write_pair
from glue.wire.messages import Role

_STEPS = 5000
_FEW_STEPS = 200
_PAIRS = 31
_PLAYERS = ("environment", "agent")
_ACTION_SIZE = 20
_, _MARIO = SIZES
_VECTOR_ENV = "Gymnasium's AsyncVectorEnv, one environment"
_DM_ENV_RPC = "dm_env_rpc"
_VERBS = {"episode": "RL_EPISODE", "step": "RL_STEP"}
_INSIDE = "environment inside, agent outside, ipc"

Measure = Callable[[], Rate]


def run() -> list[Table]:
    """Measure three programs."""
    return [*_three_programs(), _masks(), _sizes()]


def _three_programs() -> list[Table]:
    """Measure Mario-sized steps of three programs, and everything to compare them with."""
    size = len(SIZES[_MARIO].body)
    measures: dict[str, AbstractContextManager[Measure]] = {}
    for verb, name in _VERBS.items():
        measures[f"{_INSIDE}, {name}"] = _environment_inside(_MARIO, verb)
        if compiler and SERVER:
            measures[f"original RL-Glue, C programs, {name}"] = _original(original_server, verb)
        for transport in ("ipc", "tcp"):
            measures[f"three Python processes, {transport}, {name}"] = _three(_MARIO, transport, verb)
        measures[f"three Python processes, tcp with keys (CURVE), {name}"] = _with_keys(_MARIO, verb)
        if compiler:
            measures[f"C programs through the gateway, {name}"] = _original(through_the_gateway, verb)
    measures["raw round trips, Unix socket"] = socket_round_trips("ipc", size, _ACTION_SIZE)
    measures["raw round trips, TCP"] = socket_round_trips("tcp", size, _ACTION_SIZE)
    measures["raw round trips, pyzmq over ipc"] = zmq_round_trips("ipc", size, _ACTION_SIZE)
    if installed("gymnasium"):
        measures[_VECTOR_ENV] = async_vector_env()
    if installed("dm_env_rpc"):
        measures[_DM_ENV_RPC] = dm_env_rpc_stream()
    with ExitStack() as stack:
        ready = [stack.enter_context(measure) for measure in measures.values()]
        results = dict(zip(measures, rates(ready), strict=True))
    return [_ratios(results), _rates(results)]


def _ratios(results: dict[str, Rate]) -> Table:
    """Return the ratios of programs within one run."""
    ipc, tcp, keys, step = (
        results[f"three Python processes, {name}"]
        for name in (
            "ipc, RL_EPISODE",
            "tcp, RL_EPISODE",
            "tcp with keys (CURVE), RL_EPISODE",
            "ipc, RL_STEP",
        )
    )
    two_round_trips = results["raw round trips, Unix socket"].per_second / 2
    inside = results[f"{_INSIDE}, RL_EPISODE"]
    rows = [
        (
            "environment inside the experiment, agent outside: of ipc",
            ratio(inside.per_second / ipc.per_second),
            "",
        ),
        ("ipc: of two raw round trips over a Unix socket", ratio(ipc.per_second / two_round_trips), "0.35"),
        ("ipc: CPU time of all processes for a step", f"{ipc.cpu:.0f} us", "at most 120 us"),
        ("tcp: of ipc", ratio(tcp.per_second / ipc.per_second), "0.75"),
        ("tcp with keys (CURVE): of tcp", ratio(keys.per_second / tcp.per_second), "0.55"),
        ("RL_STEP: of RL_EPISODE", ratio(step.per_second / ipc.per_second), ""),
    ]
    for verb in _VERBS.values():
        original = results.get(f"original RL-Glue, C programs, {verb}")
        aims = {
            f"{_INSIDE}, {verb}": "",
            f"three Python processes, ipc, {verb}": "1.05" if verb == "RL_EPISODE" else "1.10",
            f"C programs through the gateway, {verb}": "0.94" if verb == "RL_EPISODE" else "0.85",
        }
        for name, aim in aims.items():
            if original is not None and name in results:
                share = ratio(results[name].per_second / original.per_second)
                rows.append((f"{name}: of the original RL-Glue", share, aim))
    for peer in (_VECTOR_ENV, _DM_ENV_RPC):
        if peer in results:
            rows.append((f"ipc: of {peer}", ratio(ipc.per_second / results[peer].per_second), ""))
    return Table(
        "Ratios",
        "Of steps per second, each with what it is compared with in the same run; the numbers behind them "
        "are in the next table. The original RL-Glue is measured if RLGLUE_C names it.",
        ("three programs, a step of Infinite Mario's size", "ratio", "aim"),
        rows,
    )


def _rates(results: dict[str, Rate]) -> Table:
    rows = [(name, count(result.per_second), f"{result.cpu:.0f}") for name, result in results.items()]
    return Table(
        "Three programs",
        "Steps with an observation of Mario's size (23 ints, 44 doubles, 352 chars), agent and environment "
        "doing nothing. CPU is that of all processes. A step needs two round trips; raw ones are those of "
        "two Python processes over a Unix socket with the same bytes. An environment inside the experiment's "
        "process, AsyncVectorEnv and dm_env_rpc make one round trip a step; the latter two have no agent.",
        ("programs", "per second", "CPU, us"),
        rows,
    )


def _masks() -> Table:
    """Measure a mask in the same three processes, which are told by a message to send it or not."""
    with ExitStack() as stack:
        hub = stack.enter_context(listening("ipc"))
        pids = [stack.enter_context(serving(role, MASKED, hub.endpoints[0])) for role in _PLAYERS]
        glue = stack.enter_context(connect_over(InsideTransport(hub), "0"))
        glue.rl_init()

        def measure(message: str) -> Rate:
            glue.rl_env_message(message)
            glue.rl_episode(_FEW_STEPS)
            return rate(lambda: glue.rl_episode(_STEPS), _STEPS, pids)

        without, masked = rates([lambda: measure("no mask"), lambda: measure("mask")], _PAIRS)
    return Table(
        "Masks",
        "RL_EPISODE over ipc, an observation of one int without and with a mask of 12 actions, which the "
        f"agent is sent; {_PAIRS} times in turn in the same three processes.",
        ("observation", "steps per second", "CPU, us", "of steps without", "aim"),
        [
            ("without a mask", count(without.per_second), f"{without.cpu:.1f}", "", ""),
            (
                "with a mask",
                count(masked.per_second),
                f"{masked.cpu:.1f}",
                f"{masked.per_second / without.per_second:.3f}",
                "0.970",
            ),
        ],
    )


def _sizes() -> Table:
    with ExitStack() as stack:
        measures: dict[tuple[str, str], Measure] = {}
        for size in SIZES:
            measures["in process", size] = stack.enter_context(_in_process(size))
            measures[_INSIDE, size] = stack.enter_context(_environment_inside(size, "episode"))
            measures["three processes, ipc", size] = stack.enter_context(_three(size, "ipc", "episode"))
        results = rates(list(measures.values()))
    return Table(
        "Topologies",
        "RL_EPISODE, agent and environment doing nothing.",
        ("topology", "observation", "steps per second", "CPU, us"),
        [
            (*name, count(result.per_second), f"{result.cpu:.1f}")
            for name, result in zip(measures, results, strict=True)
        ],
    )


def _measure(glue: Experiment, verb: str, pids: list[int]) -> Measure:
    glue.rl_init()

    def step() -> None:
        glue.rl_start()
        for _ in range(_STEPS):
            glue.rl_step()

    work = step if verb == "step" else lambda: glue.rl_episode(_STEPS)
    work()
    return lambda: rate(work, _STEPS, pids)


@contextmanager
def _in_process(size: str) -> Iterator[Measure]:
    with local(Still(), Walk(SIZES[size])) as glue:
        yield _measure(glue, "episode", [])


@contextmanager
def three_processes() -> Iterator[Measure]:
    """Yield a measure of steps per second of three processes that only play, over ipc."""
    with _three(_MARIO, "ipc", "episode") as measure:
        yield measure


@contextmanager
def _three(size: str, transport: str, verb: str) -> Iterator[Measure]:
    with ExitStack() as stack:
        hub = stack.enter_context(listening(transport))
        url = hub.endpoints[0]
        pids = [stack.enter_context(serving(role, size, url)) for role in _PLAYERS]
        yield _measure(stack.enter_context(connect_over(InsideTransport(hub), "0")), verb, pids)


@contextmanager
def _environment_inside(size: str, verb: str) -> Iterator[Measure]:
    """Yield a measure like that of `_three`, over ipc, whose environment is an object of this process."""
    with ExitStack() as stack:
        hub = stack.enter_context(listening("ipc"))
        agent = stack.enter_context(serving("agent", size, hub.endpoints[0]))
        transport = InsideTransport(hub, {Role.ENVIRONMENT: Walk(SIZES[size])}, "0")
        yield _measure(stack.enter_context(connect_over(transport, "0")), verb, [agent])


@contextmanager
def _with_keys(size: str, verb: str) -> Iterator[Measure]:
    """Yield a measure like that of `_three`, over tcp, whose agent and environment have keys."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        own, theirs = new_pair(), new_pair()
        public, _ = write_pair(folder, "hub", own)
        _, secret = write_pair(folder, "players", theirs)
        keys = Keys(own.secret, {theirs.public: Permit("players", frozenset(Role))})
        config = HubConfig(bind=(Bind("tcp://127.0.0.1:*", keys=keys),))
        hub = stack.enter_context(Hub(config).in_background())
        url = hub.endpoints[0]
        variables = {**os.environ, "GLUE_KEY": str(secret), "GLUE_HUB_KEY": str(public)}
        pids = [stack.enter_context(serving(role, size, url, variables=variables)) for role in _PLAYERS]
        yield _measure(stack.enter_context(connect_over(InsideTransport(hub), "0")), verb, pids)


@contextmanager
def _original(
    serve: Callable[[], AbstractContextManager[tuple[int, list[int]]]], verb: str
) -> Iterator[Measure]:
    with (
        serve() as (port, servers),
        original_programs(port, servers, SIZES[_MARIO], verb, _STEPS) as measure,
    ):
        yield measure


@contextmanager
def listening(transport: str) -> Iterator[Hub]:
    """Yield a hub of this process, with an address of `transport`."""
    with tempfile.TemporaryDirectory() as folder:
        address = f"ipc://{folder}/hub" if transport == "ipc" else "tcp://127.0.0.1:*"
        with Hub(HubConfig(bind=(address,), max_sessions=4096)).in_background() as hub:
            yield hub

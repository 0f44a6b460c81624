"""The likely alternatives: Gymnasium's AsyncVectorEnv and dm_env_rpc (extra `bench`).

Each steps an environment in another process, with observations of Mario's size and without an agent: one
round trip a step, where three programs on a hub need two.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.measure import Rate, rate

_STEPS = 2000
_NUMBERS = 44 + 23 + 44  # 8-byte numbers in place of an observation of Mario


def installed(package: str) -> bool:
    """Return whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def _still() -> Any:
    import gymnasium

    class Still(gymnasium.Env):  # type: ignore[misc, type-arg, unused-ignore]
        observation_space = gymnasium.spaces.Box(-1, 1, (_NUMBERS,), np.float64)
        action_space = gymnasium.spaces.Discrete(12)

        def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
            return np.zeros(_NUMBERS), {}

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            return np.zeros(_NUMBERS), 1.0, False, False, {}

    return Still()


@contextmanager
def async_vector_env() -> Iterator[Callable[[], Rate]]:
    """Yield a measure of steps per second of one environment in Gymnasium's AsyncVectorEnv."""
    from gymnasium.vector import AsyncVectorEnv

    environments = AsyncVectorEnv([_still])
    try:
        environments.reset()
        actions = np.zeros(1, np.int64)
        pids = [process.pid for process in environments.processes if process.pid]

        def steps() -> None:
            for _ in range(_STEPS):
                environments.step(actions)

        yield lambda: rate(steps, _STEPS, pids)
    finally:
        environments.close()


@contextmanager
def dm_env_rpc_stream() -> Iterator[Callable[[], Rate]]:
    """Yield a measure of steps per second over dm_env_rpc's stream of gRPC messages."""
    from dm_env_rpc.v1 import connection, dm_env_rpc_pb2, tensor_utils

    command = [sys.executable, "-m", "benchmarks.peers"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            port = int(server.stdout.readline())
            with connection.create_secure_channel_and_connect(f"127.0.0.1:{port}") as stream:
                request = dm_env_rpc_pb2.StepRequest(requested_observations=[1])
                request.actions[1].CopyFrom(tensor_utils.pack_tensor(1, dtype=np.int32))

                def steps() -> None:
                    for _ in range(_STEPS):
                        tensor_utils.unpack_tensor(stream.send(request).observations[1])

                yield lambda: rate(steps, _STEPS, [server.pid])
        finally:
            server.terminate()


def _serve_dm_env_rpc() -> None:
    from concurrent import futures

    import grpc
    from dm_env_rpc.v1 import dm_env_rpc_pb2, dm_env_rpc_pb2_grpc, tensor_utils

    class Still(dm_env_rpc_pb2_grpc.EnvironmentServicer):  # type: ignore[misc, unused-ignore]
        def Process(self, requests: Iterator[Any], context: Any) -> Iterator[Any]:
            for _ in requests:
                response = dm_env_rpc_pb2.EnvironmentResponse()
                response.step.state = dm_env_rpc_pb2.EnvironmentStateType.RUNNING
                response.step.observations[1].CopyFrom(tensor_utils.pack_tensor(np.zeros(_NUMBERS)))
                yield response

    server = grpc.server(futures.ThreadPoolExecutor(1))
    dm_env_rpc_pb2_grpc.add_EnvironmentServicer_to_server(Still(), server)
    port = server.add_secure_port("127.0.0.1:0", grpc.local_server_credentials())
    server.start()
    print(port, flush=True)
    server.wait_for_termination()


if __name__ == "__main__":
    _serve_dm_env_rpc()

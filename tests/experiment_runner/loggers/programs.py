"""The programs that show results, really started, and the results that each reports."""

from __future__ import annotations

import json
import os
import re
import socket
import struct
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode
from urllib.request import Request, urlopen

from tests.forked import BIN

Shown = dict[str, dict[str, list[tuple[int, float]]]]
"""Steps and values of each metric of each trial, in the program's order."""

PROJECT = "a-project"


def settings(folder: Path) -> dict[str, str]:
    """Return the environment variables with which all programs store their data in one folder."""
    return {
        **os.environ,
        "MLFLOW_TRACKING_URI": f"sqlite:///{folder}/mlflow.db",
        "TRACKIO_DIR": str(folder / "trackio"),
        "WANDB_DIR": str(folder),
        "WANDB_MODE": "offline",
    }


def prepare(program: str, folder: Path) -> None:
    """Let MLflow create its database, which a kill during creation would damage."""
    if program == "mlflow":
        make = "from mlflow import MlflowClient; MlflowClient().search_experiments()"
        subprocess.run([sys.executable, "-c", make], env=settings(folder), check=True, capture_output=True)


def tensorboard(folder: Path, run: Path) -> Shown:
    """Return a run as TensorBoard shows it."""
    command = ("tensorboard", "--logdir", str(run / "streams/tensorboard"), "--port", "0")
    shown: Shown = {}
    with _serving(folder, *command, "--samples_per_plugin", "scalars=100000") as address:
        url = f"{address}data/plugin/timeseries/"
        for trial, tags in _read(f"{url}tags")["scalars"]["runTagInfo"].items():
            asked = [{"plugin": "scalars", "tag": tag, "run": trial} for tag in tags]
            answers = _read(f"{url}timeSeries", urlencode({"requests": json.dumps(asked)}).encode())
            shown[trial] = {
                answer["tag"]: [(point["step"], point["value"]) for point in answer["runToSeries"][trial]]
                for answer in answers
            }
    return shown


def mlflow(folder: Path, run: Path) -> Shown:
    """Return a run as an MLflow server shows it."""
    from mlflow import MlflowClient

    store = settings(folder)["MLFLOW_TRACKING_URI"]
    with socket.create_server(("127.0.0.1", 0)) as reserved:
        port = str(reserved.getsockname()[1])
    options = ("--backend-store-uri", store, "--workers", "1", "--port", port)
    with _serving(folder, "mlflow", "server", *options) as address:
        client = MlflowClient(address)
        (experiment,) = client.search_experiments(filter_string=f"name = '{PROJECT}'")
        return {
            _trial(each.info.run_name, run): {
                name: [(m.step, m.value) for m in client.get_metric_history(each.info.run_id, name)]
                for name in each.data.metrics
            }
            for each in client.search_runs([experiment.experiment_id])
        }


def trackio(folder: Path, run: Path) -> Shown:
    """Return a run as the dashboard of Trackio shows it."""
    shown: Shown = {}
    with _serving(folder, "trackio", "show", "--project", PROJECT) as address:

        def ask(what: str, **names: str) -> Any:
            return _read(f"{address}api/{what}", json.dumps(names).encode())["data"]

        for each in ask("get_runs_for_project", project=PROJECT):
            names = {"project": PROJECT, "run": each["name"]}
            shown[_trial(each["name"], run)] = {
                metric: [
                    (p["step"], p["value"]) for p in ask("get_metric_values", metric_name=metric, **names)
                ]
                for metric in ask("get_metrics_for_run", **names)
            }
    return shown


def wandb(folder: Path, run: Path) -> Shown:
    """Return a run as W&B's server would show it, which keeps only the first line of each step."""
    from wandb.proto.wandb_internal_pb2 import Record

    shown: defaultdict[str, defaultdict[str, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    ids: dict[str, str] = {}
    for file in sorted((folder / "wandb").glob("offline-run-*/*.wandb")):
        trial = ""
        for data in _records(file.read_bytes()):
            record = Record.FromString(data)
            if record.HasField("run"):
                trial = _trial(record.run.display_name, run)
                assert ids.setdefault(trial, record.run.run_id) == record.run.run_id
            elif record.HasField("history"):
                values = {
                    "".join(i.nested_key) or i.key: json.loads(i.value_json) for i in record.history.item
                }
                for name, value in values.items():
                    if not name.startswith("_"):
                        shown[trial][name].setdefault(values["_step"], float(value))
    return {
        trial: {name: sorted(values.items()) for name, values in metrics.items()}
        for trial, metrics in shown.items()
    }


def _records(data: bytes) -> Iterator[bytes]:
    """Yield the records of a W&B file: LevelDB's log format, after a header of seven bytes.

    A kill may have left the last record incomplete.
    """
    block, whole, last = 32_768, 1, 4
    at, parts = 7, b""
    while len(data) - at >= 7:
        if block - at % block < 7:  # no room for a header: zeros
            at += block - at % block
            continue
        _, size, kind = struct.unpack_from("<IHB", data, at)
        parts += data[at + 7 : at + 7 + size]
        at += 7 + size
        if at > len(data):
            return
        if kind in (whole, last):
            yield parts
            parts = b""


PROGRAMS: Mapping[str, Callable[[Path, Path], Shown]] = {
    "tensorboard": tensorboard,
    "mlflow": mlflow,
    "trackio": trackio,
    "wandb": wandb,
}


def _trial(name: str, run: Path) -> str:
    return name.removeprefix(f"{run.name}/").rpartition(" ")[0]


@contextmanager
def _serving(folder: Path, name: str, *arguments: str) -> Iterator[str]:
    """Run one of the servers until the `with` block ends; yield the address that it prints."""
    command = [sys.executable, str(BIN / name), *arguments]
    with (folder / "printed").open("wb") as printed:
        server = subprocess.Popen(
            command,
            env=settings(folder) | {"PYTHONUNBUFFERED": "1"},  # the address is read while the server runs
            stdout=printed,
            stderr=printed,
            start_new_session=True,
        )
    try:
        while not (found := re.search(r"http://[\w.]+:\d+\b", (folder / "printed").read_text())):
            assert server.poll() is None, (folder / "printed").read_text()
            time.sleep(0.05)
        yield f"{found[0]}/"
    finally:
        os.killpg(server.pid, 15)
        server.wait()


def _read(url: str, data: bytes | None = None) -> Any:
    kind = "json" if data is not None and data.startswith(b"{") else "x-www-form-urlencoded"
    with urlopen(Request(url, data, {"Content-Type": f"application/{kind}"}), timeout=60) as answer:
        return json.load(answer)

"""Programs with keys, as users start them; the same episodes as without keys; other users of the machine."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue import GlueError, make, make_agent, serve_agent, serve_environment
from tests import forked
from tests.keyed import KeyFolder
from tests.scripted.peer import TIMEOUT
from tests.system.runs import start, wait_until
from tests.terminal import Terminal

NOBODY = 65534


@contextmanager
def keyed_hub(keys: KeyFolder) -> Iterator[tuple[Terminal, str]]:
    """Run a hub with keys; yield it and its address."""
    options = ("--bind", "tcp://127.0.0.1:*", "--keys", str(keys.path))
    with closing(Terminal("glue-hub", *options, cwd=keys.path)) as hub:
        yield hub, hub.wait_for(r"listening on (\S+)")[1]


def glue_keys(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.run("glue-keys", *arguments, cwd=cwd, timeout=TIMEOUT)


@pytest.mark.stage("keys")
def test_a_key_from_its_making_to_its_use(tmp_path: Path) -> None:
    made = glue_keys("new", "carol", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "carol.key_secret: the secret key. Do not share it" in made.stderr
    assert "carol.key: the public key. Give it to the operator of the hub" in made.stderr
    assert glue_keys("show", "carol.key_secret", cwd=tmp_path).stdout == made.stdout
    keys = KeyFolder(tmp_path)
    # Her file is named as other programs name it, and holds only the key.
    (keys.path / "carol.pub").write_text(made.stdout)
    carol = '[carol]\nrole = ["agent", "environment", "experiment"]\nsession = "a"\n'
    keys.allow(carol)
    with keyed_hub(keys) as (_, url):
        environment = {
            **os.environ,
            "GLUE_HUB": url,
            "GLUE_SESSION": "a",
            "GLUE_KEY": "carol.key_secret",
            "GLUE_HUB_KEY": str(keys.hub_key),
        }
        players = ("--env", "mines", "--agent", "random", "--episodes", "2", "--out", "run")
        done = forked.run("glue-experiment", *players, cwd=tmp_path, env=environment, timeout=TIMEOUT)
        assert done.returncode == 0, done.stderr
        assert "2/2" in done.stdout


def test_a_hub_takes_no_list_that_others_can_write(tmp_path: Path) -> None:
    keys = KeyFolder(tmp_path)
    keys.entrant("carol")
    keys.allow('[carol]\nrole = "agent"')
    listed = keys.path / "allow.toml"
    listed.chmod(0o664)
    options = ("--bind", "tcp://127.0.0.1:*", "--keys", str(keys.path))
    refused = forked.run("glue-hub", *options, cwd=tmp_path, timeout=TIMEOUT)
    assert refused.returncode == 2, refused.stderr
    assert f"chmod go-w {listed}" in refused.stderr
    listed.chmod(0o644)
    with keyed_hub(keys) as (hub, _):
        listed.rename(tmp_path / "list")
        listed.symlink_to(tmp_path / "list")
        (tmp_path / "list").chmod(0o664)
        hub.send_signal(signal.SIGHUP)
        hub.wait_for("the keys stay as they were")
        (tmp_path / "list").chmod(0o644)
        hub.send_signal(signal.SIGHUP)
        hub.wait_for("read again: 1 key may join")


def as_nobody(path: Path) -> str:
    """Return the name of the error that another user gets on connecting to a Unix socket; empty if none."""
    program = (
        "import os, socket, sys\n"
        f"os.setgroups([]); os.setgid({NOBODY}); os.setuid({NOBODY})\n"
        "try:\n"
        "    socket.socket(socket.AF_UNIX).connect(sys.argv[1])\n"
        "except OSError as error:\n"
        "    sys.exit(type(error).__name__)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=TIMEOUT
    )
    return done.stderr.strip()


def listening(pid: int) -> set[str]:
    """Return the inodes of a process's listening TCP sockets."""
    tables = [Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
    everyones = {line.split()[9] for table in tables for line in table if line.split()[3] == "0A"}
    own = set()
    for file in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            own.add(os.readlink(file).removeprefix("socket:[").removesuffix("]"))
    return own & everyones


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
def test_another_user_of_the_machine_reaches_nothing_of_an_experiment_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as made:
        temporary = Path(made)
        temporary.chmod(0o1777)  # every user may enter it, like /tmp
        monkeypatch.setenv("TMPDIR", made)
        with start("--env", "mines", "--agent", "random", "--episodes", "1000000", cwd=tmp_path) as process:
            wait_until(lambda: list(temporary.glob("glue-*/hub")), "the meeting place")
            [path] = temporary.glob("glue-*/hub")
            assert path.parent.stat().st_mode & 0o777 == 0o700
            assert as_nobody(path) == "PermissionError"
            assert not listening(process.pid), "a port could be reached by anybody"
            # Only the folder keeps others out.
            path.parent.chmod(0o755)
            path.chmod(0o777)
            assert as_nobody(path) == ""
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=TIMEOUT)


@pytest.mark.stage("keys")
def test_who_else_can_join_is_said_where_players_from_outside_are_expected(tmp_path: Path) -> None:
    outside = ("--env", "mines", "--episodes", "1", "--bind", "tcp://127.0.0.1:*")
    with closing(Terminal("glue-experiment", *outside, cwd=tmp_path)) as experiment:
        experiment.wait_for("open to every user of this machine, unless keys")


def test_an_experiment_with_keys_lets_only_them_in(tmp_path: Path) -> None:
    keys = KeyFolder(tmp_path)
    carol, erin = keys.entrant("carol"), keys.entrant("erin")
    keys.allow('[carol]\nrole = ["agent", "environment"]\n[erin]\nrole = "environment"\n')
    outside = ("--env", "mines", "--episodes", "2", "--bind", "tcp://127.0.0.1:*", "--keys", str(keys.path))
    with closing(Terminal("glue-experiment", *outside, "--out", "run", cwd=tmp_path)) as experiment:
        url = experiment.wait_for(
            rf"--hub (tcp\S+) .*--key THEIRS.key_secret --hub-key {re.escape(str(keys.hub_key))}"
        )[1]
        refusal = "may join at this address of the hub, or with this key"
        with pytest.raises(GlueError, match=refusal):
            serve_agent(make_agent("random"), url, key=erin, hub_key=keys.hub_key)
        with pytest.raises(GlueError, match=refusal):
            serve_environment(make("mines"), url, key=carol, hub_key=keys.hub_key)
        reason = serve_agent(make_agent("random"), url, key=carol, hub_key=keys.hub_key)
        assert reason == "the experiment is over"
        assert experiment.end() == 0
        experiment.wait_for("2/2")

"""A hub with keys, and zeromq.js: another binding of libzmq, on Node.

npm install --prefix DIR zeromq && NODE_PATH=DIR/node_modules python -m pytest tests/system/keys
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from glue.hub.config import Bind, HubConfig
from glue.hub.io.server import Hub
from glue.keys.allowed import read_keys
from glue.keys.certificates import encode, read_pair, read_public
from glue.wire.codec import FROM_HUB, decode
from glue.wire.messages import Kind
from tests.keyed import KeyFolder
from tests.scripted.peer import TIMEOUT, ScriptedPeer, hello_scalars

NODE = shutil.which("node")


def has_zeromq() -> bool:
    if NODE is None:
        return False
    look = [NODE, "-e", 'require("zeromq")']
    return subprocess.run(look, stderr=subprocess.DEVNULL, timeout=TIMEOUT).returncode == 0


@pytest.mark.skipif(not has_zeromq(), reason="needs node, and zeromq.js in NODE_PATH")
def test_zeromq_js_joins_with_its_key_what_its_key_opens(tmp_path: Path) -> None:
    keys = KeyFolder(tmp_path)
    secrets = {name: keys.entrant(name) for name in ("right", "role", "session", "wrong")}
    keys.allow(
        '[right]\nrole = "experiment"\nsession = "a"\n'
        '[role]\nrole = "agent"\nsession = "a"\n'
        '[session]\nrole = "experiment"\nsession = "b"\n'
    )
    said = {}
    bind = Bind("tcp://127.0.0.1:*", keys=read_keys(keys.path))
    with Hub(HubConfig(bind=(bind,))).in_background() as hub:
        (hello,) = ScriptedPeer(hub.endpoints[0], session="a").frames_of(
            Kind.HELLO, 1, *hello_scalars("experiment")
        )
        for name, secret in secrets.items():
            pair = read_pair(secret)
            arguments = [hub.endpoints[0], encode(pair.public), encode(pair.secret)]
            arguments += [encode(read_public(keys.hub_key)), hello.hex()]
            program = [str(NODE), str(Path(__file__).with_name("curve.cjs")), *arguments]
            done = subprocess.run(program, capture_output=True, text=True, timeout=TIMEOUT)
            assert done.returncode == 0, done.stderr
            said[name] = done.stdout.strip()
    assert said.pop("wrong") == "auth"
    answers = {name: decode([bytes.fromhex(data)], FROM_HUB, 0) for name, data in said.items()}
    kinds = {name: answer.kind for name, answer in answers.items()}
    assert kinds == {"right": Kind.WELCOME, "role": Kind.REFUSE, "session": Kind.REFUSE}
    for name in ("role", "session"):
        assert "or with this key" in str(answers[name].scalars[1])

from __future__ import annotations

import pytest

from experiment_runner.plan import RoleSpec, TrialSpec
from experiment_runner.players import HubOptions, Meeting, open_experiment
from glue.core.config import LegacyPort


class Heard(Exception):
    """The hint was given."""


@pytest.mark.parametrize(
    ("bind", "shown"),
    [
        ("tcp://0.0.0.0:*", "tcp://HOST:"),
        ("tcp://*:*", "tcp://HOST:"),
        ("tcp://127.0.0.1:*", "tcp://127.0.0.1:"),
    ],
)
def test_hint_has_an_address_at_which_others_can_join(bind: str, shown: str) -> None:
    def say(line: str) -> None:
        if line.startswith("waiting for an agent"):
            raise Heard(line)

    spec = TrialSpec("remote/mines/0", None, RoleSpec("mines"), episodes=1, max_steps=0, seed=1)
    meeting = Meeting(hub=HubOptions(bind=(bind,), insecure=True))
    hint = rf"glue-agent random --hub {shown}\d+$"
    with pytest.raises(Heard, match=hint), open_experiment(spec, meeting, say, lambda: 0):
        raise AssertionError("nobody was missing")


def test_hint_names_the_port_at_which_an_original_program_of_the_session_can_join() -> None:
    def say(line: str) -> None:
        if line.startswith("waiting for an agent"):
            raise Heard(line)

    spec = TrialSpec("remote/mines/0", None, RoleSpec("mines"), episodes=1, max_steps=0, seed=1)
    ports = (LegacyPort(0), LegacyPort(0, "b"))
    meeting = Meeting(hub=HubOptions(bind=("tcp://127.0.0.1:*",), session="b", legacy=ports))
    hint = r"--session b; or an original one on 127\.0\.0\.1:\d+$"
    with pytest.raises(Heard, match=hint), open_experiment(spec, meeting, say, lambda: 0):
        raise AssertionError("nobody was missing")

"""What a connection has learned of the steps of a session is forgotten with the session."""

from __future__ import annotations

import gc

from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from glue.types import Action, Observation
from glue.wire.messages import Kind
from glue.wire.steps import StepFormat
from tests.scripted.peer import ScriptedPeer


def formats(session: str) -> int:
    return sum(type(each) is StepFormat and each.session == session for each in gc.get_objects())


def test_formats_of_steps_end_with_the_session_and_not_with_the_connection() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=60.0)
    with (
        Hub(config).in_background() as hub,
        ScriptedPeer(hub.endpoints[0], session="forgotten").greet() as environment,
        ScriptedPeer(hub.endpoints[0], session="forgotten").greet() as experiment,
    ):
        environment.join("environment", session="kept")
        environment.join("environment")
        experiment.join("experiment")
        experiment.say(Kind.RL_ENV_STEP, 1, body=Action([1]).body)
        while (call := environment.receive()).kind is not Kind.ENV_STEP:
            environment.say(call.kind, call.seq)
        environment.say(Kind.ENV_STEP, call.seq, 1.0, False, body=Observation([2]).body)
        while experiment.receive().kind is not Kind.RL_ENV_STEP:
            pass
        assert formats("forgotten") > 0
        environment.say(Kind.GOODBYE, 0, "enough")
        environment.say(Kind.HEARTBEAT, 7, session="kept")
        environment.receive_frames()  # the hub has read the GOODBYE
        assert formats("forgotten") == 0

"""What is beyond its range, from a hub and from whoever writes or starts a program."""

from __future__ import annotations

import math
import socket
from typing import Final

import pytest

from env_server.toys import SkeletonEnvironment
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, encode
from glue.wire.messages import MAX_BODY, PROTOCOL_VERSION, Kind, Message
from tests.clients.languages import CPP, LANGUAGES, RUST, Language, run
from tests.clients.random_agent import RandomAgent
from tests.clients.table import SECONDS, program
from tests.hubs import hub_with

READY: Final = b"\x04\x1c\x05READY\x0bSocket-Type\0\0\0\x06ROUTER"
"""The command with which a hub follows its greeting."""


@pytest.mark.parametrize("language", [CPP, RUST], ids=lambda language: language.name)
def test_seed_beyond_the_range_is_refused_at_once(language: Language) -> None:
    """A hub answers no header with such a number, so the experiment would repeat it without end."""
    language.ready()
    with hub_with(SkeletonEnvironment(), RandomAgent()) as url:
        done = run(
            [*language.programs["experiment"], "1", str(2**63)], language.folder, SECONDS, 1, GLUE_HUB=url
        )

    assert f"integers are from 0 to 2^63 - 1, not {2**63}" in done.stderr


@pytest.mark.parametrize("language", LANGUAGES, ids=lambda language: language.name)
def test_silent_hub_whose_times_are_no_numbers_is_given_up(language: Language) -> None:
    language.ready()
    welcome = Message(Kind.WELCOME, "default", 1, (PROTOCOL_VERSION, False, math.nan, math.nan, MAX_BODY))
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(SECONDS)
        url = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with program(language.programs["random"], url):
            first, _ = server.accept()
            with first:
                first.sendall(zmtp.GREETING + READY + zmtp.encode(encode(welcome, FROM_HUB)))
                again, _ = server.accept()
                again.close()


@pytest.mark.parametrize("language", LANGUAGES, ids=lambda language: language.name)
def test_path_too_long_for_a_socket_is_an_error(language: Language) -> None:
    """No hub can ever listen there, so nobody waits for one."""
    language.ready()
    done = run(language.programs["random"], language.folder, SECONDS, 1, GLUE_HUB=f"ipc:///{'x' * 107}")

    assert f"the path of a Unix socket has at most 107 bytes, and /{'x' * 107} has 108" in done.stderr

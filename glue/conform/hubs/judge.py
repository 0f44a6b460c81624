"""Judge a hub: one rule after the other, each by its scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

from glue.client.libzmq import Context
from glue.conform.hubs.rules import RULES
from glue.conform.hubs.scripted import Scene
from glue.conform.rules import Broken, Verdict
from glue.hub.config import check_url


def judge_hub(url: str, *, wait: float = 5.0) -> Iterator[Verdict]:
    """Judge the hub at `url` by the rules for hubs; yield a verdict on each.

    Args:
        url: address of the hub, which may be in use: each rule has a session of its own.
        wait: timeout of each message, in seconds.

    Raises, while iterating:
        ConfigError: `url` is malformed.
    """
    check_url(url)
    with Context() as context:
        for rule in RULES:
            verdict = Verdict(rule, url.partition(":")[0])
            with closing(Scene(rule.name, context, url, wait)) as scene:
                try:
                    rule.scene(scene)
                except Broken as broken:
                    verdict = verdict.failed(broken)
            yield verdict

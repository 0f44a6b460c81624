"""A language model behind an endpoint of the common chat-completions form, which is not trusted: a request
is bounded in time and size, and never redirected.
"""

from __future__ import annotations

import json
import os
import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from time import sleep
from typing import Annotated, Any, ClassVar, Final, NamedTuple
from urllib.parse import urlsplit

from agents.language.game import UNTIL, GameOptions, LanguageAgent, Until
from glue.console import LOG, one_line
from glue.errors import ConfigError, GlueError
from glue.options import Option, Value
from glue.system.web import NoAnswer, ask, is_address

KEY_VARIABLE: Final = "GLUE_CHAT_KEY"
"""The environment variable of the endpoint's key, which is no option because options are recorded."""

_MOST_SHOWN: Final = 200  # letters of what an endpoint says
_PATH: Final = "/chat/completions"
_LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")


class EndpointFailed(GlueError):
    """The endpoint gave no usable answer; the message says what came instead."""


class EndpointBusy(EndpointFailed):
    """The same, but another try may help."""


class Endpoint:
    """An address that answers chats in the common form.

    Args:
        url: its base, such as http://127.0.0.1:8080/v1, or the whole address.
        key: what it wants as proof of who asks; None if nothing.

    Raises:
        ConfigError: it is no such address, or the key would travel in clear text.
    """

    def __init__(self, url: str, key: str | None = None) -> None:
        if not is_address(url):
            text = f"without a password or parameters, as it is recorded (a key is given by {KEY_VARIABLE})"
            raise ConfigError(
                f"url is an address such as http://127.0.0.1:8080/v1, {text}", settings=("url",)
            )
        parts = urlsplit(url)
        if key is not None and parts.scheme == "http" and parts.hostname not in _LOOPBACK:
            raise ConfigError("the key would travel in clear text: use https", settings=("url",))
        if not (key or "").isascii() or not (key or "").isprintable():
            raise ConfigError(f"{KEY_VARIABLE} is not a key: it has letters that cannot be sent")
        self._url = f"{url.rstrip('/').removesuffix(_PATH)}{_PATH}"
        self._key = key
        self._headers = {"Content-Type": "application/json"}
        if key is not None:
            self._headers["Authorization"] = f"Bearer {key}"

    def post(self, body: Mapping[str, Any], seconds: float) -> Reply:
        """Return the endpoint's reply.

        Args:
            body: of the request.
            seconds: for the whole exchange, however slowly the endpoint sends.

        Raises:
            EndpointFailed: there is no such answer in that time.
        """
        try:
            answer = ask("POST", self._url, seconds, json.dumps(body).encode(), self._headers)
        except NoAnswer as error:
            raise EndpointBusy(self._failed(str(error))) from None
        status, content, lack = answer.status, answer.json, ""
        if status == 200:
            if (reply := read_reply(content)) is not None:
                return reply
            lack = ", not with JSON" if content is None else ", with no text at choices[0].message.content"
        if 300 <= status < 400:
            words = f"a redirection to {answer.headers.get('Location')}, which is not followed"
        elif content is None:
            words = answer.data.decode("utf-8", "replace")
        else:
            words = json.dumps(content, ensure_ascii=False)
        failure = EndpointBusy if status == 429 or status >= 500 else EndpointFailed
        raise failure(self._failed(f"answered {status}{lack}: {words}"))

    def _failed(self, why: str) -> str:
        """Return the message of a failure, which is recorded, without the key: some endpoints repeat it."""
        hidden = why.replace(self._key, "(the key)") if self._key else why
        return f"the endpoint {self._url} {one_line(hidden, _MOST_SHOWN)}"


_WAITS: Final = (1.0, 4.0)
"""Seconds before the second and third try."""

_MOST_LETTERS: Final = 16_000  # of an answer that are read and shown again
_MOST_TOKENS: Final = 2**31
_DRESS: Final = " \t`*_>"  # around a line, in which models dress up what they write

_HOW: Final = f"""Each message shows how your last choice went and what you see. End your answer with one line
act: ACTION, ACTION, ...
after which `until CONDITION` may stop the sequence early, or with the line
give up
by which the episode ends with what standing still earns. Nothing above that line is read.
Conditions: {UNTIL}."""


@dataclass(kw_only=True)
class Options(GameOptions):
    """The options of the agent `chat`."""

    url: Annotated[str, Option("address of the endpoint, such as http://127.0.0.1:8080/v1")] = ""
    model: Annotated[str, Option("name of the model at the endpoint")] = ""
    temperature: Annotated[
        float | None, Option("of sampling; by default the endpoint's", low=0, high=100)
    ] = None
    top_p: Annotated[float | None, Option("of sampling; by default the endpoint's", low=0, high=1)] = None
    max_tokens: Annotated[int, Option("maximum length of an answer", low=1, unit="tokens")] = 1024
    timeout: Annotated[
        float, Option("time for one answer of the endpoint", low=0.1, high=86_400, unit="s")
    ] = 60.0
    memory: Annotated[int, Option("earlier choices that the model is shown", low=0, high=10_000)] = 10


class ChatAgent(LanguageAgent):
    """A language model behind an endpoint for chats, of the common chat-completions form.

    The environment variable GLUE_CHAT_KEY holds the endpoint's key, if it wants one. docs/language-models.md
    says what is recorded.
    """

    Options: ClassVar[type] = Options

    def __init__(self, **options: Value | None) -> None:
        super().__init__(Options(**options))  # type: ignore[arg-type]  # checked by `glue.options.build`
        if not self.options.url or not self.options.model:
            raise ConfigError("chat needs an endpoint's address and a model there", settings=("url", "model"))
        self._endpoint = Endpoint(self.options.url, os.environ.get(KEY_VARIABLE) or None)
        self._history: deque[dict[str, str]] = deque(maxlen=2 * self.options.memory)

    @property
    def how(self) -> str:
        return _HOW

    def agent_init(self, task_spec: str) -> None:
        super().agent_init(task_spec)
        self._history.clear()

    def choose(self) -> None:
        turn = self.game.turn
        answer, view = self.game.answer(turn - 1), self.game.view()
        illegal = f"{answer.text}\n" if answer is not None and answer.error else ""
        question = {"role": "user", "content": illegal + view.text}
        reply = self._ask([{"role": "system", "content": self.prompt}, *self._history, question])
        if reply is None:
            return
        self._history += (question, {"role": "assistant", "content": reply.text})
        self.game.note(*reply)
        actions, until = read_choice(reply.text)
        if actions == []:
            self.game.give_up(turn)
        else:
            self.game.act(turn, actions, until)

    def _ask(self, messages: list[dict[str, str]]) -> Reply | None:
        """Return the model's answer; None if the time of the episode is used up."""
        body = {"model": self.options.model, "messages": messages, "max_tokens": self.options.max_tokens}
        sampling = {"temperature": self.options.temperature, "top_p": self.options.top_p}
        body |= {name: value for name, value in sampling.items() if value is not None}
        waits = iter(_WAITS)
        while (left := self.game.time_left) > 0:
            try:
                return self._endpoint.post(body, min(self.options.timeout, left))
            except EndpointBusy as error:
                if (wait := next(waits, None)) is None:
                    raise
                LOG.warning("%s; asking again in %g s", error, wait)
                sleep(min(wait, self.game.time_left))
                self.game.counts.repeated += self.game.time_left > 0
        return None


class Reply(NamedTuple):
    """A model's answer, and the numbers of tokens that it read and wrote."""

    text: str
    tokens_in: int
    tokens_out: int


def read_reply(answer: Any) -> Reply | None:
    """Return the first message of an endpoint's answer; its text may be empty.

    None if it is no answer of the common form. A missing or malformed number of tokens counts as 0.
    """
    try:
        text = answer["choices"][0]["message"]["content"] or ""
    except (KeyError, IndexError, TypeError):
        return None
    if not isinstance(text, str):
        return None
    usage = answer.get("usage")
    usage = usage if isinstance(usage, dict) else {}
    counts = [usage.get(name) for name in ("prompt_tokens", "completion_tokens")]
    read, written = (n if type(n) is int and 0 <= n < _MOST_TOKENS else 0 for n in counts)
    return Reply(text[:_MOST_LETTERS], read, written)


def read_choice(text: str) -> tuple[list[str] | None, str]:
    """Return the actions of the last line that states a choice, none for `give up`, and when they stop.

    The actions are None if there is no such line.
    """
    for line in reversed(text.splitlines()):
        plain = line.lstrip(f"-{_DRESS}").rstrip(_DRESS).rstrip(".")
        if plain.lower() == "give up":
            return [], Until.END
        if plain.lower().startswith("act:"):
            actions, *until = re.split(r"[\s,]until\s", plain[4:], maxsplit=1, flags=re.IGNORECASE)
            names = [name.strip(_DRESS) for name in actions.rstrip(f",{_DRESS}").split(",")]
            return names, until[0].strip(_DRESS).lower() if until else Until.END
    return None, Until.END

"""A local endpoint of the common chat-completions form, whose answers are a function of the request."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

Handler = BaseHTTPRequestHandler
Reply = Callable[[dict[str, Any], Handler], object]
"""Gets the request's JSON. Returns an answer for JSON, bytes, or None if it has written one itself."""


def said(text: str | None, tokens: tuple[int, int] = (10, 4)) -> dict[str, Any]:
    """Return the answer of an endpoint whose model says `text`."""
    usage = dict(zip(("prompt_tokens", "completion_tokens"), tokens, strict=True))
    return {"choices": [{"message": {"role": "assistant", "content": text}}], "usage": usage}


@contextmanager
def endpoint(reply: Reply) -> Iterator[str]:
    """Yield the address of an endpoint that answers by `reply`."""

    class Answering(Handler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            answer = reply(body, self)
            if answer is None:
                return
            data = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()

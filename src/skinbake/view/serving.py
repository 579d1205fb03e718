"""Serve one page to the browser of this machine, and nothing else."""

from __future__ import annotations

import http.server
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from skinbake.errors import OutputError, Place

HOST = "127.0.0.1"


def serve(page: bytes, port: int, started: Callable[[str], None]) -> None:
    """Serve the page until an exception ends it, such as Ctrl-C.

    Port 0 takes any free one. ``started`` is called with the address once it answers. Raises OutputError if
    the port cannot be had.
    """
    try:
        server = http.server.ThreadingHTTPServer((HOST, port), _handler(page))
    except OSError as error:
        raise OutputError(
            f"port {port} cannot be used ({error.strerror}): choose another --port", Place("view")
        ) from error
    with server:
        started(f"http://{HOST}:{server.server_address[1]}/")
        server.serve_forever()


def _handler(page: bytes) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        def handle(self) -> None:
            with suppress(ConnectionError):  # the browser may leave before it has the page
                super().handle()

        def do_GET(self) -> None:
            # Another site may let its name point here. Its pages then ask with that name.
            # Browsers leave the port out if it is 80.
            host = self.headers.get("Host", "").partition(":")[0]
            if self.path != "/" or host not in {HOST, "localhost"}:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *arguments: Any) -> None:
            """Say nothing."""

    return Handler

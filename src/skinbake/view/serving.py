"""Serve one page to the browser of this machine, and nothing else."""

from __future__ import annotations

import http.server
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from skinbake.errors import OutputError, Place

HOST = "127.0.0.1"

PATIENCE = 10.0
"""The seconds in which a client must have asked. One that says nothing, or too slowly, is dropped."""

SENDING = 60.0
"""The seconds in which a client must have taken the page."""


def serve(page: bytes, port: int, started: Callable[[str], None]) -> None:
    """Serve the page until an exception ends it, such as Ctrl-C.

    Port 0 takes any free one. ``started`` is called with the address once it answers. Raises OutputError if
    the port cannot be had.
    """
    try:
        server = http.server.ThreadingHTTPServer((HOST, port), page_handler(page))
    except OSError as error:
        raise OutputError(
            f"port {port} cannot be used ({error.strerror}): choose another --port", Place("view")
        ) from error
    with server:
        started(f"http://{HOST}:{server.server_address[1]}/")
        server.serve_forever()


def page_handler(page: bytes) -> type[http.server.BaseHTTPRequestHandler]:
    """Return a handler of requests that gives the page to browsers of this machine, and nothing to others."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def handle(self) -> None:
            self.late = threading.Timer(PATIENCE, self._drop)
            self.late.daemon = True
            self.late.start()
            try:
                with suppress(ConnectionError):  # the browser may leave before it has the page
                    super().handle()
            finally:
                self.late.cancel()

        def _drop(self) -> None:
            with suppress(OSError):  # it has left
                self.connection.shutdown(socket.SHUT_RDWR)

        def do_GET(self) -> None:
            self.late.cancel()
            self.connection.settimeout(SENDING)
            # Another site may let its name point here. Its pages then ask with that name.
            port = self.connection.getsockname()[1]
            names = {f"{name}:{port}" for name in (HOST, "localhost")}
            if port == 80:  # browsers leave it out
                names |= {HOST, "localhost"}
            hosts = [host.lower() for host in self.headers.get_all("Host", [])]
            if self.path != "/" or len(hosts) != 1 or hosts[0] not in names:
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

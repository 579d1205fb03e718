"""The server of ``skinbake view``: the names under which it answers."""

from __future__ import annotations

import http.client
import http.server
import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest

from skinbake.view import serving

PAGE = b"<!doctype html><title>a page</title>" + bytes(20_000_000)
"""More than the buffers of a connection hold."""


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Serve PAGE, and return the port."""
    servers: list[http.server.ThreadingHTTPServer] = []
    ports: list[int] = []
    has_started = threading.Event()

    class Server(http.server.ThreadingHTTPServer):
        def serve_forever(self, poll_interval: float = 0.01) -> None:
            servers.append(self)
            ports.append(self.server_address[1])
            has_started.set()
            super().serve_forever(poll_interval)

    monkeypatch.setattr(http.server, "ThreadingHTTPServer", Server)
    thread = threading.Thread(target=serving.serve, args=(PAGE, 0, lambda address: None))
    thread.start()
    assert has_started.wait(20)
    yield ports[0]
    servers[0].shutdown()
    thread.join(20)


def answer(port: int, host: str) -> tuple[int, bytes]:
    """Return the status and the body of a request for the page that names the host so."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request("GET", "/", headers={"Host": host})
    found = connection.getresponse()
    result = found.status, found.read()
    connection.close()
    return result


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.0.0.1:80", "localhost:8000"])
def test_it_answers_under_its_own_names_with_and_without_a_port(port: int, host: str) -> None:
    # Browsers leave the port out of the name if it is 80.
    assert answer(port, host) == (200, PAGE)


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "localhost.evil.example", "", ":80", "[::1]", "[::1]:8000"]
)
def test_it_answers_under_no_other_name(port: int, host: str) -> None:
    # It listens on the IPv4 address alone: [::1] never leads to it.
    assert answer(port, host)[0] == 404


def test_a_browser_that_leaves_too_early_is_no_error(port: int, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert connection.recv(100).startswith(b"HTTP/1.0 200")
        # Close without the rest: the server's next bytes meet a reset.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    deadline = time.monotonic() + 20
    while any("process_request" in thread.name for thread in threading.enumerate()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert capfd.readouterr().err == ""
    assert answer(port, "localhost")[0] == 200

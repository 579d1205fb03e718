"""The server of ``skinbake view``: the names under which it answers."""

from __future__ import annotations

import http.client
import http.server
import socket
import struct
import threading
import time
from collections.abc import Iterator
from unittest.mock import Mock

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


@pytest.mark.parametrize("host", ["127.0.0.1:{}", "localhost:{}", "LocalHost:{}"])
def test_the_server_answers_under_its_own_names_and_port(port: int, host: str) -> None:
    assert answer(port, host.format(port)) == (200, PAGE)


@pytest.mark.parametrize(
    "host",
    [
        *(
            "127.0.0.1",
            "localhost",
            "localhost:",
            "localhost:80",
            "localhost:1",
            "localhost:0{}",
            "localhost.:{}",
        ),
        *("evil.example", "evil.example:{}", "localhost.evil.example:{}", "evil@localhost:{}", "", ":{}"),
        *(
            "127.1:{}",
            "0.0.0.0:{}",
            "2130706433:{}",
            "localhost:{0}:{0}",
            "localhost:{},evil.example",
            "localhost.:{}",
        ),
        *("[::1]", "[::1]:{}"),
    ],
)
def test_the_server_answers_under_no_other_name(port: int, host: str) -> None:
    # It listens on the IPv4 address alone: [::1] never leads to it.
    assert answer(port, host.format(port))[0] == 404


def test_a_browser_leaves_port_80_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the administrator may listen there, so the handler meets a connection of its own."""
    ours, theirs = socket.socketpair()
    named = Mock(wraps=ours, getsockname=lambda: ("127.0.0.1", 80))
    theirs.sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
    serving.page_handler(b"a page")(named, ("127.0.0.1", 5), Mock())
    ours.close()
    assert theirs.makefile("rb").read().endswith(b"\r\n\r\na page")
    theirs.close()


@pytest.mark.parametrize(
    "head", ["", "Host: localhost:{0}\r\nHost: localhost:{0}\r\n", "Host: localhost:{0}\r\nHost: a\r\n"]
)
def test_the_server_answers_to_exactly_one_name(port: int, head: str) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(f"GET / HTTP/1.1\r\n{head}\r\n".encode())
        assert connection.recv(12) == b"HTTP/1.0 404"


@pytest.mark.parametrize("said", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: local"])
def test_a_client_that_does_not_ask_is_dropped(
    port: int, monkeypatch: pytest.MonkeyPatch, said: bytes
) -> None:
    monkeypatch.setattr(serving, "PATIENCE", 0.05)
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(said)
        assert connection.recv(1) == b""


def test_a_client_that_takes_no_page_is_dropped(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "SENDING", 0.05)
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
        assert connection.recv(12) == b"HTTP/1.0 200"
        deadline = time.monotonic() + 20
        while any("process_request" in thread.name for thread in threading.enumerate()):
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_browser_that_leaves_too_early_is_no_error(port: int, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        connection.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
        assert connection.recv(100).startswith(b"HTTP/1.0 200")
        # Close without the rest: the server's next bytes meet a reset.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    deadline = time.monotonic() + 20
    while any("process_request" in thread.name for thread in threading.enumerate()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert capfd.readouterr().err == ""
    assert answer(port, f"localhost:{port}")[0] == 200

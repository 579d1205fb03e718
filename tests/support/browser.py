"""Drive Chromium without a window over its debugging pipe: no driver, no package, WebGL 2 on the processor.

The protocol is https://chromedevtools.github.io/devtools-protocol: JSON objects that end in zero, which
the browser reads from descriptor 3 and writes to 4.
"""

from __future__ import annotations

import base64
import functools
import http.server
import json
import os
import select
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from tests.support.strictness import missing_tool

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--remote-debugging-pipe",
)
PRESENTING = ("--enable-features=Vulkan", "--use-vulkan=swiftshader", "--disable-vulkan-surface")
"""Further arguments for a page that shows WebGPU on a canvas, and does not only draw into textures."""
CODES = {"Tab": (9, ""), "Enter": (13, "\r"), "ArrowDown": (40, "")}
"""The number of a key by which the browser itself acts on it, and the text that it types."""

SECONDS = 120
"""The longest that one call may take."""

WHEN_READY = """(async () => {
    while (!window.ready) await new Promise(requestAnimationFrame);
    await window.ready;
})"""

JsonObject = dict[str, Any]


class Page:
    """One page of the browser: its global functions, and what it says on the console."""

    def __init__(self, browser: _Pipe, address: str) -> None:
        self._browser, self.address = browser, address
        self._messages: list[str] = []
        self._requests: list[str] = []
        target = next(t for t in browser.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = browser.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")
        self.go(address if address.startswith("file:") else f"{address}/")

    def go(self, address: str) -> None:
        """Open an address, and wait until its promise ``window.ready`` is fulfilled."""
        self._send("Runtime.evaluate", expression="delete window.ready")
        failure = self._send("Page.navigate", url=address).get("errorText")
        if failure:
            raise RuntimeError(f"{address}: {failure}")
        self.call(WHEN_READY)

    def call(self, function: str, *arguments: object) -> Any:
        """Call a global function, wait for its promise and return its value, which goes through JSON.

        Raises RuntimeError with the stack where it throws.
        """
        expression = f"{function}({', '.join(map(json.dumps, arguments))})"
        answer = self._send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        self._collect()
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def messages(self) -> list[str]:
        """Return the warnings and errors since the last time: the page's, and the browser's own of WebGL."""
        found, self._messages = self._messages, []
        return found

    def requests(self) -> list[str]:
        """Return the addresses that the page has asked for so far, without what it holds itself."""
        self._collect()
        return [address for address in self._requests if not address.startswith(("data:", "blob:"))]

    def screenshot(self) -> bytes:
        """Return all of the page as it looks, a PNG."""
        shot = self._send("Page.captureScreenshot", captureBeyondViewport=True)
        return base64.b64decode(shot["data"])

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the mouse at a place, move it to another one, and let it go."""
        for kind, (x, y) in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
            self._send(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
            )

    def move_mouse(self, x: float, y: float) -> None:
        """Point at a place."""
        self._send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def press(self, key: str) -> None:
        """Press a key, by its name, and let it go."""
        code, text = CODES.get(key, (0, ""))
        for kind in ("keyDown", "keyUp"):
            self._send("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, text=text)

    def show_as(self, width: int, height: int, scheme: str) -> None:
        """Give the page a size, and say whether its reader likes it light or dark."""
        self._send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self._send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def _send(self, method: str, **parameters: object) -> JsonObject:
        return self._browser.call(method, self._session, **parameters)

    def _collect(self) -> None:
        for event in self._browser.take_events():
            parameters = event["params"]
            if event["method"] == "Runtime.consoleAPICalled" and parameters["type"] in ("warning", "error"):
                words = [str(part.get("value", part.get("description"))) for part in parameters["args"]]
                self._messages.append(" ".join(words))
            elif event["method"] == "Log.entryAdded" and parameters["entry"]["level"] in ("warning", "error"):
                self._messages.append(parameters["entry"]["text"])
            elif event["method"] == "Network.requestWillBeSent":
                self._requests.append(parameters["request"]["url"])
            elif event["method"] == "Runtime.exceptionThrown":
                self._messages.append(json.dumps(parameters["exceptionDetails"]))


class _Pipe:
    """The browser's end of the protocol."""

    def __init__(self, reading: int, writing: int) -> None:
        self._reading, self._writing = reading, writing
        self._number, self._rest = 0, b""
        self._events: list[JsonObject] = []

    def call(self, method: str, session: str | None = None, **parameters: object) -> JsonObject:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._writing, data) :]
        deadline = time.monotonic() + SECONDS
        while True:
            answer = self._read(deadline)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                found: JsonObject = answer["result"]
                return found
            if "method" in answer:
                self._events.append(answer)

    def take_events(self) -> list[JsonObject]:
        events, self._events = self._events, []
        return events

    def _read(self, deadline: float) -> JsonObject:
        parts = [self._rest]
        while b"\0" not in parts[-1]:
            ready, _, _ = select.select([self._reading], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise TimeoutError(f"the browser did not answer within {SECONDS} s")
            data = os.read(self._reading, 1 << 20)
            if not data:
                raise RuntimeError("the browser ended")
            parts.append(data)
        message, _, self._rest = b"".join(parts).partition(b"\0")
        found: JsonObject = json.loads(message)
        return found


class _Handler(http.server.SimpleHTTPRequestHandler):
    """Serves one text as the page, and folders by the first part of the path."""

    extensions_map = {  # noqa: RUF012 - as the base class has it
        ".html": "text/html",
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        "": "application/octet-stream",
    }

    def __init__(self, *arguments: Any, page: str, folders: Mapping[str, Path], **options: Any) -> None:
        self._page, self._folders = page, folders
        super().__init__(*arguments, **options)

    def do_GET(self) -> None:
        if urlsplit(self.path).path != "/":
            super().do_GET()
            return
        data = self._page.encode()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def translate_path(self, path: str) -> str:
        first, _, rest = unquote(urlsplit(path).path).lstrip("/").partition("/")
        folder = self._folders.get(first, Path("/nonexistent")).resolve()
        found = (folder / rest).resolve()
        return str(found if found.is_relative_to(folder) else folder / "nonexistent")

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


def require_browser() -> str:
    """Return the path of Chromium; else skip, or fail under SKINBAKE_STRICT=1."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        missing_tool("chromium is not installed")
    return found


@contextmanager
def opened(
    page: str, folders: Mapping[str, Path], scratch: Path, arguments: Sequence[str] = ()
) -> Iterator[Page]:
    """Start the browser on a page and yield it once the page's promise ``window.ready`` is fulfilled.

    page is HTML; folders are served beside it under their names; scratch is an empty folder for the browser's
    files, among them ``stderr.txt``; arguments are further ones of the browser's.
    """
    program = require_browser()
    handler = functools.partial(_Handler, page=page, folders=folders)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            with _running(program, scratch, arguments) as pipe:
                yield Page(pipe, f"http://127.0.0.1:{server.server_address[1]}")
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def opened_file(path: Path, scratch: Path) -> Iterator[Page]:
    """Open a page from the disk, as a double click does, and yield it like ``opened``."""
    with _running(require_browser(), scratch) as pipe:
        yield Page(pipe, path.resolve().as_uri())


@contextmanager
def _running(program: str, scratch: Path, arguments: Sequence[str] = ()) -> Iterator[_Pipe]:
    their_reading, writing = os.pipe()
    reading, their_writing = os.pipe()
    # A shell gives the browser the two descriptors under the numbers that it wants.
    command = f'exec "$@" 3</dev/fd/{their_reading} 4>/dev/fd/{their_writing}'
    with (scratch / "stderr.txt").open("wb") as stderr:
        process = subprocess.Popen(
            [
                *("sh", "-c", command, "sh", program, *ARGUMENTS, *arguments),
                *(f"--user-data-dir={scratch}", "about:blank"),
            ],
            pass_fds=(their_reading, their_writing),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,
        )
    os.close(their_reading)
    os.close(their_writing)
    try:
        yield _Pipe(reading, writing)
    finally:
        os.close(writing)
        os.close(reading)
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the browser, which stops by itself when its pipe closes, and the processes of its group."""
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

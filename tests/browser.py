"""One headless Chromium for a session of tests, driven over a pipe: what pages say, ask for and show.

The pipe (``--remote-debugging-pipe``) opens no port, and Chromium ends when it is closed, whatever happened to the
tests. No host name can be looked up, so a page that asks for one is found out, and nobody is called.
"""

from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NEEDED = "chromium is not installed: the page was not looked at"

FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-dev-shm-usage"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--hide-scrollbars", "--remote-debugging-pipe"),
    # Chromium's own services are not called either.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]

#: Puts the pipe's ends to where Chromium looks for them, then becomes Chromium.
_START = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); "
    "os.execv(sys.argv[3], sys.argv[3:])"
)


class BrowserError(Exception):
    """The browser or a page's script failed, or what was waited for did not come."""


@dataclass
class Tab:
    """A window with one page: the lines of its console, and every address that it asked for."""

    browser: Browser
    session: str
    console: list[tuple[str, str]] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    loaded: bool = False

    @property
    def elsewhere(self) -> list[str]:
        """Every address asked for that is neither the page's own file or host, nor within the page."""
        own = urlsplit(self.evaluate("location.href"))
        return [
            url
            for url in self.requests
            if (to := urlsplit(url)).scheme not in ("data", "blob")
            and (to.path != own.path if own.scheme == "file" else to.netloc != own.netloc)
        ]

    @property
    def complaints(self) -> list[tuple[str, str]]:
        """Errors and warnings."""
        self.evaluate("0")  # what has come until now
        return [line for line in self.console if line[0] in ("error", "warning")]

    def evaluate(self, script: str) -> Any:
        """The value of an expression; a promise is waited for."""
        answer = self._call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise BrowserError(str(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def wait_for(self, condition: str, timeout: float = 20.0) -> Any:
        """The value of an expression once it is true."""
        end = time.monotonic() + timeout
        while not (value := self.evaluate(condition)):
            if time.monotonic() > end:
                raise BrowserError(condition)
            time.sleep(0.02)
        return value

    def screenshot(self) -> NDArray[np.uint8]:
        """What the window shows after three frames, shape (height, width, 3)."""
        self.evaluate(
            "new Promise((done) => { const frame = (left) => left "
            "? requestAnimationFrame(() => frame(left - 1)) : done(); frame(3); })"
        )
        answer = self._call("Page.captureScreenshot", format="png")
        with Image.open(io.BytesIO(base64.b64decode(answer["data"]))) as image:
            return np.asarray(image.convert("RGB"))

    def click(self, selector: str) -> None:
        """Click on the middle of an element, as a hand does."""
        box = self.evaluate(
            f"(() => {{ const b = document.querySelector({json.dumps(selector)}).getBoundingClientRect(); "
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        self.mouse(box[0], box[1], click=True)

    def mouse(self, x: float, y: float, *, click: bool = False) -> None:
        """Move the mouse to a place in the window [px], and click there if asked."""
        self._call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased") if click else ():
            self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def key(self, name: str, code: int) -> None:
        """Press a key that has no letter, such as ``"ArrowLeft"``, 37."""
        words = {"key": name, "code": name, "windowsVirtualKeyCode": code}
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, **words)

    def pdf(self) -> bytes:
        """The page as printed."""
        answer = self._call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
        return base64.b64decode(answer["data"])

    def hear(self, method: str, said: dict[str, Any]) -> None:
        """Take an event of this page."""
        if method == "Page.loadEventFired":
            self.loaded = True
        elif method == "Runtime.consoleAPICalled":
            text = " ".join(str(a.get("value", a.get("description"))) for a in said["args"])
            self.console.append((said["type"], text))
        elif method == "Runtime.exceptionThrown":
            self.console.append(("error", str(said["exceptionDetails"])))
        elif method == "Log.entryAdded" and "GL Driver Message" not in said["entry"]["text"]:
            self.console.append((said["entry"]["level"], said["entry"]["text"]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(said["url"])

    def _call(self, method: str, **params: Any) -> dict[str, Any]:
        """A command to this page."""
        return self.browser.call(method, params, self.session)


class Browser:
    """Chromium, to be closed at the end."""

    def __init__(self) -> None:
        if CHROMIUM is None:
            raise BrowserError(NEEDED)
        self._profile = tempfile.TemporaryDirectory(
            prefix="calib-chromium-", ignore_cleanup_errors=True
        )
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # Away from 3 and 4, which they become.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 16) for end in (theirs_in, theirs_out)]
        command = [sys.executable, "-ISc", _START, *map(str, ends), CHROMIUM, *FLAGS]
        command += [f"--user-data-dir={self._profile.name}", "about:blank"]
        null = subprocess.DEVNULL
        self.process = subprocess.Popen(
            command, stdin=null, stdout=null, stderr=null, pass_fds=ends
        )
        for end in (theirs_in, theirs_out, *ends):
            os.close(end)
        self._rest, self._last = b"", 0
        self._answers: dict[int, dict[str, Any]] = {}
        self._tabs: dict[str, Tab] = {}

    @contextmanager
    def open(self, url: str, size: tuple[int, int] = (1280, 720)) -> Iterator[Tab]:
        """A window of its own with a page: no cookie and no store of another's."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        try:
            metrics = {"width": size[0], "height": size[1]}
            blank = {"url": "about:blank", "browserContextId": context, **metrics}
            target = self.call("Target.createTarget", blank)["targetId"]
            attached = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})
            tab = self._tabs[attached["sessionId"]] = Tab(self, attached["sessionId"])
            for part in ("Page", "Runtime", "Log", "Network"):
                tab._call(f"{part}.enable")
            metrics |= {"deviceScaleFactor": 1, "mobile": False}
            tab._call("Emulation.setDeviceMetricsOverride", **metrics)
            answer = tab._call("Page.navigate", url=url)
            if answer.get("errorText"):
                raise BrowserError(f"{url}: {answer['errorText']}")
            self._pump(lambda: tab.loaded, f"{url} to load")
            yield tab
        finally:
            with suppress(BrowserError, OSError):  # not in place of what went wrong before
                self.call("Target.disposeBrowserContext", {"browserContextId": context})

    def call(
        self, method: str, params: dict[str, Any] | None = None, session: str | None = None
    ) -> dict[str, Any]:
        """The answer to a command of the DevTools protocol."""
        self._last += 1
        number = self._last
        message = {"id": number, "method": method, "params": params or {}}
        if session is not None:
            message["sessionId"] = session
        data = memoryview(json.dumps(message).encode() + b"\0")
        while data:
            data = data[os.write(self._out, data) :]
        self._pump(lambda: number in self._answers, f"{method} to be answered")
        answer = self._answers.pop(number)
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error'].get('message')}")
        result: dict[str, Any] = answer["result"]
        return result

    def _pump(self, done: Callable[[], bool], what: str, timeout: float = 60.0) -> None:
        """Take what Chromium says until something is done."""
        end = time.monotonic() + timeout
        while not done():
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            piece = os.read(self._in, 2**20) if ready else b""
            if not piece:
                raise BrowserError(
                    f"waiting for {what}: Chromium ended, or {timeout:g} s were over"
                )
            *whole, self._rest = (self._rest + piece).split(b"\0")
            for message in map(json.loads, whole):
                if "id" in message:
                    self._answers[message["id"]] = message
                elif message.get("sessionId") in self._tabs:
                    self._tabs[message["sessionId"]].hear(message["method"], message["params"])

    def close(self) -> None:
        """End Chromium and remove its folder."""
        os.close(self._out)  # which it takes as its end
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self._in)
        self._profile.cleanup()

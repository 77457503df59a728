"""The picture of one or two robots in a browser, moved by this program; meshcat draws more on it.

A thread of this process serves it, at 127.0.0.1 only; meshcat's own server listens on all addresses
(https://github.com/meshcat-dev/meshcat-python/issues/14).
"""

from __future__ import annotations

import asyncio
import atexit
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, overload

import meshcat
import numpy as np
import umsgpack
from numpy.typing import ArrayLike
from tornado.httpserver import HTTPServer
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketHandler

from calib.errors import CalibError, ModelError, choices
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.viewer.page import floats, puppets, view_page
from calib.viewer.scene import SCENE
from calib.viewer.shapes import packed, read_visuals
from calib.viewer.view import View, view_of, view_of_robots

#: The only address listened on: other computers cannot reach it.
HOST = "127.0.0.1"


class Viewer:
    """A view at ``url``, on this computer only, until it is closed or the program ends.

    Example:
        with Viewer(view_of(calibration)) as viewer:
            viewer.open()
            viewer.display(np.zeros(6))
            viewer.wait()

    Args:
        view: What is shown.
        port: Where to listen on 127.0.0.1; 0 for any port that is free.

    Attributes:
        url: Where the page is.
        port: Where it listens on 127.0.0.1.
        visualizer: meshcat's, to draw more: in the base frame of the calibrated robot, or of the only one [m].
        warnings: What could not be drawn as the URDF says.

    Raises:
        CalibError: The port is in use.
    """

    def __init__(self, view: View, *, port: int = 0) -> None:
        k, places = view.start, ("nominal_target", "calibrated_target", "T_base_nominal")
        at: dict[str, Any] = {name: getattr(view, name)[k] for name in places}
        self._one = View(view.nominal, view.calibrated, view.q[k : k + 1], **at)
        self._visuals = {who: read_visuals(one.urdf)[0] for who, one in view.robots.items()}
        page = view_page(view, live=True)
        self.warnings: tuple[str, ...] = page.warnings
        listener = _listening(port)
        self.port: int = listener.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"
        self._sent: dict[tuple[str, ...], bytes] = {}
        self._windows: set[WebSocketHandler] = set()
        self._loop, self._stop = asyncio.new_event_loop(), asyncio.Event()
        # Not the thread's join: one that Ctrl-C interrupts takes the thread for ended.
        self._ended = threading.Event()
        threading.Thread(target=self._run, args=[page.html, listener], daemon=True).start()
        root = meshcat.Visualizer.view_into(self, meshcat.path.Path())
        self.visualizer: meshcat.Visualizer = root[SCENE][tuple(view.robots)[-1]]["own"]
        # Otherwise the interpreter would take the thread away from under its sockets.
        atexit.register(self.close)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints in the order of `display`."""
        return self._one.nominal.joint_names

    def display(self, q: ArrayLike, label: str = "") -> None:
        """Move the robots.

        Args:
            q: shape (m,), [rad] or [m], in the order of `joint_names`.
            label: What the pose is called on the page.

        Raises:
            ModelError: There are not as many finite values as joints.
            CalibError: The viewer is closed.
        """
        values = np.asarray(q, dtype=np.float64)
        if values.shape != (len(self.joint_names),) or not np.all(np.isfinite(values)):
            raise ModelError(
                f"q is {values.tolist()}; give a finite value for each joint, [rad] or [m]: "
                f"{choices(self.joint_names)}."
            )
        shown = puppets(replace(self._one, q=values[None]), self._visuals)
        robots = {who: floats(packed(puppet.poses)) for who, puppet in shown.items()}
        # Windows that open later are told of it as they are of a transform.
        pose = {"label": label, "robots": robots}
        told = {"type": "set_transform", "path": "/pose", "pose": pose}
        self.send(SimpleNamespace(lower=lambda: told))

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Draw, move or remove, in all windows, also in those that open later; `CalibError` once it is closed."""
        if self._ended.is_set():
            raise CalibError(f"{self.url} was closed, and shows nothing any more; open a new one.")
        self._loop.call_soon_threadsafe(self._take, command.lower())

    def _take(self, message: dict[str, Any]) -> None:
        """Keep the last message of each kind about each node, and tell the windows."""
        path, data = message["path"], umsgpack.packb(message)
        if message["type"] == "delete":
            inside = f"{path}/"
            self._sent = {k: v for k, v in self._sent.items() if not f"{k[0]}/".startswith(inside)}
        else:
            key = (path, message["type"], message.get("property", ""))
            self._sent.pop(key, None)
            self._sent[key] = data
        for window in self._windows:
            window.write_message(data, binary=True)

    def open(self) -> bool:
        """Open the page in the browser; False if none was found, or one that would take over the terminal."""
        windows = sys.platform in ("win32", "darwin") or any(
            os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
        )
        return windows and webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait for Ctrl-C; the viewer is closed afterwards."""
        try:
            while not self._ended.wait(
                0.5
            ):  # one without end cannot be interrupted on every system
                pass
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Free the port; the windows keep their picture. Once closed, it does nothing."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        self._ended.wait()
        atexit.unregister(self.close)

    def __enter__(self) -> Viewer:
        """The viewer, to be closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def _run(self, page: bytes, listener: socket.socket) -> None:
        """The thread."""
        self._loop.run_until_complete(self._serve(page, listener))
        self._loop.close()
        self._ended.set()

    async def _serve(self, page: bytes, listener: socket.socket) -> None:
        """Answer until asked to stop, then leave nothing open."""
        app = Application(log_function=lambda _: None)
        handlers = [("/", _Page, {"page": page}), ("/live", _Window, {"viewer": self})]
        # A web site may let its own name point to 127.0.0.1: who asks for another host finds nothing.
        app.add_handlers(r"127\.0\.0\.1|localhost", handlers)  # type: ignore[arg-type]
        http = HTTPServer(app)
        http.add_socket(listener)
        await self._stop.wait()
        http.stop()
        for window in tuple(self._windows):
            window.close(1001, "closed")
        await asyncio.sleep(0.05)  # for their farewell
        await http.close_all_connections()


class _Page(RequestHandler):
    """The page."""

    def initialize(self, page: bytes) -> None:
        """Keep it; called by tornado."""
        self._page = page

    def get(self) -> None:
        """Send it."""
        self.set_header("Cache-Control", "no-store")
        self.write(self._page)


class _Window(WebSocketHandler):
    """The connection of a page that is open."""

    def initialize(self, viewer: Viewer) -> None:
        """Keep it; called by tornado."""
        self._viewer = viewer

    def open(self) -> None:
        """Tell it what was drawn."""
        self._viewer._windows.add(self)
        for data in self._viewer._sent.values():
            self.write_message(data, binary=True)

    def on_close(self) -> None:
        """Forget it."""
        self._viewer._windows.discard(self)

    def on_message(self, message: object) -> None:
        """Windows have nothing to tell."""


def _listening(port: int) -> socket.socket:
    """A socket that listens on 127.0.0.1; `CalibError` where it cannot."""
    try:
        listener = socket.create_server((HOST, port))
    except OSError as error:
        raise CalibError(
            f"Port {port} of {HOST} cannot be used ({error.strerror}); give another number, or 0 for any that is free."
        ) from error
    listener.setblocking(False)
    return listener


def serve(view: View, *, port: int, browser: bool, say: Callable[[str], object]) -> None:
    """Show a page until Ctrl-C, or until the process is asked to end; what is said goes to ``say``."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Viewer(view, port=port) as viewer, suppress(KeyboardInterrupt):
        lines = [f"Not drawn as in the URDF: {text}" for text in viewer.warnings]
        say(
            "\n".join(
                [*lines, f"The picture is at {viewer.url} on this computer. Ctrl-C stops it."]
            )
        )
        if browser and not viewer.open():
            at = viewer.port
            say(f"No browser was found. From elsewhere: ssh -L {at}:127.0.0.1:{at} THIS_COMPUTER")
        viewer.wait()
    say("Stopped.")


@overload
def view(
    shown: Calibration | Robot, other: Robot | None = None, *, live: Literal[False] = False
) -> Path: ...


@overload
def view(
    shown: Calibration | Robot, other: Robot | None = None, *, live: Literal[True]
) -> Viewer: ...


def view(
    shown: Calibration | Robot, other: Robot | None = None, *, live: bool = False
) -> Path | Viewer:
    """Open the picture of a calibration, of a robot or of two robots in the browser.

    A ``live`` page is served by this program, which can move the robots and draw more, until the viewer is closed.
    Otherwise it is a file in a temporary folder of its own. Two robots must have the same joints.
    """
    if isinstance(shown, Calibration):
        scene = view_of(shown)
    else:
        names = (("First", shown.urdf.source), ("Second", (other or shown).urdf.source))
        scene = view_of_robots(shown, other, names=names)
    if live:
        viewer = Viewer(scene)
        webbrowser.open(viewer.url)
        return viewer
    page = view_page(scene).write(Path(tempfile.mkdtemp(prefix="calib-")) / "view.html")
    webbrowser.open(page.as_uri())
    return page

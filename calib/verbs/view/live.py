"""The page of robots, served live to this computer only, and the picture that opens in the browser.

A live page is moved by this program, and meshcat draws more on it; a thread serves it at 127.0.0.1 only, where
meshcat's own server listens on all addresses (https://github.com/meshcat-dev/meshcat-python/issues/14).
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
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

import calib.show.scene.scene as stage
from calib.basics.arguments import check_flags, check_path, check_type
from calib.basics.files import check_writable
from calib.data.cell import Cell
from calib.data.inputs import ROBOT, RobotInput, robot_of
from calib.errors import ArgumentError, CalibError, ModelError, choices
from calib.result.calibration import Calibration
from calib.result.result_input import RESULT, is_result_file, result_of
from calib.robot.robot import Robot
from calib.show.scene.html_page import floats
from calib.show.scene.puppet import packed, read_visuals
from calib.verbs.view.page import puppets, view_page
from calib.verbs.view.view import View, view_of, view_of_result, view_of_robots

#: The only address listened on: other computers cannot reach it.
HOST = "127.0.0.1"

#: Variables that tell that a Linux computer has a graphical browser.
_BROWSER_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


class Viewer(AbstractContextManager["Viewer"]):
    """A live page at ``url``, on this computer only, until it is closed or the program ends.

    Attributes:
        url: Address of the page.
        port: Port that it is served at.
        joint_names: Joints of `display`, in order.
        visualizer: meshcat's, to draw more: in the base frame of the calibrated robot, or of the only one [m].
        warnings: A sentence for each shape that is not drawn as the URDF says.

    Example:
        with Viewer(view_of(calibration)) as viewer:
            viewer.open()
            viewer.display(np.zeros(6))
            viewer.wait()
    """

    def __init__(self, view: View, *, port: int = 0) -> None:
        """Serve a page.

        Args:
            view: The content of the page.
            port: The port; 0 for any that is free.

        Raises:
            CalibError: The port is in use.
        """
        self._pose = _start_pose(view)
        self.joint_names: tuple[str, ...] = view.nominal.joint_names
        self._visuals = {name: read_visuals(robot.urdf)[0] for name, robot in view.robots.items()}
        page = view_page(view, live=True)
        self.warnings: tuple[str, ...] = page.warnings
        listener = _listen(port)
        self.port: int = listener.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"
        self._sent: dict[tuple[str, ...], bytes] = {}
        self._windows: set[WebSocketHandler] = set()
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        # Not the thread's join: one that Ctrl-C interrupts takes the thread for ended.
        self._ended = threading.Event()
        threading.Thread(target=self._run, args=[page.html, listener], daemon=True).start()
        root = meshcat.Visualizer.view_into(self, meshcat.path.Path())
        robot = root[stage.SCENE][tuple(view.robots)[-1]]
        self.visualizer: meshcat.Visualizer = robot["own"]

    def display(self, q: ArrayLike, label: str = "") -> None:
        """Move the robots.

        Args:
            q: shape (m,), [rad] or [m], in the order of `joint_names`.
            label: Name of the pose on the page.

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
        shown = puppets(replace(self._pose, q=values[None]), self._visuals)
        robots = {name: floats(packed(puppet.poses)) for name, puppet in shown.items()}
        # Sent as a transform of a node, so that windows that open later get it too.
        pose = {"label": label, "robots": robots}
        message = {"type": "set_transform", "path": "/pose", "pose": pose}
        self.send(SimpleNamespace(lower=lambda: message))

    def send(self, command: Any) -> None:  # noqa: ANN401  a command of meshcat
        """Draw, move or remove, in all windows, also in those that open later.

        Args:
            command: A command of meshcat; its ``lower()`` is the message.

        Raises:
            CalibError: The viewer is closed.
        """
        if self._ended.is_set():
            raise CalibError(f"{self.url} was closed, and shows nothing any more; open a new one.")
        self._loop.call_soon_threadsafe(self._forward, command.lower())

    def _forward(self, message: dict[str, Any]) -> None:
        """Keep the last message of each kind about each node, and send it to the windows."""
        path = message["path"]
        data = umsgpack.packb(message)
        if message["type"] == "delete":
            self._forget(path)
        else:
            key = (path, message["type"], message.get("property", ""))
            self._sent.pop(key, None)
            self._sent[key] = data
        for window in self._windows:
            window.write_message(data, binary=True)

    def _forget(self, path: str) -> None:
        """Drop the messages about a node and about the nodes below it."""
        gone = [key for key in self._sent if f"{key[0]}/".startswith(f"{path}/")]
        for key in gone:
            del self._sent[key]

    def open(self) -> bool:
        """Open the page in the browser; False if there is none, or one that would take over the terminal."""
        has_windows = sys.platform in ("win32", "darwin")
        has_display = any(os.environ.get(name) for name in _BROWSER_VARIABLES)
        return (has_windows or has_display) and webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait for Ctrl-C; the viewer is closed afterwards."""
        # A wait without end cannot be interrupted on every system.
        with self, suppress(KeyboardInterrupt):
            while not self._ended.wait(0.5):
                pass

    def close(self) -> None:
        """Free the port; the windows keep their picture. A second call does nothing."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        self._ended.wait()

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def _run(self, page: bytes, listener: socket.socket) -> None:
        """Serve the page until asked to stop; runs in a thread."""
        self._loop.run_until_complete(self._serve(page, listener))
        self._loop.close()
        self._ended.set()

    async def _serve(self, page: bytes, listener: socket.socket) -> None:
        """Answer until asked to stop, then leave nothing open."""
        app = Application(log_function=lambda _: None)
        # A web site may let its own name point to 127.0.0.1: requests for another host are not answered.
        handlers: Any = [("/", _Page, {"page": page}), ("/live", _Window, {"viewer": self})]
        app.add_handlers(r"127\.0\.0\.1|localhost", handlers)
        http = HTTPServer(app)
        listener.setblocking(False)
        http.add_socket(listener)
        await self._stop.wait()
        http.stop()
        for window in tuple(self._windows):
            window.close(1001, "closed")
        await asyncio.sleep(0.05)  # for their farewell
        await http.close_all_connections()


def _start_pose(view: View) -> View:
    """Return the view of one pose, the first shown, with its targets and bases; `Viewer.display` replaces its q."""
    k = view.start
    return View(
        view.nominal,
        view.calibrated,
        view.q[k : k + 1],
        nominal_target=view.nominal_target[k],
        calibrated_target=view.calibrated_target[k],
        T_base_nominal=view.T_base_nominal[k],
    )


def _listen(port: int) -> socket.socket:
    """Open a socket at a port of this computer; 0 for any that is free."""
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise CalibError(
            f"Port {port} of {HOST} cannot be used ({error.strerror}); give another number, or 0 for any that is "
            "free."
        ) from error


class _Page(RequestHandler):
    """The page."""

    def initialize(self, page: bytes) -> None:
        """Keep it; called by tornado."""
        self._page = page

    def get(self) -> None:
        """Send it."""
        self.write(self._page)


class _Window(WebSocketHandler):
    """The connection of a page that is open."""

    def initialize(self, viewer: Viewer) -> None:
        """Keep the viewer; called by tornado."""
        self._viewer = viewer

    def open(self) -> None:
        """Send everything that was drawn so far."""
        self._viewer._windows.add(self)
        for data in self._viewer._sent.values():
            self.write_message(data, binary=True)

    def on_close(self) -> None:
        """Forget the window."""
        self._viewer._windows.discard(self)

    def on_message(self, message: object) -> None:
        """Ignore messages of windows."""


def serve(view: View, *, port: int, browser: bool, say: Callable[[str], object]) -> None:
    """Serve a page until Ctrl-C, or until the process is asked to end.

    Args:
        view: The content of the page.
        port: The port; 0 for any that is free.
        browser: Open the page in the browser.
        say: Prints a line.

    Raises:
        CalibError: The port is in use.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Viewer(view, port=port) as viewer, suppress(KeyboardInterrupt):
        for text in viewer.warnings:
            say(f"Not drawn as in the URDF: {text}")
        say(f"The picture is at {viewer.url} on this computer. Ctrl-C stops it.")
        if browser and not viewer.open():
            at = viewer.port
            say(f"No browser was found. From elsewhere: ssh -L {at}:127.0.0.1:{at} THIS_COMPUTER")
        viewer.wait()
    say("Stopped.")


#: A calibration, or the path of its file (.json); a robot, the path of its URDF or xacro, or its name.
Shown = Calibration | RobotInput


@overload
def view(
    shown: Shown,
    other: RobotInput | None = None,
    *,
    live: Literal[False] = False,
    path: str | Path | None = None,
    overwrite: bool = False,
) -> Path: ...


@overload
def view(shown: Shown, other: RobotInput | None = None, *, live: Literal[True]) -> Viewer: ...


def view(
    shown: Shown,
    other: RobotInput | None = None,
    *,
    live: bool = False,
    path: str | Path | None = None,
    overwrite: bool = False,
) -> Path | Viewer:
    """Show a calibration, a robot or two robots in the browser, or write the page as a file.

    Args:
        shown: A calibration, or the path of its file; or a robot, the path of its URDF or xacro, or its name such as
            ``"ur3"``. A result that was read from a file is shown without measurements.
        other: A second robot with the same joints, likewise.
        live: Serve the page by this program, which can move the robots and draw more, until the viewer is closed.
        path: Name of the file that the page is written to, completely or not at all; no browser opens. None: a file in
            a temporary folder of its own, which the browser opens.
        overwrite: Replace an existing file.

    Returns:
        The viewer of a live page; else the file's path.

    Raises:
        ArgumentError: An argument of another type, or a file for a live page.
        FileError: The file exists or cannot be written.
        ModelError: The robots have different joints.
    """
    check_flags(live=live, overwrite=overwrite)
    if path is not None:
        check_path("path", path)
        if live:
            raise ArgumentError("A live page is no file: leave out 'path' or 'live'.")
        check_writable(path, overwrite=overwrite)
    content = _content(shown, other)
    if path is not None:
        return view_page(content).write(path, overwrite=overwrite)
    if live:
        viewer = Viewer(content)
        webbrowser.open(viewer.url)
        return viewer
    folder = Path(tempfile.mkdtemp(prefix="calib-"))
    page = view_page(content).write(folder / "view.html")
    webbrowser.open(page.as_uri())
    return page


def _content(shown: Shown, other: RobotInput | None) -> View:
    """Return what `view` shows."""
    allowed = f"{RESULT}; or {ROBOT}"
    check_type("shown", shown, (Calibration, Robot, str, Path), allowed)
    if isinstance(shown, Calibration) or is_result_file(shown):
        result = result_of(shown, "shown")
        if result.fit_in_memory is None:
            return view_of_result(result, result.nominal)
        return view_of(result)
    first = robot_of(shown, argument="shown")
    second = None
    if other is not None:
        coupling = first.reading_coupling
        chain = Cell(base=first.base, tip=first.tip, coupling=coupling)
        second = robot_of(other, chain, argument="other")
    names = (("First", first.urdf.source), ("Second", (second or first).urdf.source))
    return view_of_robots(first, second, names=names)

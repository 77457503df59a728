"""The page of robots, as a file or served live.

It shows the nominal and the calibrated one side by side or overlaid, at every measured pose: its script
moves them from pose to pose and draws what was measured, with arrows at a stated magnification. Every name is escaped;
pages open from disk and load nothing. A live page is moved by this program, and meshcat draws more on it; a thread
serves it at 127.0.0.1 only, where meshcat's own server listens on all addresses
(https://github.com/meshcat-dev/meshcat-python/issues/14).
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
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
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

import calib.report.figure_base as look
import calib.viewer.scene as stage
from calib.errors import CalibError, ModelError, choices
from calib.result.calibration import CalibrationValues
from calib.robot.robot import Robot
from calib.units import Array
from calib.viewer.scene import Page
from calib.viewer.view import (
    Puppet,
    View,
    Visual,
    packed,
    read_visuals,
    translation,
    view_of,
    view_of_robots,
)

#: What the rows of each kind are called, in colours of their own.
_ROWS = {
    "estimation": (look.ESTIMATION, "measured, fitted"),
    "validation": (look.VALIDATION, "measured, held back"),
    "flagged": (look.OUTLIER, "measured, flagged"),
}

#: The only address listened on: other computers cannot reach it.
HOST = "127.0.0.1"

#: Between slider and legend below and the heading above, as a part of the picture, see `look_at`.
_TEXT = (-0.54, 0.67)

#: Radius of the target's ball and length of the nominal robot's typical arrow, as parts of the scene's size.
_BALL, _ARROW = 0.009, 0.12

#: Factors that arrows and the robots' difference can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def write_page(
    calibration: CalibrationValues, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write the page of a calibration, whole or not at all; see `Page.write`."""
    return view_page(view_of(calibration)).write(path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False) -> Page:
    """Draw a view; a ``live`` page listens to the server that it came from."""
    found = {who: read_visuals(robot.urdf) for who, robot in view.robots.items()}
    warnings = tuple(dict.fromkeys(text for _, texts in found.values() for text in texts))
    shown = puppets(view, {who: visuals for who, (visuals, _) in found.items()})
    first, two = slice(view.start, view.start + 1), len(shown) > 1
    start = np.concatenate([puppet.outline(first) for puppet in shown.values()])
    outline = np.concatenate([start, *(puppet.outline() for puppet in shown.values())])
    size = stage.span(outline)
    back = stage.row_direction(shown["nominal"].poses[view.start, :, :3, 3])
    right = np.array([-back[1], back[0], 0.0])
    # Side by side nothing of one robot reaches into the other.
    step = 0.5 * max(np.ptp(outline @ right) + 0.06 * size, 0.4 * size) * right
    offsets = {"nominal": -step, "calibrated": step} if two else {"nominal": 0.0 * step}
    # Labels stand at the foot, below the middle of a robot.
    across = start @ right
    foot = 0.5 * (across.min() + across.max()) * right
    foot[2] = start[:, 2].min()
    foot += (start[start[:, 2] < foot[2] + 0.2 * size] @ back).max() * back
    # A wild measurement must not make the robots small: what was measured far away is not looked at.
    one = np.vstack([outline, foot])
    side = stage.look_at(np.concatenate([one + at for at in offsets.values()]), back, _TEXT)
    over = stage.look_at(one, back, _TEXT)
    window, root, grid = stage.new_scene(side, size, foot[2])
    for who, puppet in shown.items():
        group = root[stage.SCENE][who]
        group.set_transform(translation(offsets[who] - side.centre))
        material = stage.solid(stage.COLOURS[who], front=who == "calibrated")
        stage.draw_puppet(group, puppet, view.start, material, _BALL * size)
    names = [name.lower() for name, _ in view.names[: len(shown)]]
    labels: list[tuple[Array, str, str, str]] = []
    if two:  # of one robot the heading says what it is
        for at, (name, meaning) in zip(offsets.values(), view.names, strict=True):
            labels.append((at + foot - side.centre, "side", name, meaning))
        meaning = f"{names[0]} solid, {names[1]} translucent"
        labels.append((foot - over.centre, "over", "Overlaid", meaning))
    factor = magnification(view, size)
    kinds = Counter(np.array(view.kinds)[np.isfinite(view.measured[:, 0])].tolist())
    table = script_table(view, shown) | {
        "places": {who: (offset - side.centre).tolist() for who, offset in offsets.items()},
        "over": (-over.centre).tolist(),
        "floor": (side.centre - over.centre).tolist(),
        "cameras": {"side": side.position, "over": over.position},
        "size": size,
        "ball": _BALL * size,
        "arrows": factor,
    }
    html = stage.filled_page(
        "robots.html",
        window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {' and '.join(names)}",
        warnings=warnings,
        grid=grid,
        legend=[
            (f"{text} ({kinds[kind]})", colour, kind)
            for kind, (colour, text) in _ROWS.items()
            if kinds[kind]
        ],
        names=names,
        beam=look.BEAM,
        groups=list(shown),
        view=view,
        two=two,
        factors=FACTORS,
        labels=labels,
        table=table,
        arrows=factor,
        live=live,
    )
    return Page(html, warnings)


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """The robots of a view by ``"nominal"`` and ``"calibrated"``, in the base of the calibrated one."""
    bases = view.T_base_nominal, np.broadcast_to(np.eye(4), (len(view.q), 4, 4))
    targets = view.nominal_target, view.calibrated_target
    return {
        who: Puppet.of(robot, view.q, visuals[who], *place)
        for (who, robot), *place in zip(view.robots.items(), bases, targets, strict=False)
    }


def magnification(view: View, size: float) -> int:
    """The factor of `FACTORS` that makes the typical arrow of the nominal robot well visible, of rows not flagged."""
    nominal, calibrated = view.predicted
    apart = np.linalg.norm((view.measured if view.measures else calibrated) - nominal, axis=1)
    apart = apart[np.isfinite(apart) & (np.array(view.kinds) != "flagged")]
    typical = float(np.median(apart)) if np.any(apart) else np.inf
    return max((factor for factor in FACTORS if factor * typical <= _ARROW * size), default=1)


def script_table(view: View, shown: Mapping[str, Puppet]) -> dict[str, Any]:
    """What the script needs of the poses, as values that JSON can hold; arrays as `floats`."""
    robots, links = {}, shown["nominal"].links
    colours = {kind: colour for kind, (colour, _) in _ROWS.items()}
    for who, puppet in shown.items():
        count = puppet.poses.shape[1]
        # Which mover of the nominal robot is the same; the last three are the frames of base, tip and target.
        same = [links.index(one) if one in links else -1 for one in puppet.links]
        robots[who] = {
            "movers": count,
            "poses": stage.floats(packed(puppet.poses)),
            "rods": [*map(list, puppet.rods), [count - 2, count - 1]],
            "same": [*same, *range(len(links), len(links) + 3)],
        }
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**stage.COLOURS, **colours, "beam": look.BEAM},
        "robots": robots,
        "measured": stage.floats(view.measured),
        "errors": [stage.floats(one) for one in view.errors],
        "angles": [stage.floats(one) for one in view.angles],
        "instruments": packed(view.instruments).tolist(),
    }


class Viewer(AbstractContextManager["Viewer"]):
    """A view at ``url``, on this computer only, until it is closed or the program ends; port 0 is any that is free.

    ``visualizer`` is meshcat's, to draw more: in the base frame of the calibrated robot, or of the only one [m].
    ``warnings`` say what could not be drawn as the URDF says; ``joint_names`` are those of `display`, in order.

    Example:
        with Viewer(view_of(calibration)) as viewer:
            viewer.open()
            viewer.display(np.zeros(6))
            viewer.wait()

    Raises:
        CalibError: The port is in use.
    """

    def __init__(self, view: View, *, port: int = 0) -> None:
        k, places = view.start, ("nominal_target", "calibrated_target", "T_base_nominal")
        at: dict[str, Any] = {name: getattr(view, name)[k] for name in places}
        self._one = View(view.nominal, view.calibrated, view.q[k : k + 1], **at)
        self.joint_names: tuple[str, ...] = view.nominal.joint_names
        self._visuals = {who: read_visuals(one.urdf)[0] for who, one in view.robots.items()}
        page = view_page(view, live=True)
        self.warnings: tuple[str, ...] = page.warnings
        try:
            listener = socket.create_server((HOST, port))
        except OSError as error:
            raise CalibError(
                f"Port {port} of {HOST} cannot be used ({error.strerror}); give another number, or 0 for any that is "
                "free."
            ) from error
        self.port: int = listener.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"
        self._sent: dict[tuple[str, ...], bytes] = {}
        self._windows: set[WebSocketHandler] = set()
        self._loop, self._stop = asyncio.new_event_loop(), asyncio.Event()
        # Not the thread's join: one that Ctrl-C interrupts takes the thread for ended.
        self._ended = threading.Event()
        threading.Thread(target=self._run, args=[page.html, listener], daemon=True).start()
        root = meshcat.Visualizer.view_into(self, meshcat.path.Path())
        self.visualizer: meshcat.Visualizer = root[stage.SCENE][tuple(view.robots)[-1]]["own"]

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
        robots = {who: stage.floats(packed(puppet.poses)) for who, puppet in shown.items()}
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
        # A wait without end cannot be interrupted on every system.
        with self, suppress(KeyboardInterrupt):
            while not self._ended.wait(0.5):
                pass

    def close(self) -> None:
        """Free the port; the windows keep their picture. Once closed, it does nothing."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        self._ended.wait()

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
        # A web site may let its own name point to 127.0.0.1: who asks for another host finds nothing.
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


def serve(view: View, *, port: int, browser: bool, say: Callable[[str], object]) -> None:
    """Show a page until Ctrl-C, or until the process is asked to end; what is said goes to ``say``."""
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


Shown = CalibrationValues | Robot


@overload
def view(shown: Shown, other: Robot | None = None, *, live: Literal[False] = False) -> Path: ...


@overload
def view(shown: Shown, other: Robot | None = None, *, live: Literal[True]) -> Viewer: ...


def view(shown: Shown, other: Robot | None = None, *, live: bool = False) -> Path | Viewer:
    """Open the picture of a calibration, of a robot or of two robots in the browser.

    A ``live`` page is served by this program, which can move the robots and draw more, until the viewer is closed.
    Otherwise it is a file in a temporary folder of its own. Two robots must have the same joints.
    """
    if isinstance(shown, CalibrationValues):
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

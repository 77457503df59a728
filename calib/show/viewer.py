"""The picture of one or two robots in a browser, moved by this program; meshcat draws more on it."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any

import meshcat
import numpy as np
import umsgpack
from meshcat.servers.tree import SceneTree, find_node, walk
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError, ModelError, choices
from calib.show.motion import pose_message
from calib.show.page import SCENE
from calib.show.puppet import puppets
from calib.show.scene import view_page
from calib.show.server import Message, PageServer
from calib.show.view import View
from calib.show.visuals import Visual, read_visuals
from calib.show.window import Command

Array = NDArray[np.float64]

#: What a user draws stands below this node of a robot's.
_OWN = "own"


class LiveWindow:
    """meshcat's window, for ``meshcat.Visualizer(window=...)``: what is drawn goes to all windows of a page.

    Everything is kept, so that a window that opens later shows the same.

    Args:
        forward: Takes each message on to the windows that are open.
    """

    def __init__(self, forward: Callable[[Message], None]) -> None:
        self._forward = forward
        self._lock = threading.Lock()
        self._tree = SceneTree()

    def send(self, command: Command) -> None:
        """Draw, move or remove.

        Raises:
            CalibError: It is no such command, or the page is closed.
        """
        message = command.lower()
        # Kept first: a window that opens meanwhile is told twice rather than never.
        with self._lock:
            self._keep(message)
        self._forward(umsgpack.packb(message))

    def messages(self) -> list[Message]:
        """What a new window must be told."""
        with self._lock:
            kept = []
            for node in walk(self._tree):
                kept += [node.object] if node.object else []
                kept += dict(node.properties).values()
                kept += [node.transform] if node.transform else []
                kept += [node.animation] if node.animation else []
        return [umsgpack.packb(message) for message in kept]

    def _keep(self, message: dict[str, Any]) -> None:
        """Put a command to where the next one of its kind replaces it."""
        kind = message["type"]
        if kind not in ("set_object", "set_transform", "set_property", "set_animation", "delete"):
            text = f"A live page takes no meshcat command '{kind}'."
            raise CalibError(text)
        path = [part for part in message["path"].split("/") if part]
        if kind == "delete":
            if path:
                find_node(self._tree, path[:-1]).pop(path[-1], None)
            else:
                self._tree = SceneTree()
            return
        node = find_node(self._tree, path)
        if kind == "set_object":
            node.object, node.properties = message, []
        elif kind == "set_transform":
            node.transform = message
        elif kind == "set_animation":
            node.animation = message
        else:
            name = message["property"]
            node.properties = [pair for pair in node.properties if pair[0] != name]
            node.properties.append((name, message))


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
        visualizer: meshcat's, to draw more: in the base frame of the calibrated robot, or of the only one [m].
        warnings: What could not be drawn as the URDF says.

    Raises:
        UrdfError: Pinocchio cannot build a model of a URDF.
        CalibError: The port is in use.
    """

    def __init__(self, view: View, *, port: int = 0) -> None:
        self._one = view.select([view.start])
        self._visuals: dict[str, Sequence[Visual]] = {
            who: read_visuals(robot.urdf)[0] for who, robot in view.robots.items()
        }
        self._pose = ""
        page = view_page(view, live=True)
        self.warnings: tuple[str, ...] = page.warnings
        # Before the server, for a window may ask for what was drawn at once.
        self._window = LiveWindow(lambda message: self._server.send(message))
        self._server = PageServer(page.html, port=port, welcome=self._welcome)
        who = tuple(view.robots)[-1]
        root = meshcat.Visualizer.view_into(self._window, meshcat.path.Path())
        self.visualizer: meshcat.Visualizer = root[SCENE][who][_OWN]

    @property
    def url(self) -> str:
        """Where the page is."""
        return self._server.url

    @property
    def port(self) -> int:
        """Where it listens on 127.0.0.1."""
        return self._server.port

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
            has = "values that are not finite"
            if values.shape != (len(self.joint_names),):
                has = f"shape {values.shape}"
            message = (
                f"q has {has}; give a finite value for each joint, [rad] or [m]: "
                f"{choices(self.joint_names)}."
            )
            raise ModelError(message)
        one = replace(self._one, q=values[None])
        self._pose = pose_message(puppets(one, self._visuals), label)
        self._server.send(self._pose)

    def open(self) -> bool:
        """Open the page in the browser; False if none was found."""
        return webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait for Ctrl-C; the viewer is closed afterwards."""
        self._server.wait()

    def close(self) -> None:
        """Free the port; the windows keep their picture. Once closed, it does nothing."""
        self._server.close()

    def __enter__(self) -> Viewer:
        """The viewer, to be closed at the end of the block."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def __repr__(self) -> str:
        """Where the page is."""
        return f"<Viewer {'closed' if self._server.closed else self.url}>"

    def _welcome(self) -> list[Message]:
        """What a new window must be told: what was drawn, and the pose if the robots were moved."""
        return [*self._window.messages(), *([self._pose] if self._pose else [])]

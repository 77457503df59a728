"""Opening the picture of a calibration or of robots in the browser."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import Literal, overload

from calib.errors import ModelError
from calib.identify.result import Calibration
from calib.model.robot import Robot
from calib.show.live import Viewer
from calib.show.pictures import view_of, view_of_robots
from calib.show.robots_page import write_view
from calib.show.view import View


@overload
def show(
    shown: Calibration | Robot, other: Robot | None = None, *, live: Literal[False] = False
) -> Path: ...


@overload
def show(
    shown: Calibration | Robot, other: Robot | None = None, *, live: Literal[True]
) -> Viewer: ...


def show(
    shown: Calibration | Robot, other: Robot | None = None, *, live: bool = False
) -> Path | Viewer:
    """Open the picture of a calibration, of a robot or of two robots in the browser.

    Args:
        shown: A calibration, or a robot.
        other: A second robot with the same joints, to be shown beside the first.
        live: Whether this program serves the page, so that it can move the robots and draw more; the page is then there
            until the viewer is closed or the program ends. Otherwise it is a file, and stays.

    Returns:
        The page, in a temporary folder of its own; or the viewer.

    Raises:
        ModelError: It is no calibration and no robot, or the robots have different joints.
    """
    view = _view_of_anything(shown, other)
    if live:
        viewer = Viewer(view)
        viewer.open()
        return viewer
    page = write_view(view, Path(tempfile.mkdtemp(prefix="calib-")) / "view.html")
    webbrowser.open(page.as_uri())
    return page


def _view_of_anything(shown: Calibration | Robot, other: Robot | None) -> View:
    """The view of what a user hands over."""
    if isinstance(shown, Calibration) and other is None:
        return view_of(shown)
    if isinstance(shown, Robot) and (other is None or isinstance(other, Robot)):
        second = shown if other is None else other
        names = (("First", shown.urdf.source), ("Second", second.urdf.source))
        return view_of_robots(shown, other, names=names)
    given = " and ".join(repr(one) for one in (shown, other)[: 1 + (other is not None)])
    raise ModelError(
        f"show takes a Calibration, a Robot or two Robots; {given} was given. Make them with calib.calibrate(...) or "
        "calib.Robot.load(...)."
    )

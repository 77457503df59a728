"""Whether another set-up explains the measurements far better: the usual mistakes, looked for instead of guessed at."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from calib.identify.fitting import Rows, predict
from calib.identify.registration import register
from calib.measure.cell import Cell
from calib.model.robot import Robot

#: Nominal errors below this need no other explanation than an uncalibrated arm [m].
_PLAUSIBLE = 0.02

#: Another set-up must lower the nominal robot's error to this share to be named.
_FAR_BETTER = 0.2


def better_setup(robot: Robot, cell: Cell, rows: Rows) -> str:
    """A sentence that names the set-up which explains the rows far better than the one given, or nothing.

    The nominal robot is registered to the rows with every link that stands still as base, and with a measurement
    frame that is estimated.

    Args:
        robot: The nominal robot.
        cell: The set-up as given.
        rows: The estimation rows.
    """
    if cell.estimate_frame or cell.T_frame_base is not None:
        return ""
    asked = replace(cell, estimate_target=True)
    given = _rms(robot, asked, rows)
    if given < _PLAUSIBLE:
        return ""
    # Score, error, words. A frame of its own always fits a little better: it must do more than that.
    candidates = []
    for link in _standing_links(robot):
        error = _rms(Robot.from_urdf(robot.urdf, link, robot.tip), asked, rows)
        candidates.append((error, error, f"--base {link}"))
    if len(rows) >= 4:
        error = _rms(robot, replace(asked, estimate_frame=True), rows)
        candidates.append((2.0 * error, error, "--frame estimate"))
    score, error, option = min(candidates, default=(np.inf, np.inf, ""))
    if score > _FAR_BETTER * given:
        return ""
    return (
        f"The points do not seem to be in the frame of '{robot.base}': the nominal robot is {1e3 * given:.0f} mm rms "
        f"off there, and {1e3 * error:.1f} mm with {option}. Try that."
    )


def _standing_links(robot: Robot) -> list[str]:
    """The links that no joint moves against the base, but for the base itself."""
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    return [
        link
        for link in robot.urdf.links
        if link != robot.base
        and moving.isdisjoint(itertools.chain(*robot.urdf.chain(robot.base, link)))
    ]


def _rms(robot: Robot, cell: Cell, rows: Rows) -> float:
    """Error of the nominal robot where target (and frame, if asked) are registered, rms [m]."""
    registered = register(robot, cell, rows.joints, rows.points)
    residual = rows.points - predict(robot, registered, rows.joints)
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))

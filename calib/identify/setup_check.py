"""Whether another set-up explains the measurements far better: the usual mistakes, looked for instead of guessed at.

A nominal arm is wrong by millimetres. Where it is off by centimetres the cause is another: a wrong base link, points in
another frame, a joint with the sign or the zero of another convention, two columns swapped. Each of these is tried on
the nominal robot, with the target registered anew, and the best is named.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.registration import register
from calib.identify.rows import Rows
from calib.identify.setup import Setup
from calib.identify.verdict import Reason, Why
from calib.measure.cell import Cell
from calib.model.error_model import DIRECTIONS
from calib.model.robot import Robot

#: Nominal errors below this need no other explanation than an uncalibrated arm [m].
PLAUSIBLE = 0.02

#: Another set-up must lower the nominal robot's error to this share to be named.
_FAR_BETTER = 0.2

#: A nominal robot that is still further off is not explained [m].
_EXPLAINED = 0.05

#: Joints up to which every combination of turned signs is tried.
_MOST_SIGNS = 7

#: Rows that are looked at; more would not tell more.
_ROWS = 60

#: A step that lowers the sum of squares by less than this share is the last one: errors to five digits are enough to
#: compare, and a set-up that does not fit takes many steps for more.
_TOLERANCE = 1e-6

#: Factors between units that are taken for each other.
_LENGTHS = {
    "inches under [mm]": 25.4,
    "mm under [in]": 1.0 / 25.4,
    "metres under [mm]": 1e3,
    "mm under [m]": 1e-3,
}
_ANGLES = {"radians under [deg]": np.degrees(1.0), "degrees under [rad]": np.radians(1.0)}

#: The zeros that conventions differ by [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)


#: A set-up that is tried: what its error counts times, robot, set-up, rows, and what it would mean.
Trial = tuple[float, Robot, Setup, Rows, Why, dict[str, Any]]


def better_setup(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> Reason | None:
    """The set-up which explains the rows far better than the one given, if there is one.

    Only tables of points of one target in one frame are looked at; rows are the estimation rows.
    """
    if (
        any(kind.name != "point" for kind in rows.present)
        or len(setup.targets) > 1
        or len(setup.groups) > 1
    ):
        return None
    chosen = np.zeros(len(rows), dtype=bool)
    chosen[np.linspace(0, len(rows) - 1, min(len(rows), _ROWS)).astype(int)] = True
    rows = rows.select(chosen)
    given = _rms(robot, setup, rows)
    if given < PLAUSIBLE:
        return None
    best, found = np.inf, None
    for factor, other, asked, changed, why, values in _trials(robot, cell, setup, rows):
        error = _rms(other, asked, changed)
        if factor * error < best:
            best, found = factor * error, Reason.of(why, given_m=given, error_m=error, **values)
    if found is None or best > _FAR_BETTER * given or found.values["error_m"] > _EXPLAINED:
        return None
    return found


def _trials(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> Iterator[Trial]:
    """The usual mistakes, undone."""
    asked = replace(setup, target_unknown=np.array([True]))
    if not setup.estimate_target:
        yield 1.0, robot, asked, rows, Why.TARGET_ELSEWHERE, {}
    if not cell.estimate_frame and cell.T_frame_base is None:
        for link in _standing_links(robot):
            yield 1.0, robot.rebuilt(base=link), asked, rows, Why.OTHER_BASE, {"link": link}
        if len(rows) >= 4:
            # A frame of its own always fits a little better: it must do more than that.
            own = replace(asked, unknown=(DIRECTIONS,))
            yield 2.0, robot, own, rows, Why.OWN_FRAME, {}
    for factor, joints, why, values in _joint_trials(robot, asked, rows.joints):
        turned = replace(rows, samples=replace(rows.samples, q=joints))
        yield factor, robot, asked, turned, why, values
    for i, j in itertools.combinations(range(3), 2):
        points = rows.measured.copy()
        points[:, [i, j]] = points[:, [j, i]]
        names = f"{'xyz'[i]} and {'xyz'[j]}"
        swapped = replace(rows, measured=points)
        yield 1.2, robot, asked, swapped, Why.COLUMNS_SWAPPED, {"columns": names}
    for unit, size in _LENGTHS.items():
        scaled = replace(rows, measured=size * rows.measured)
        yield 1.2, robot, asked, scaled, Why.WRONG_UNIT, {"what": "points", "unit": unit}


def _joint_trials(
    robot: Robot, setup: Setup, q: NDArray[np.float64]
) -> Iterator[tuple[float, NDArray[np.float64], Why, dict[str, Any]]]:
    """Joints of another convention, in other units, and in each other's columns; q has shape (N, n)."""
    names, n = robot.joint_names, len(robot.inputs)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    # A frame that is estimated too makes a trial a hundred times dearer: then one joint at a time.
    most = n if n <= _MOST_SIGNS and not any(setup.unknown) else 1
    for count in range(1, most + 1):
        for some in itertools.combinations(range(n), count):
            joints = q.copy()
            joints[:, some] *= -1.0
            listed = " and ".join(f"'{names[i]}'" for i in some)
            yield 1.0 + 0.2 * count, joints, Why.JOINTS_TURNED, {"joints": listed}
    for i, degrees in itertools.product(np.flatnonzero(turns).tolist(), _TURNS_DEG):
        joints = q.copy()
        joints[:, i] += np.radians(degrees)
        yield (
            1.2,
            joints,
            Why.JOINT_ZERO,
            {"add_rad": float(np.radians(degrees)), "joint": names[i]},
        )
    for i, j in itertools.combinations(range(n), 2):
        joints = q.copy()
        joints[:, [i, j]] = joints[:, [j, i]]
        yield 1.2, joints, Why.COLUMNS_SWAPPED, {"columns": f"'{names[i]}' and '{names[j]}'"}
    for unit, size in _ANGLES.items():
        values = {"what": "joint values", "unit": unit}
        yield 1.2, np.where(turns, size, 1.0) * q, Why.WRONG_UNIT, values


def _standing_links(robot: Robot) -> list[str]:
    """The links that no joint moves against the base, but for the base itself."""
    moving = {joint.name for joint in robot.urdf.joints if joint.type != "fixed"}
    return [
        link
        for link in robot.urdf.links
        if link != robot.base
        and moving.isdisjoint(itertools.chain(*robot.urdf.chain(robot.base, link)))
    ]


def _rms(robot: Robot, setup: Setup, rows: Rows) -> float:
    """Error of the nominal robot where target (and frame, if asked) are registered, rms [m]."""
    placed = register(robot, setup, rows, tolerance=_TOLERANCE)
    residual = rows.residual(placed.seen(robot.poses(rows.joints), rows.samples))
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))

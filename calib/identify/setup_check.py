"""Whether another set-up explains the measurements far better: the usual mistakes, looked for instead of guessed at.

A nominal arm is wrong by millimetres. Where it is off by centimetres the cause is another: a wrong base link, points in
another frame, a joint with the sign or the zero of another convention, two columns swapped. Each of these is tried on
the nominal robot, with the target registered anew, and the best is named.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.nominal import residual_of
from calib.identify.registration import register
from calib.identify.rows import Rows
from calib.identify.setup import Setup
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

#: Factors between units of length that are taken for each other.
_LENGTHS = (
    (25.4, "inches under [mm]"),
    (1.0 / 25.4, "mm under [in]"),
    (1e3, "metres under [mm]"),
    (1e-3, "mm under [m]"),
)

#: The zeros that conventions differ by [deg].
_TURNS_DEG = (90.0, -90.0, 180.0)


def better_setup(robot: Robot, cell: Cell, setup: Setup, rows: Rows) -> str:
    """A sentence that names the set-up which explains the rows far better than the one given, or nothing.

    Only tables of points of one target are looked at.

    Args:
        robot: The nominal robot.
        cell: The set-up as given.
        setup: Its frames and targets.
        rows: The estimation rows.
    """
    if (
        any(kind.name != "point" for kind in rows.present)
        or len(setup.targets) > 1
        or len(setup.groups) > 1
    ):
        return ""
    chosen = np.zeros(len(rows), dtype=bool)
    chosen[np.linspace(0, len(rows) - 1, min(len(rows), _ROWS)).astype(int)] = True
    rows = rows.select(chosen)
    asked = replace(setup, target_unknown=np.array([True]))
    given = _rms(robot, setup, rows)
    if given < PLAUSIBLE:
        return ""
    tried = [
        *_other_target(robot, setup, rows),
        *_other_frames(robot, cell, asked, rows),
        *_other_columns(robot, asked, rows),
        *_other_units(robot, asked, rows),
    ]
    score, error, words = min(tried, default=(np.inf, np.inf, ""))
    if score > _FAR_BETTER * given or error > _EXPLAINED:
        return ""
    return (
        f"The nominal robot is {1e3 * given:.0f} mm rms off, which no uncalibrated arm is, and only "
        f"{1e3 * error:.1f} mm {words}."
    )


def _turned(rows: Rows, joints: NDArray[np.float64]) -> Rows:
    """The rows with other joint values."""
    return replace(rows, samples=replace(rows.samples, q=joints))


def _other_target(robot: Robot, setup: Setup, rows: Rows) -> Iterator[tuple[float, float, str]]:
    """Score, error and words for a target that is not where it is said to be."""
    if not setup.estimate_target:
        error = _rms(robot, replace(setup, target_unknown=np.array([True])), rows)
        yield error, error, "if the target is found from the data: leave out --fix-target"


def _other_units(robot: Robot, setup: Setup, rows: Rows) -> Iterator[tuple[float, float, str]]:
    """Score, error and words for numbers that stand under another unit than their own."""
    for factor, words in _LENGTHS:
        error = _rms(robot, setup, replace(rows, measured=factor * rows.measured))
        yield 1.2 * error, error, f"if the points are {words}: check the unit in the header"
    turning = np.array([joint.type != "prismatic" for joint in robot.inputs])
    for factor, words in (
        (np.degrees(1.0), "radians under [deg]"),
        (np.radians(1.0), "degrees under [rad]"),
    ):
        error = _rms(robot, setup, _turned(rows, np.where(turning, factor, 1.0) * rows.joints))
        yield 1.2 * error, error, f"if the joint values are {words}: check the unit in the header"


def _other_frames(
    robot: Robot, cell: Cell, setup: Setup, rows: Rows
) -> Iterator[tuple[float, float, str]]:
    """Score, error and words for the points in another frame."""
    if cell.estimate_frame or cell.T_frame_base is not None:
        return
    for link in _standing_links(robot):
        error = _rms(robot.rebuilt(base=link), setup, rows)
        yield error, error, f"if the points are in the frame of '{link}': try --base {link}"
    if len(rows) >= 4:
        error = _rms(robot, replace(setup, unknown=(DIRECTIONS,)), rows)
        # A frame of its own always fits a little better: it must do more than that.
        yield 2.0 * error, error, "if the points are in a frame of their own: try --frame estimate"


def _other_columns(robot: Robot, setup: Setup, rows: Rows) -> Iterator[tuple[float, float, str]]:
    """Score, error and words for joints of another convention, and for swapped columns."""
    names, n = robot.joint_names, len(robot.inputs)
    # A frame that is estimated too makes a trial a hundred times dearer: then one joint at a time.
    most = n if n <= _MOST_SIGNS and not any(setup.unknown) else 1
    for count in range(1, most + 1):
        for turned in itertools.combinations(range(n), count):
            joints = rows.joints.copy()
            joints[:, turned] *= -1.0
            error = _rms(robot, setup, _turned(rows, joints))
            listed = " and ".join(f"'{names[i]}'" for i in turned)
            words = f"if {listed} turn{'s' if count == 1 else ''} the other way: check the signs"
            yield (1.0 + 0.2 * count) * error, error, words
    for i, degrees in itertools.product(range(n), _TURNS_DEG):
        if robot.inputs[i].type != "prismatic":
            joints = rows.joints.copy()
            joints[:, i] += np.radians(degrees)
            error = _rms(robot, setup, _turned(rows, joints))
            yield (
                1.2 * error,
                error,
                f"if {degrees:g} deg are added to '{names[i]}': check its zero",
            )
    for i, j in itertools.combinations(range(n), 2):
        joints = rows.joints.copy()
        joints[:, [i, j]] = joints[:, [j, i]]
        error = _rms(robot, setup, _turned(rows, joints))
        yield 1.2 * error, error, f"if the columns '{names[i]}' and '{names[j]}' are swapped"
    for i, j in itertools.combinations(range(3), 2):
        points = rows.measured.copy()
        points[:, [i, j]] = points[:, [j, i]]
        error = _rms(robot, setup, replace(rows, measured=points))
        yield 1.2 * error, error, f"if the columns {'xyz'[i]} and {'xyz'[j]} are swapped"


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
    residual = residual_of(robot, register(robot, setup, rows, tolerance=_TOLERANCE), rows)
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))

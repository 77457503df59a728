"""Whether axes can be those of the joints that they are said to be, and sentences on how joints turned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.measure.axis_geometry import Nominal
from calib.measure.base_frame import Line
from calib.measure.geometric_fits import Circle, Plane
from calib.measure.sweeps import Sweep, Sweeps
from calib.measure.turning import Turning
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: Points that stay within this do not move, rms about their mean [m].
STILL_M = 1e-3

#: No robot is built, and mounted, with axes that stand this much otherwise to each other than in its URDF.
ANGLE_RAD, DISTANCE_M = float(np.radians(5.0)), 20e-3

#: Times the standard deviation of a circle's centre, beside `DISTANCE_M`.
_SIGMAS = 6.0


_ORDER = (
    "Without joint values the rows of a sweep stand in the order of increasing joint angle: turn the order of one of "
    "them round, or give the joints' values in columns."
)
_SIGN = "The sign of one joint's values is not the URDF's: turn it round, there and in all other tables."


def check_moves(sweep: Sweep) -> None:
    """Refuse a sweep whose points stay where they are.

    Raises:
        MeasurementError: They do.
    """
    spread = float(
        np.sqrt(np.mean(np.sum((sweep.points - sweep.points.mean(axis=0)) ** 2, axis=1)))
    )
    if spread < STILL_M:
        message = (
            f"{sweep.where}: the points stay within {1e3 * spread:.2g} mm of their mean: the joint did not turn, or "
            "the target sits on its axis. Turn the joint as far as it goes, with the target well off the axis."
        )
        raise MeasurementError(message)


def check_side(sweeps: Sweeps, plane: Plane, first: Circle, robot: Robot | None) -> tuple[str, ...]:
    """Whether axis 1 points away from the plane, towards the circle, as the URDF's does; else a sentence, or a refusal.

    Raises:
        MeasurementError: With a robot and without joint values: then the order of the rows is the wrong way round.
    """
    slope = float(first.normal @ plane.normal)
    height = float((first.center - plane.point) @ plane.normal) * np.sign(slope)
    up = 1.0
    if robot is not None:
        up = float(np.sign(_nominal_slope(robot)))
    if height * up > 0.0:
        return ()
    sweep = sweeps.find(0)
    assert sweep is not None
    if robot is not None and sweep.joints is None:
        message = (
            f"{sweep.where}: seen from the plane the joint turns the other way than in the URDF. Without joint values "
            "the rows stand in the order of increasing joint angle: turn their order round, or give the joints' values "
            "in columns."
        )
        raise MeasurementError(message)
    if robot is not None:
        return (
            f"{sweep.where}: the circle lies below the plane z = 0 of the base. If the robot stands on that plane, the "
            "joint's sign differs from the URDF's.",
        )
    return (
        f"{sweep.where}: z points from the circle towards the plane. If the robot stands on it and joint 1 turns "
        "anticlockwise seen from above, the rows are in the order of decreasing joint angle.",
    )


def _nominal_slope(robot: Robot) -> float:
    """Component of axis 1 along z of the base."""
    from_root = np.linalg.inv(robot.T_root_base) @ robot.placements[0]
    return float((from_root[:3, :3] @ np.asarray(robot.joints[0].axis))[2])


def check_pairs(
    sweeps: Sweeps,
    robot: Robot,
    nominal: Nominal,
    lines: Sequence[Line],
    circles: Sequence[Circle],
) -> None:
    """Refuse axes that stand to each other as no two of this robot do.

    Args:
        sweeps: For messages.
        robot: Likewise.
        nominal: The URDF's axes.
        lines: The first axes at zero, in any frame.
        circles: Of the same, for the uncertainty.

    Raises:
        MeasurementError: The angle or the distance between two neighbours is far from the URDF's.
    """
    for k in range(len(lines) - 1):
        angle, distance = between(lines[k], lines[k + 1])
        wanted_angle, wanted_distance = between(nominal.lines[k], nominal.lines[k + 1])
        vague = sum(float(np.trace(c.covariance[:3, :3])) for c in circles[k : k + 2])
        far = abs(distance - wanted_distance) > DISTANCE_M + _SIGMAS * np.sqrt(vague)
        turned = abs(angle - wanted_angle) > ANGLE_RAD
        if not (far or turned):
            continue
        names = f"'{sweeps.label(k)}' and '{sweeps.label(k + 1)}'"
        if not far and abs(np.pi - angle - wanted_angle) < ANGLE_RAD:
            message = (
                f"{sweeps.source}: the joints {names} turn the other way round to each other than in the URDF of "
                f"'{robot.name}'. {_ORDER if sweeps.sweeps[-1].joints is None else _SIGN}"
            )
        else:
            message = (
                f"{sweeps.source}: the axes of {names} are {np.degrees(angle):.1f} deg and {1e3 * distance:.1f} mm "
                f"apart; in the URDF of '{robot.name}' from '{robot.base}' to '{robot.tip}' they are "
                f"{np.degrees(wanted_angle):.1f} deg and {1e3 * wanted_distance:.1f} mm. One of the two sweeps is of "
                "another joint, or the robot or its chain is another one: check what was turned, and --robot, --base."
            )
        raise MeasurementError(message)


def between(first: Line, second: Line) -> tuple[float, float]:
    """The angle between two axes, in [0, pi], and their shortest distance [rad, m]."""
    cross = np.cross(first.direction, second.direction)
    sine = float(np.linalg.norm(cross))
    angle = float(np.arctan2(sine, first.direction @ second.direction))
    apart = second.point - first.point
    if sine < np.sin(ANGLE_RAD):  # the common normal of nearly parallel axes may lie anywhere
        return angle, float(np.linalg.norm(np.cross(apart, first.direction)))
    return angle, float(abs(apart @ cross) / sine)


def turning_findings(name: str, turned: Turning | None) -> tuple[str, ...]:
    """Sentences on a joint whose angle is not what it says."""
    if turned is None:
        return ()
    found = []
    if turned.gain_found:
        found.append(
            f"'{name}' turns {1e3 * abs(turned.gain):.3f} mrad per rad {'further' if turned.gain > 0 else 'less'} than "
            f"its values say (standard deviation {1e3 * turned.gain_std:.3f} mrad): a gear gain (--model dh+gain)."
        )
    if turned.eccentricity_found:
        found.append(
            f"'{name}' is off by {1e3 * turned.eccentricity:.3f} mrad once per turn (standard deviation "
            f"{1e3 * turned.eccentricity_std:.3f} mrad): an eccentric encoder (--model dh+eccentricity), or a target "
            "that moved on its link in the middle of the sweep."
        )
    return tuple(found)

"""Whether sweeps can be those of the joints that they are said to be, and sentences on what their residuals show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtr

from calib.base_frame.axes import Line, Nominal, between
from calib.base_frame.fits import Circle, Plane, fit_circle, fit_plane
from calib.base_frame.scatter import LEVEL
from calib.base_frame.sweeps import Sweep, Sweeps
from calib.base_frame.turning import Turning
from calib.errors import MeasurementError, choices
from calib.model.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

#: Points that stay within this do not move, rms about their mean [m].
STILL_M = 1e-3

#: Beside the joint that turns, no other may by more than the first [rad]; it turns by more than the second.
STILL_RAD, TURNED_RAD = float(np.radians(0.1)), float(np.radians(1.0))

#: No robot is built, and mounted, with axes that stand this much otherwise to each other than in its URDF.
ANGLE_RAD, DISTANCE_M = float(np.radians(5.0)), 20e-3

#: Times the standard deviation of a circle's centre, beside `DISTANCE_M`.
_SIGMAS = 6.0

_ORDER = (
    "Without joint values the rows of a sweep stand in the order of increasing joint angle: turn the order of one of "
    "them round, or give the joints' values in columns."
)
_SIGN = "The sign of one joint's values is not the URDF's: turn it round, there and in all other tables."


# Refusals


def check_moves(sweep: Sweep) -> None:
    """Refuse a sweep whose points stay where they are.

    Raises:
        MeasurementError: They do.
    """
    off = sweep.points - sweep.points.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    if spread < STILL_M:
        raise MeasurementError(
            f"{sweep.where}: the points stay within {1e3 * spread:.2g} mm of their mean: the joint did not turn, or "
            "the target sits on its axis. Turn the joint as far as it goes, with the target well off the axis."
        )


def check_joint(sweep: Sweep, joint_names: tuple[str, ...]) -> None:
    """Refuse a sweep in which the joint columns show another joint turning.

    Raises:
        MeasurementError: The joint does not turn, or another one does.
    """
    if sweep.joints is None or sweep.joint is None:
        return
    if sweep.joint >= sweep.joints.shape[1]:
        raise MeasurementError(
            f"{sweep.where}: the table has columns for {sweep.joints.shape[1]} joints only, {choices(joint_names)}. "
            "Give a column for each joint of the chain, in their order, or none."
        )
    ranges = np.ptp(sweep.joints, axis=0)
    name, own = joint_names[sweep.joint], float(ranges[sweep.joint])
    ranges[sweep.joint] = 0.0
    other, most = joint_names[int(np.argmax(ranges))], float(ranges.max())
    if own < TURNED_RAD:
        message = f"{sweep.where}: by its column the joint '{name}' turns by {np.degrees(own):.3g} deg only"
        if most > max(own, STILL_RAD):
            message += f", and '{other}' by {np.degrees(most):.4g} deg. Name the joint that turns as its sweep."
        else:
            message += ". A sweep turns one joint, as far as it can."
        raise MeasurementError(message)
    if most > STILL_RAD:
        raise MeasurementError(
            f"{sweep.where}: beside '{name}' the joint '{other}' moves by {np.degrees(most):.3g} deg. In a "
            "sweep one joint turns and all others stand still; name the joint that turns, or measure it again."
        )


def check_side(sweep: Sweep, plane: Plane, first: Circle, robot: Robot | None) -> tuple[str, ...]:
    """Whether axis 1 points away from the plane, towards the circle, as the URDF's does; else a sentence, or a refusal.

    Args:
        sweep: Of joint 1.
        plane: The mounting plane.
        first: The circle of joint 1.
        robot: If there is one.

    Raises:
        MeasurementError: With a robot and without joint values: then the order of the rows is the wrong way round.
    """
    slope = np.sign(first.normal @ plane.normal)
    height = float((first.center - plane.point) @ plane.normal) * slope
    if robot is not None:
        T = rigid_inverse(robot.T_root_base) @ robot.placements[0]
        height *= float(np.sign((T[:3, :3] @ np.asarray(robot.joints[0].axis))[2]))
    if height > 0.0:
        return ()
    if robot is not None and sweep.joints is None:
        raise MeasurementError(
            f"{sweep.where}: seen from the plane the joint turns the other way than in the URDF. Without joint values "
            "the rows stand in the order of increasing joint angle: turn their order round, or give the joints' values "
            "in columns."
        )
    if robot is not None:
        return (
            f"{sweep.where}: the circle lies below the plane z = 0 of the base. If the robot stands on that plane, the "
            "joint's sign differs from the URDF's.",
        )
    return (
        f"{sweep.where}: z points from the circle towards the plane. If the robot stands on it and joint 1 turns "
        "anticlockwise seen from above, the rows are in the order of decreasing joint angle.",
    )


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
        if not far and abs(angle - wanted_angle) <= ANGLE_RAD:
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


# Findings


def circle_findings(sweep: Sweep, circle: Circle, label: str) -> tuple[str, ...]:
    """Sentences on a joint's sweep: gross rows, neighbours that err alike, noise that is larger than stated."""
    used = circle.used
    gross = ~(used if not used.all() else fit_circle(sweep.points, sweep.sigma).used)
    found = [*_gross(sweep, np.linalg.norm(circle.residuals, axis=1), gross, used)]
    for which, name in enumerate(("radially", "axially")):
        e = circle.residuals[used, which]
        correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
        if len(e) >= 10 and ndtr(-correlation * np.sqrt(len(e))) < 0.5 * LEVEL:
            found.append(
                f"{sweep.where}: neighbouring points of '{label}' err alike {name} (correlation {correlation:.2f}): "
                "that is no noise, so the stated uncertainty is too small. Look for a worn bearing, play, bending, "
                "drift, or a target or tracker that moved."
            )
    return (*found, *_too_large(sweep, circle))


def plane_findings(sweep: Sweep, plane: Plane) -> tuple[str, ...]:
    """Sentences on the plane: gross rows, a surface that is no plane, noise that is larger than stated."""
    used = plane.used
    gross = ~(used if not used.all() else fit_plane(sweep.points, sweep.sigma).used)
    found = [*_gross(sweep, np.abs(plane.residuals[:, 0]), gross, used)]
    bent, tail = _bent(sweep, plane)
    if tail < LEVEL:
        found.append(
            f"{sweep.where}: the surface is not flat but bent, by {1e3 * bent:.2g} mm over its points. "
            "Touch it where the robot stands on it."
        )
    return (*found, *_too_large(sweep, plane))


def turning_findings(name: str, turned: Turning | None) -> tuple[str, ...]:
    """Sentences on a joint whose angle is not what it says."""
    found = []
    if turned is not None and turned.gain_found:
        found.append(
            f"'{name}' turns {1e3 * abs(turned.gain):.3f} mrad per rad {'further' if turned.gain > 0 else 'less'} than "
            f"its values say (standard deviation {1e3 * turned.gain_std:.3f} mrad): a gear gain (--model dh+gain)."
        )
    if turned is not None and turned.eccentricity_found:
        found.append(
            f"'{name}' is off by {1e3 * turned.eccentricity:.3f} mrad once per turn (standard deviation "
            f"{1e3 * turned.eccentricity_std:.3f} mrad): an eccentric encoder (--model dh+eccentricity), or a target "
            "that moved on its link in the middle of the sweep."
        )
    return tuple(found)


def _gross(
    sweep: Sweep, off: Array, gross: NDArray[np.bool_], used: NDArray[np.bool_]
) -> Iterator[str]:
    """The gross rows, and whether they were left out."""
    for i in np.flatnonzero(gross):
        yield (
            f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}') is {1e3 * off[i]:.3g} mm off and "
            f"{'counts all the same' if used[i] else 'left out'}: measure it again."
        )


def _bent(sweep: Sweep, plane: Plane) -> tuple[float, float]:
    """By how much a quadratic surface through the points bends [m], and the tail of its F test."""
    used = plane.used
    local = (sweep.points[used] - plane.point) @ plane.basis
    x, y = local[:, 0], local[:, 1]
    root = np.ones(len(x)) if sweep.sigma is None else 1.0 / sweep.sigma[used]
    Q = np.linalg.qr(root[:, None] * np.column_stack([np.ones_like(x), x, y]))[0]
    square = np.column_stack([x * x, x * y, y * y])
    left, bowl = (a - Q @ (Q.T @ a) for a in (root * local[:, 2], root[:, None] * square))
    b, _, rank, _ = np.linalg.lstsq(bowl, left, rcond=1e-8)
    drop, freedom = float(left @ (bowl @ b)), len(x) - 6
    if freedom < 3 or rank == 0 or drop <= 0.0:
        return 0.0, 1.0
    rest = max(float(left @ left) - drop, np.finfo(np.float64).eps * float(left @ left))
    return float(np.ptp(square @ b)), float(fdtrc(rank, freedom, drop / rank / (rest / freedom)))


def _too_large(sweep: Sweep, figure: Circle | Plane) -> Iterator[str]:
    """Whether the residuals contradict the noise that was given."""
    scatter = figure.scatter
    if scatter.contradicted and scatter.given is not None:
        yield (
            f"{sweep.where}: the points scatter by {1e3 * scatter.estimate:.3g} mm, sigma says "
            f"{1e3 * scatter.given:.3g} mm. The uncertainty is that of the scatter."
        )

"""Whether sweeps can be those of the joints that they are said to be, how well joints turned, and what residuals show.

With the joint's values q the angle of a point about the axis is

    phi = phi_0 + (1 + gain) q + sin sin(q) + cos cos(q) + noise / radius

where gain and the once-per-turn terms are what `families` calls a joint's gain and eccentricity. A circle whose
centre is not known exactly turns once per turn too: the centre's covariance is part of theirs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtr, stdtrit

from calib.circle_points.fits import LEVEL, Circle, Plane
from calib.circle_points.frame import Line, Nominal, between
from calib.circle_points.sweeps import Sweep, Sweeps
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot, rigid_inverse

Array = NDArray[np.float64]

#: Beside the joint that turns, no other may by more than the first [rad]; it turns by more than the second.
STILL_RAD, TURNED_RAD = float(np.radians(0.1)), float(np.radians(1.0))

#: No robot is built, and mounted, with axes that stand this much otherwise to each other than in its URDF.
ANGLE_RAD, DISTANCE_M = float(np.radians(5.0)), 20e-3

#: Times the standard deviation of a circle's centre, beside `DISTANCE_M`.
_SIGMAS = 6.0

#: Joint values and points may disagree by this much, rms, before they are of different sweeps [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: Of all turning, how much goes one way in a sweep.
_ONE_WAY = 0.8

#: A once-per-turn term is told from a gain on longer arcs than this [rad].
_LONG_RAD = float(np.radians(150.0))

_ORDER = (
    "Without joint values the rows of a sweep stand in the order of increasing joint angle: turn their order round, or "
    "give the joints' values in columns."
)


# The sense of turning, and how well a joint turned


@dataclass(frozen=True, slots=True)
class Turning:
    """How a joint turned against its own values: relative error of the gear, and amplitude once per turn [rad].

    With standard deviations, whether they are no chance, and the rms of what they leave [rad]. The gain is positive
    where it turns further than it says; the eccentricity is NaN on an arc too short to tell.
    """

    rms: float
    gain: float
    gain_std: float
    eccentricity: float
    eccentricity_std: float
    gain_found: bool
    eccentricity_found: bool


def positive(sweep: Sweep, circle: Circle) -> Circle:
    """The circle with its normal so that the joint's positive sense turns about it."""
    angles = circle.angles[circle.used]
    if sweep.joints is not None and sweep.joint is not None:
        values = sweep.joints[circle.used, sweep.joint]
        rest = [float(_about_mean(angles - sign * values).std()) for sign in (1.0, -1.0)]
        if min(rest) > _DISAGREE_RAD:
            raise MeasurementError(
                f"{sweep.where}: the points turn otherwise than the joint's column says, by {np.degrees(min(rest)):.3g}"
                " deg rms. Check that joint values and points are of the same rows, and the column's unit."
            )
        return circle if rest[0] <= rest[1] else circle.turned()
    steps = np.angle(np.exp(1j * np.diff(angles)))
    turned = float(steps.sum())
    if abs(turned) < _ONE_WAY * float(np.abs(steps).sum()):
        raise MeasurementError(
            f"{sweep.where}: the points go round both ways, and their order must tell the sense of turning. {_ORDER}"
        )
    return circle if turned > 0.0 else circle.turned()


def turning(sweep: Sweep, circle: Circle) -> Turning | None:
    """How well the joint turned about its circle; None without joint values or with too few points."""
    if sweep.joints is None or sweep.joint is None:
        return None
    q, angles = sweep.joints[circle.used, sweep.joint], circle.angles[circle.used]
    columns = [np.ones_like(q), q - q.mean()]
    if np.ptp(q) > _LONG_RAD:
        columns += [np.sin(q), np.cos(q)]
    X = np.column_stack(columns)
    freedom = len(q) - X.shape[1]
    if freedom < 1:
        return None
    y = _about_mean(angles - q)
    inverse = np.linalg.inv(X.T @ X)
    x = inverse @ (X.T @ y)
    left = y - X @ x
    # The centre's displacement moves each angle by its part along the tangent.
    moved = np.column_stack([np.sin(angles), -np.cos(angles)]) / circle.radius
    P = inverse @ X.T @ moved
    covariance = inverse * float(left @ left) / freedom + P @ circle.covariance[:2, :2] @ P.T
    gain, gain_std = float(x[1]), float(np.sqrt(covariance[1, 1]))
    amplitude, amplitude_std, found = np.nan, np.nan, False
    if len(x) == 4:
        amplitude = float(np.hypot(x[2], x[3]))
        amplitude_std = float(np.sqrt(0.5 * np.trace(covariance[2:, 2:])))
        size = x[2:] @ np.linalg.solve(covariance[2:, 2:], x[2:])
        # Two numbers at once: an F of 2, whose tail is that of the gain's t.
        found = bool(fdtrc(2, freedom, 0.5 * size) < LEVEL / 2.0)
    limit = -float(stdtrit(freedom, LEVEL / 4.0))
    rms = float(np.sqrt(np.mean(left**2)))
    return Turning(
        rms, gain, gain_std, amplitude, amplitude_std, abs(gain) > limit * gain_std, found
    )


def _about_mean(angles: Array) -> Array:
    """Angles about their mean direction, in [-pi, pi)."""
    mean = np.angle(np.exp(1j * angles).mean())
    return np.asarray((angles - mean + np.pi) % (2.0 * np.pi) - np.pi)


# Refusals


def check_joint(sweep: Sweep, joint_names: tuple[str, ...]) -> None:
    """Refuse a sweep in which the joint columns show another joint turning."""
    if sweep.joints is None or sweep.joint is None:
        return
    if sweep.joint >= sweep.joints.shape[1]:
        raise MeasurementError(
            f"{sweep.where}: the table has columns for {sweep.joints.shape[1]} joints only, {choices(joint_names)}. "
            "Give a column for each joint of the chain, in their order, or none."
        )
    ranges = np.ptp(sweep.joints, axis=0)
    own, ranges[sweep.joint] = float(ranges[sweep.joint]), 0.0
    other, most = joint_names[int(np.argmax(ranges))], float(ranges.max())
    if own < TURNED_RAD or most > STILL_RAD:
        raise MeasurementError(
            f"{sweep.where}: by its column the joint '{joint_names[sweep.joint]}' turns by {np.degrees(own):.3g} deg, "
            f"and '{other}' by {np.degrees(most):.3g} deg. In a sweep one joint turns, as far as it can, and all "
            "others stand still; name the joint that turns, or measure it again."
        )


def check_pairs(
    sweeps: Sweeps,
    robot: Robot,
    nominal: Nominal,
    lines: Sequence[Line],
    circles: Sequence[Circle],
) -> None:
    """Refuse axes at zero, of circles, in any frame, that stand to each other as no two of this robot do."""
    for k in range(len(lines) - 1):
        angle, distance = between(lines[k], lines[k + 1])
        wanted_angle, wanted_distance = between(nominal.lines[k], nominal.lines[k + 1])
        vague = sum(float(np.trace(c.covariance[:3, :3])) for c in circles[k : k + 2])
        far = abs(distance - wanted_distance) > DISTANCE_M + _SIGMAS * np.sqrt(vague)
        if not far and abs(angle - wanted_angle) <= ANGLE_RAD:
            continue
        names = f"'{sweeps.label(k)}' and '{sweeps.label(k + 1)}'"
        if not far and abs(np.pi - angle - wanted_angle) < ANGLE_RAD:
            sign = "The sign of one joint's values is not the URDF's: turn it round, in all tables."
            raise MeasurementError(
                f"{sweeps.source}: the joints {names} turn the other way round to each other than in the URDF of "
                f"'{robot.name}'. {_ORDER if sweeps.sweeps[-1].joints is None else sign}"
            )
        raise MeasurementError(
            f"{sweeps.source}: the axes of {names} are {np.degrees(angle):.1f} deg and {1e3 * distance:.1f} mm apart; "
            f"in the URDF of '{robot.name}' from '{robot.base}' to '{robot.tip}' they are "
            f"{np.degrees(wanted_angle):.1f} deg and {1e3 * wanted_distance:.1f} mm. One of the two sweeps is of "
            "another joint, or the robot or its chain is another one: check what was turned, and --robot, --base."
        )


# Findings

Code = Literal["gross", "correlated", "scatter", "gain", "eccentricity", "downwards", "below"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What is not as it should be of a sweep: a code, where, how, and its numbers [mm, mrad]."""

    code: Code
    where: str
    how: str = ""
    values: dict[str, float] = field(default_factory=dict)


def side_findings(
    sweep: Sweep, plane: Plane, first: Circle, robot: Robot | None
) -> Iterator[Finding]:
    """A finding, or a refusal, where axis 1 does not point from the plane towards its circle, as the URDF's does."""
    height = float((first.point - plane.point) @ plane.normal)
    height *= float(np.sign(first.normal @ plane.normal))
    if robot is not None:
        T = rigid_inverse(robot.T_root_base) @ robot.placements[0]
        height *= float(np.sign((T[:3, :3] @ np.asarray(robot.joints[0].axis))[2]))
    if height > 0.0:
        return
    if robot is not None and sweep.joints is None:
        raise MeasurementError(
            f"{sweep.where}: seen from the plane the joint turns the other way than in the URDF. {_ORDER}"
        )
    yield Finding("downwards" if robot is None else "below", sweep.where)


def findings(sweep: Sweep, figure: Plane, turned: Turning | None = None) -> Iterator[Finding]:
    """Gross rows, neighbours that err alike, noise beyond sigma, a joint's own errors."""
    used = figure.used
    off = np.linalg.norm(figure.residuals, axis=1)
    for i in np.flatnonzero(~used):
        where = f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}')"
        yield Finding("gross", where, values={"off_mm": 1e3 * float(off[i])})
    if isinstance(figure, Circle) and used.sum() >= 10:
        for e, way in zip(figure.residuals[used].T, ("radially", "axially"), strict=True):
            correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
            if ndtr(-correlation * np.sqrt(len(e))) < 0.5 * LEVEL:
                yield Finding("correlated", sweep.where, way, {"correlation": correlation})
    if figure.given is not None and np.isfinite(figure.dof):
        values = {"scatter_mm": 1e3 * figure.noise, "sigma_mm": 1e3 * figure.given}
        yield Finding("scatter", sweep.where, values=values)
    if turned is not None and turned.gain_found:
        values = {"gain": 1e3 * turned.gain, "std": 1e3 * turned.gain_std}
        yield Finding("gain", sweep.where, values=values)
    if turned is not None and turned.eccentricity_found:
        values = {"eccentricity": 1e3 * turned.eccentricity, "std": 1e3 * turned.eccentricity_std}
        yield Finding("eccentricity", sweep.where, values=values)

"""What the points of a sweep do along their circle: the sense of turning, and how well the joint turned.

With the joint's values q the angle of a point about the axis is

    phi = phi_0 + (1 + gain) q + sin sin(q) + cos cos(q) + noise / radius

where gain and the once-per-turn terms are what `calib.families` calls a joint's gain and eccentricity. A
circle whose centre is not known exactly turns once per turn too: the centre's covariance is part of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, stdtrit

from calib.base_frame.fits import Circle
from calib.base_frame.scatter import LEVEL
from calib.base_frame.sweeps import Sweep
from calib.errors import MeasurementError

Array = NDArray[np.float64]

#: Joint values and points may disagree by this much, rms, before they are of different sweeps [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: Of all turning, how much goes one way in a sweep.
_ONE_WAY = 0.8

#: A once-per-turn term is told from a gain on longer arcs than this [rad].
_LONG_RAD = float(np.radians(150.0))


@dataclass(frozen=True, slots=True)
class Turning:
    """How a joint turned against its own values.

    Attributes:
        rms: Of what the terms leave [rad].
        gain: Relative error of the gear [rad/rad]; positive: it turns further than it says.
        gain_std: Its standard deviation.
        eccentricity: Amplitude of the once-per-turn error [rad]; NaN on an arc too short to tell.
        eccentricity_std: Its standard deviation.
        gain_found: Whether the gain is no chance.
        eccentricity_found: Whether the once-per-turn error is none.
    """

    rms: float
    gain: float
    gain_std: float
    eccentricity: float
    eccentricity_std: float
    gain_found: bool
    eccentricity_found: bool


def positive(sweep: Sweep, circle: Circle) -> Circle:
    """The circle with its normal so that the joint's positive sense turns about it.

    Raises:
        MeasurementError: The points do not turn with the joint's values, or there are none and the rows go both ways.
    """
    if sweep.joints is not None and sweep.joint is not None:
        values = sweep.joints[circle.used, sweep.joint]
        rest = [_deviation(circle.angles[circle.used] - sign * values) for sign in (1.0, -1.0)]
        if min(rest) > _DISAGREE_RAD:
            raise MeasurementError(
                f"{sweep.where}: the points turn otherwise than the joint's column says, by {np.degrees(min(rest)):.3g}"
                " deg rms. Check that joint values and points are of the same rows, and the column's unit."
            )
        return circle if rest[0] <= rest[1] else circle.turned()
    steps = _wrapped(np.diff(circle.angles[circle.used]))
    way, turned = float(np.abs(steps).sum()), float(steps.sum())
    if abs(turned) < _ONE_WAY * way:
        raise MeasurementError(
            f"{sweep.where}: the points go round both ways, and without joint values their order must tell the sense "
            "of turning. Put the rows in the order of increasing joint angle, or give the joints' values in columns."
        )
    return circle if turned > 0.0 else circle.turned()


def turning(sweep: Sweep, circle: Circle) -> Turning | None:
    """How well the joint turned; None without joint values or with too few points.

    Args:
        sweep: With joint values.
        circle: Its circle, normal in the positive sense.
    """
    if sweep.joints is None or sweep.joint is None:
        return None
    q = sweep.joints[circle.used, sweep.joint]
    angles = circle.angles[circle.used]
    rest = angles - q
    middle = np.angle(np.exp(1j * rest).mean())
    columns = [np.ones_like(q), q - q.mean()]
    if np.ptp(q) > _LONG_RAD:
        columns += [np.sin(q), np.cos(q)]
    X = np.column_stack(columns)
    if len(q) <= X.shape[1]:
        return None
    y = _wrapped(rest - middle)
    inverse = np.linalg.inv(X.T @ X)
    x = inverse @ (X.T @ y)
    freedom = len(q) - X.shape[1]
    left = y - X @ x
    rms = float(np.sqrt(np.mean(left**2)))
    # The centre's displacement moves each angle by its part along the tangent.
    moved = np.column_stack([np.sin(angles), -np.cos(angles)]) / circle.radius
    P = inverse @ X.T @ moved
    covariance = inverse * float(left @ left) / freedom + P @ circle.covariance[:2, :2] @ P.T
    std = np.sqrt(np.diag(covariance))
    limit = -float(stdtrit(freedom, LEVEL / 4.0))
    gain, amplitude, amplitude_std, found = float(x[1]), np.nan, np.nan, False
    if X.shape[1] == 4:
        amplitude = float(np.hypot(x[2], x[3]))
        amplitude_std = float(np.sqrt(0.5 * np.trace(covariance[2:, 2:])))
        size = x[2:] @ np.linalg.solve(covariance[2:, 2:], x[2:])
        # Two numbers at once: an F of 2, whose tail is that of the gain's t.
        found = bool(fdtrc(2, freedom, 0.5 * size) < LEVEL / 2.0)
    return Turning(
        rms, gain, float(std[1]), amplitude, amplitude_std, abs(gain) > limit * std[1], found
    )


def _wrapped(angles: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)


def _deviation(angles: Array) -> float:
    """Root of the mean square of angles about their mean direction [rad]."""
    middle = np.angle(np.exp(1j * angles).mean())
    return float(np.sqrt(np.mean(_wrapped(angles - middle) ** 2)))

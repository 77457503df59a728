"""Findings about a sweep: outliers, neighbours that err alike, noise beyond its sigma; and its sense of turning."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calib.circle_points.fits import LEVEL, Circle, Plane
from calib.circle_points.sweeps import Sweep
from calib.errors import CalibError
from calib.units import Array

#: Beside the joint that turns, no other may turn by more than this in a sweep [rad].
STILL_RAD = float(np.radians(0.1))

#: The joint of a sweep turns by more than this [rad].
TURNED_RAD = float(np.radians(1.0))

#: Joint values and points may disagree by this much, rms, before they are of different sweeps [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: Share of all turning that goes one way in a sweep, at least.
_ONE_WAY = 0.8

#: Residuals of at least this many points are tested for correlation.
_FEWEST_TESTED = 10

#: Remedy where the order of the points must tell the sense of turning.
ORDER = (
    "Without joint values the rows of a sweep are in the order of increasing joint angle: reverse their order, or give "
    "the joints' values in columns."
)


@dataclass(frozen=True, slots=True)
class SweepFinding:
    """Something wrong with a sweep."""

    #: ``gross`` (an outlier), ``radial`` and ``axial`` (residuals of neighbours are correlated), ``scatter`` (the noise
    #: is larger than sigma).
    code: str
    #: File, and row or sweep.
    where: str
    #: Distance of the outlier [m], the correlation, or the factor.
    value: float


def with_positive_sense(
    circle: Circle, values: Array | None, joint: int, joint_names: tuple[str, ...]
) -> Circle:
    """Orient a circle so that the joint's positive sense turns about its normal.

    Args:
        circle: Through the points of a sweep.
        values: The joints' values at all points, shape (N, n) [rad], of which one only may change; None: the points are
            in the order of increasing joint angle.
        joint: The joint that turns, from 0.
        joint_names: Names of the joints, for messages.

    Returns:
        The circle, or the same with the opposite normal.

    Raises:
        CalibError: Order or values do not tell the sense, or contradict the points.
    """
    angles = circle.angles[circle.used]
    if values is None:
        steps = np.angle(np.exp(1j * np.diff(angles)))
        turn = float(steps.sum())
        if abs(turn) < _ONE_WAY * float(np.abs(steps).sum()):
            raise CalibError(
                f"the points go round both ways, and their order must tell the sense of turning. {ORDER}"
            )
        return circle if turn > 0.0 else circle.turned()
    ranges = np.ptp(values, axis=0)
    if ranges[joint] < TURNED_RAD or np.any(np.delete(ranges, joint) > STILL_RAD):
        turns = [
            f"'{name}' {angle:.3g} deg"
            for name, angle in zip(joint_names, np.degrees(ranges), strict=True)
        ]
        raise CalibError(
            f"by their columns the joints turn by {', '.join(turns)}. In a sweep one "
            "joint turns, as far as it can, and all others "
            "do not move; name the joint that turns, or measure it again"
        )
    of_joint = values[circle.used, joint]
    disagreement = []
    for sign in (1.0, -1.0):
        difference = np.exp(1j * (angles - sign * of_joint))
        disagreement.append(float(np.angle(difference / difference.mean()).std()))
    least = float(np.degrees(min(disagreement)))
    if min(disagreement) > _DISAGREE_RAD:
        raise CalibError(
            f"the points turn otherwise than the joint's column says, by {least:.3g} deg rms. Check "
            "that joint values and points are of the same rows, and the column's unit"
        )
    return circle if disagreement[0] <= disagreement[1] else circle.turned()


def findings(sweep: Sweep, figure: Plane) -> Iterator[SweepFinding]:
    """Yield outliers, correlated residuals of neighbours, and noise beyond sigma.

    Args:
        sweep: The points.
        figure: The plane or circle through them.
    """
    for i in np.flatnonzero(~figure.used):
        where = f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}')"
        yield SweepFinding("gross", where, float(np.linalg.norm(figure.residuals[i])))
    if isinstance(figure, Circle) and figure.used.sum() >= _FEWEST_TESTED:
        residuals = figure.residuals[figure.used]
        for e, code in zip(residuals.T, ("radial", "axial"), strict=True):
            correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
            p_value = ndtr(-correlation * np.sqrt(len(e)))
            if p_value < 0.5 * LEVEL:
                yield SweepFinding(code, sweep.where, correlation)
    if figure.given is not None and np.isfinite(figure.dof):
        yield SweepFinding("scatter", sweep.where, figure.noise / figure.given)

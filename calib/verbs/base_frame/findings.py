"""Findings about a sweep: outliers, neighbours that err alike, noise beyond its sigma; and its sense of turning."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calib.basics.arrays import Array
from calib.errors import CalibError
from calib.verbs.base_frame.fits import LEVEL, Circle, Plane
from calib.verbs.base_frame.sweeps import Sweep

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
    #: is larger than sigma)
    code: str
    #: File, and row or sweep
    where: str
    #: Distance of the outlier [m], the correlation, or the factor
    value: float


def with_positive_sense(
    circle: Circle,
    values: Array | None,
    joint: int,
    joint_names: tuple[str, ...],
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
        forward = _turns_forward_by_order(angles)
    else:
        _check_one_joint_turns(values, joint, joint_names)
        forward = _turns_forward_by_values(angles, values[circle.used, joint])
    return circle if forward else circle.turned()


def _turns_forward_by_order(angles: Array) -> bool:
    """Return True if points go round in the positive sense of their angles, from each to the next.

    Args:
        angles: shape (N,), of the points on the circle, in the order in which they were measured [rad].

    Raises:
        CalibError: They go round both ways.
    """
    steps = np.angle(np.exp(1j * np.diff(angles)))
    turn = float(steps.sum())
    if abs(turn) < _ONE_WAY * float(np.abs(steps).sum()):
        raise CalibError(
            f"the points go round both ways, and their order must tell the sense of turning. {ORDER}"
        )
    return turn > 0.0


def _check_one_joint_turns(values: Array, joint: int, joint_names: tuple[str, ...]) -> None:
    """Raise `CalibError` unless one joint turns in a sweep and all others do not move.

    Args:
        values: shape (N, n), the joints' values at all points [rad].
        joint: The joint that should turn, from 0.
        joint_names: Names of the n joints, for messages.
    """
    ranges = np.ptp(values, axis=0)
    turns_too_little = ranges[joint] < TURNED_RAD
    others_turn = np.any(np.delete(ranges, joint) > STILL_RAD)
    if not turns_too_little and not others_turn:
        return
    turns = [
        f"'{name}' {angle:.3g} deg"
        for name, angle in zip(joint_names, np.degrees(ranges), strict=True)
    ]
    raise CalibError(
        f"by their columns the joints turn by {', '.join(turns)}. In a sweep one "
        "joint turns, as far as it can, and all others "
        "do not move; name the joint that turns, or measure it again"
    )


def _turns_forward_by_values(angles: Array, values: Array) -> bool:
    """Return True if points go round in the positive sense of their angles as the joint's value rises.

    Args:
        angles: shape (N,), of the points on the circle [rad].
        values: shape (N,), of the joint that turns [rad].

    Raises:
        CalibError: The points go round otherwise than the joint's values say.
    """
    forward = _disagreement(angles - values)
    backward = _disagreement(angles + values)
    least = min(forward, backward)
    if least > _DISAGREE_RAD:
        raise CalibError(
            f"the points turn otherwise than the joint's column says, by {np.degrees(least):.3g} deg rms. Check "
            "that joint values and points are of the same rows, and the column's unit"
        )
    return forward <= backward


def _disagreement(differences: Array) -> float:
    """Return the standard deviation of angles, shape (N,) [rad], about their circular mean."""
    directions = np.exp(1j * differences)
    return float(np.angle(directions / directions.mean()).std())


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
            correlation = _correlation_of_neighbours(e)
            p_value = ndtr(-correlation * np.sqrt(len(e)))
            if p_value < 0.5 * LEVEL:
                yield SweepFinding(code, sweep.where, correlation)
    if figure.given is not None and np.isfinite(figure.dof):
        yield SweepFinding("scatter", sweep.where, figure.noise / figure.given)


def _correlation_of_neighbours(e: Array) -> float:
    """Return the correlation of residuals (N,), in the order of measurement, with the next; 0 where all are zero."""
    if not np.any(e):
        return 0.0
    return float(e[1:] @ e[:-1] / (e @ e))

"""Sense of turning of a sweep, and findings about it: outliers, neighbours that err alike, noise beyond its sigma."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calib.basics.arrays import Array
from calib.errors import CalibError
from calib.verbs.base_frame.circles import LEVEL, Circle, Plane
from calib.verbs.base_frame.sweeps import Sweep

#: Joints other than the one of a sweep may turn by no more than this [rad].
STILL_RAD = float(np.radians(0.1))

#: The joint of a sweep turns by more than this [rad].
TURNED_RAD = float(np.radians(1.0))

#: If joint values and points disagree by more than this, rms, they are not of the same sweep [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: At least this share of all turning in a sweep goes one way.
_ONE_WAY = 0.8

#: Residuals of at least this many points are tested for correlation.
_FEWEST_TESTED = 10

#: Remedy if the order of the points must show the sense of turning.
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
        values: The joints' values at all points, shape (N, n) [rad], which may change for one joint only; None: the
            points are in the order of increasing joint angle.
        joint: The joint that turns, from 0.
        joint_names: Names of the joints, for messages.

    Returns:
        The circle, or the same with the opposite normal.

    Raises:
        CalibError: Order or values do not show the sense, or contradict the points.
    """
    angles = circle.angles[circle.used]
    if values is None:
        steps = np.angle(np.exp(1j * np.diff(angles)))
        turn = float(steps.sum())
        if abs(turn) < _ONE_WAY * float(np.abs(steps).sum()):
            raise CalibError(
                f"the points go round both ways, and their order must show the sense of turning. {ORDER}"
            )
        return circle if turn > 0.0 else circle.turned()

    ranges = np.ptp(values, axis=0)
    others_turn = np.any(np.delete(ranges, joint) > STILL_RAD)
    if ranges[joint] < TURNED_RAD or others_turn:
        turns = [
            f"'{name}' {angle:.3g} deg"
            for name, angle in zip(joint_names, np.degrees(ranges), strict=True)
        ]
        raise CalibError(
            f"by their columns the joints turn by {', '.join(turns)}. In a sweep one joint turns, as far as it can, "
            "and all others do not move; name the joint that turns, or measure it again"
        )
    joint_values = values[circle.used, joint]
    forward = _disagreement(angles - joint_values)
    backward = _disagreement(angles + joint_values)
    least = min(forward, backward)
    if least > _DISAGREE_RAD:
        raise CalibError(
            f"the points turn otherwise than the joint's column says, by {np.degrees(least):.3g} deg rms. Check "
            "that joint values and points are of the same rows, and the column's unit"
        )
    return circle if forward <= backward else circle.turned()


def _disagreement(differences: Array) -> float:
    """Return the standard deviation of angles, shape (N,) [rad], about their circular mean."""
    directions = np.exp(1j * differences)
    return float(np.angle(directions / directions.mean()).std())


def findings(sweep: Sweep, figure: Plane) -> Iterator[SweepFinding]:
    """Yield findings about a sweep: outliers, correlated residuals of neighbours, and noise beyond the given sigma.

    Their values are the distance of an outlier from the figure [m], the correlation, and the noise divided by sigma.

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
            # Of each residual with the next, in the order of measurement.
            correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
            p_value = ndtr(-correlation * np.sqrt(len(e)))
            if p_value < 0.5 * LEVEL:
                yield SweepFinding(code, sweep.where, correlation)
    if figure.given is not None and np.isfinite(figure.dof):
        yield SweepFinding("scatter", sweep.where, figure.noise / figure.given)

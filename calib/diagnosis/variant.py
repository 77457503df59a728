"""Lengths that no arm is off by: the robot may be another variant than its URDF describes.

Arms are made to tenths of a millimetre; types and variants of one maker differ by millimetres and more, mostly in some
lengths only (UR3 and UR3e in d4, by 18.7 mm). A fit makes up for the difference: rows agree, and the arm in the URDF is
still another one in meshes, masses and limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from calib.basics.arrays import Array
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.stated_values import Scale
from calib.fit.estimate.fitting import Fitted
from calib.model.dh_table import dh_table
from calib.numerics.errors import interval_factor, rms
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS

#: A length that is off by more than this is no error of an arm, whatever its other lengths are [m].
_NO_ARM = 5e-3

#: Nor is one that is off by so many times the rms of the arm's other errors in length, which have the same causes.
_UNLIKE_OTHERS = 20.0

#: A length that is off by less than this, such as a washer's thickness, is no variant's, however right the others are
#: [m].
_NO_VARIANT = 1e-3

#: Steps of the parameters with which lengths are derived, in standard deviations: far below what bends their effect.
_STEP = 0.1

#: An arm has the lengths of a type if none differs by more than this, a few times the largest error of an arm [m].
_SAME_ARM = 2e-3


def other_variant(
    nominal: Robot, corrected: Robot, intervals: Callable[[], Array]
) -> Iterator[Reason]:
    """Yield a reason if a length of an arm has changed by more than any arm's is off, whatever the rows leave open.

    Lengths are a and d of DH rows, d of parallel axes in one of them, from the second to the last but one: the others
    are where base and target are. A length that the rows hardly determine may have changed by any amount: what counts
    is the least change within its interval.

    Args:
        nominal: The robot of the URDF.
        corrected: The same with the corrections of a fit.
        intervals: Returns half the width of the interval of each length, as `length_intervals`, shape (n - 2, 2) [m].

    Yields:
        The reason with the joint of the row, the length, ``"a"`` or ``"d"``, its change, half the width of its interval
        and the rms change of the other lengths [m], and the type of arm whose lengths the corrected robot has, "" if
        none is known.
    """
    of_nominal, of_corrected = _arm_lengths(nominal), _arm_lengths(corrected, nominal)
    sizes = np.abs(of_corrected - of_nominal)
    others = np.array([rms(np.delete(sizes, i)) for i in range(sizes.size)]).reshape(-1, 2)
    excess = sizes - np.clip(_UNLIKE_OTHERS * others, _NO_VARIANT, _NO_ARM)
    if not np.any(excess > 0.0):
        return
    half_widths = intervals()
    least_excess = excess - half_widths  # whatever the rows leave open
    row, column = np.unravel_index(np.argmax(least_excess), least_excess.shape)
    if least_excess[row, column] > 0.0:
        yield Reason.of(
            Why.OTHER_VARIANT,
            joint=nominal.joints[1 + int(row)].name,
            length="ad"[int(column)],
            moved_m=float(sizes[row, column]),
            interval_m=float(half_widths[row, column]),
            others_m=float(others[row, column]),
            arm=_type_of_ur(of_nominal, of_corrected),
        )


def length_intervals(fitted: Fitted, scale: Scale | None) -> Array:
    """Return half the width of the interval of 95 % of each length that `other_variant` compares.

    The variance of the lengths is that of the parameters, J C J^T with the derivative J by small steps of each; a scale
    error of the instrument, of one standard deviation, adds to it what it does to all parameters together.

    Args:
        fitted: A fit of the geometry.
        scale: The scale error of its instrument; None: there is none.

    Returns:
        Shape (n - 2, 2), of a and d of the joints from the second to the last but one [m].
    """
    robot, model, estimate = fitted.task.robot, fitted.kinematics.model, fitted.estimate
    steps = _STEP * np.sqrt(np.diag(estimate.covariance))

    lengths = _arm_lengths(model.apply(robot, estimate.x), robot).ravel()
    J = np.zeros((len(lengths), len(steps)))
    for k in np.flatnonzero(model.of_robot & (steps > 0.0)).tolist():
        x = estimate.x.copy()
        x[k] += steps[k]
        J[:, k] = (_arm_lengths(model.apply(robot, x), robot).ravel() - lengths) / steps[k]
    variances = np.einsum("ik,kl,il->i", J, estimate.covariance, J)
    if scale is not None:
        variances += (scale.size * (J @ scale.growth)) ** 2
    return np.asarray(interval_factor(estimate.freedom) * np.sqrt(variances)).reshape(-1, 2)


def _arm_lengths(robot: Robot, like: Robot | None = None) -> Array:
    """Return a and d of a robot's joints from the second to the last but one, shape (n - 2, 2) [m].

    Open choices of the rows are those of the robot ``like``.
    """
    rows = dh_table(robot, like=like).rows
    return np.array([[row.a, row.d] for row in rows[1:-1]]).reshape(-1, 2)


def _type_of_ur(nominal: Array, corrected: Array) -> str:
    """Return the name of the arm of Universal Robots that has the corrected lengths, shape (n - 2, 2) [m], if any has.

    "" if there is none, or the nominal lengths are not of such an arm, or of the same.
    """

    def types(lengths: Array) -> list[str]:
        """List the arms with these lengths."""
        rows = [(arm.name, arm.rows[1:-1, 1:3]) for arm in MODELS]
        return [
            name
            for name, of_arm in rows
            if of_arm.shape == lengths.shape and np.abs(of_arm - lengths).max() < _SAME_ARM
        ]

    of_nominal = types(nominal)
    others = [name for name in types(corrected) if name not in of_nominal]
    return others[0] if of_nominal and others else ""

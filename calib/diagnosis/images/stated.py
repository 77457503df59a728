"""Intrinsics and boards against what was stated of them.

A relative error of each, of all focal lengths of a camera or of a board along x and y alike, is estimated jointly with
the fit, whose prior standard deviations are estimated anew. It has no prior itself, and is besides what the fit changes
under the stated prior, so that its standard deviation includes the stated one.

A lens or a print that is wrong can fit well: the arm's lengths and the mounts make up for it. Where a board of another
size has made all lengths of the arm grow alike, these priors are wide; with the board's size free they are not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.camera import optics
from calib.diagnosis.further_unknowns import UNLIKELY, estimate_jointly
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted

#: Relative errors of focal lengths and boards below this are of no consequence.
_LEAST_SHARE = 1e-3

#: A p-value below which an estimate contradicts what was stated with a standard deviation.
_CONTRADICTS = 0.01

#: Degrees of freedom that prior standard deviations have at least.
_LEAST_FREEDOM = 3.0

#: Prior standard deviation of a relative change above which nothing was stated.
_NOT_STATED = 1.0

#: Focal lengths along u and v.
_FOCAL = (0, 1)


@dataclass(frozen=True, slots=True)
class _Question:
    """A number that was stated: the columns of `optics` that grow with a relative error of it."""

    #: Code of the reason if it is wrong
    why: Why
    #: Column of the optics with the number of the camera, or of the board, and that number
    owner: tuple[int, int]
    #: Columns of the optics
    columns: tuple[int, ...]
    #: Whether no parameter of the fit changes it
    exact: bool


def contradicted_statements(fitted: Fitted) -> Iterator[Reason]:
    """Find focal lengths and boards that seem to be other than was stated.

    Args:
        fitted: A fit with priors of the robot's errors from the data.

    Yields:
        A reason for each, with its relative error, actual over stated less 1, and the standard deviation of that.
    """
    if fitted.estimate.problem.rows.samples.optics is None:
        return
    for question in _questions(fitted):
        joint = estimate_jointly(fitted, _column(fitted, question))
        share, std = float(joint.b[0]), float(joint.std[0])
        freedom = max(float(np.sum(joint.determined)) - 1.0, _LEAST_FREEDOM)
        limit = UNLIKELY if question.exact else _CONTRADICTS
        if abs(share) > _LEAST_SHARE and joint.p_value(freedom) < limit:
            yield Reason.of(question.why, share=share, std=std, exact=question.exact)


def _questions(fitted: Fitted) -> Iterator[_Question]:
    """Yield the focal lengths and scales of which something was stated."""
    values = fitted.estimate.problem.rows.samples.optics
    assert values is not None
    images = fitted.estimate.problem.rows.where(lambda kind: kind.optical)
    scale = tuple(range(optics.SCALE.start, optics.SCALE.stop))
    for why, owner, columns in (
        (Why.FOCAL_LENGTH_OFF, optics.CAMERA, _FOCAL),
        (Why.BOARD_SCALE_OFF, optics.BOARD, scale),
    ):
        for number in np.unique(values[images, owner]).astype(int).tolist():
            stds = _prior_shares(fitted, (owner, number), columns)
            if not stds or max(stds) < _NOT_STATED:
                yield _Question(why, (owner, number), columns, exact=not stds)


def _prior_shares(
    fitted: Fitted, owner: tuple[int, int], columns: Sequence[int]
) -> tuple[float, ...]:
    """Return the prior standard deviations, as shares, of the parameters that change columns of one camera or board."""
    stated = {unknown.parameter.name: unknown.sigma for unknown in fitted.setup.optics}
    result = []
    for _, parameter in fitted.kinematics.model.optical:
        if parameter.optic in columns and parameter.samples == (owner,):
            # A focal length changes by pixels, a scale by a share.
            size = parameter.nominal if parameter.optic in _FOCAL else 1.0
            result.append(stated[parameter.name] / size)
    return tuple(result)


def _column(fitted: Fitted, question: _Question) -> Array:
    """Return the derivative of the predictions by the relative error of a number, shape (N, D, 1)."""
    rows = fitted.estimate.problem.rows
    x = fitted.estimate.x
    values, stated = fitted.kinematics.optics(x, rows.samples), rows.samples.optics
    assert values is not None
    assert stated is not None
    images = rows.where(lambda kind: kind.optical)
    T = fitted.kinematics.poses(x, rows.samples)
    _, by_optics = optics.image_derivatives(
        T[images], np.zeros((int(np.sum(images)), 6, 1)), values.values[images]
    )
    owner, number = question.owner
    chosen: Mask = values.values[images, owner] == number
    result = np.zeros((len(rows), rows.width, 1))
    of_images = np.zeros((len(by_optics), rows.width))
    for column in question.columns:
        # A focal length grows by a share of the stated one, a scale by the share alone.
        factor = stated[images, column] if question.why is Why.FOCAL_LENGTH_OFF else 1.0
        of_images[:, :2] += by_optics[:, :, column] * np.reshape(factor * chosen, (-1, 1))
    result[images, :, 0] = of_images
    return result

"""Intrinsics and boards against what was stated of them.

Numbers that were taken as exact are estimated jointly with the fit; those that were free under priors are compared with
the standard deviations of these. A lens or a print that is wrong can fit well: the arm's lengths and the mounts make up
for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.camera import optics
from calib.diagnosis.further_unknowns import UNLIKELY, estimate_jointly
from calib.diagnosis.reasons import Reason, Why
from calib.estimate.fitting import Fitted
from calib.model.parameters import Parameter
from calib.units import Array, Mask

#: Relative errors of focal lengths and boards below this are of no consequence.
_LEAST_SHARE = 1e-3

#: An estimate that differs by so many standard deviations from what was stated contradicts it.
_CONTRADICTS = 2.6

#: Prior variance of a relative change above which nothing was stated.
_NOT_STATED = 1.0

#: Focal lengths along u and v.
_FOCAL = (0, 1)


@dataclass(frozen=True, slots=True)
class _Question:
    """A number that was taken as exact: the columns of `optics` that grow with a relative error of it."""

    #: Code of the reason if it is wrong
    why: Why
    #: Column that tells its rows, and its value there
    owner: tuple[int, int]
    #: Columns of the optics
    columns: tuple[int, ...]


def contradicted_statements(fitted: Fitted) -> Iterator[Reason]:
    """Find focal lengths and boards that seem to be other than was stated.

    Args:
        fitted: A fit with priors of the robot's errors from the data.

    Yields:
        A reason for each, with its relative error and the standard deviation of that.
    """
    rows = fitted.estimate.problem.rows
    if rows.samples.optics is None:
        return
    yield from _taken_as_exact(fitted)
    yield from _beyond_priors(fitted)


def _taken_as_exact(fitted: Fitted) -> Iterator[Reason]:
    """Estimate each focal length and each board's scale that was taken as exact."""
    for question in _questions(fitted):
        column = _column(fitted, question)
        joint = estimate_jointly(fitted, column)
        freedom = float(np.sum(joint.determined)) - 1.0
        share, std = float(joint.b[0]), float(joint.std[0])
        if abs(share) > _LEAST_SHARE and joint.p_value(max(freedom, 3.0)) < UNLIKELY:
            yield Reason.of(question.why, share=share, std=std, exact=True)


def _questions(fitted: Fitted) -> Iterator[_Question]:
    """Yield the focal lengths and scales that no parameter of the fit changes."""
    estimated = {
        (parameter.optic, parameter.samples[0])
        for _, parameter in fitted.kinematics.model.optical
        if len(parameter.samples) == 1
    }
    values = fitted.estimate.problem.rows.samples.optics
    assert values is not None
    images = fitted.estimate.problem.rows.where(lambda kind: kind.optical)
    scale = tuple(range(optics.SCALE.start, optics.SCALE.stop))
    for why, owner, columns in (
        (Why.FOCAL_LENGTH_OFF, optics.CAMERA, _FOCAL),
        (Why.BOARD_SCALE_OFF, optics.BOARD, scale),
    ):
        for number in np.unique(values[images, owner]).astype(int).tolist():
            whose = (owner, number)
            if not any((column, whose) in estimated for column in columns):
                yield _Question(why, whose, columns)


def _column(fitted: Fitted, question: _Question) -> Array:
    """Return the derivative of the predictions by the relative error of a number, shape (N, D, 1)."""
    rows = fitted.estimate.problem.rows
    x = fitted.estimate.x
    values = fitted.kinematics.optics(x, rows.samples)
    assert values is not None
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
        # A focal length grows by a share of itself, a scale by the share alone.
        factor = values.values[images, column] if question.why is Why.FOCAL_LENGTH_OFF else 1.0
        of_images[:, :2] += by_optics[:, :, column] * np.reshape(factor * chosen, (-1, 1))
    result[images, :, 0] = of_images
    return result


def _beyond_priors(fitted: Fitted) -> Iterator[Reason]:
    """Find focal lengths and scales that were free, and that the images have elsewhere than was stated."""
    groups: dict[tuple[Why, tuple[int, int]], list[int]] = {}
    for k, parameter in fitted.kinematics.model.optical:
        why = _why(parameter.optic)
        if why is not None:
            groups.setdefault((why, parameter.samples[0]), []).append(k)
    for (why, _), numbers in groups.items():
        share, std, z = _mean_share(fitted, numbers)
        if abs(share) > _LEAST_SHARE and z > _CONTRADICTS:
            yield Reason.of(why, share=share, std=std, exact=False)


def _mean_share(fitted: Fitted, numbers: Sequence[int]) -> tuple[float, float, float]:
    """Compare the mean of two numbers, along x and y or u and v, with what was stated of it.

    With the prior variance s^2 of the mean, and its variance v after the fit, the images alone have the variance
    w = 1 / (1 / v - 1 / s^2). Their estimate, without the prior, is (s^2 + w) / s^2 times that of the fit, and differs
    from what was stated by z standard deviations of both together.

    Args:
        fitted: A fit.
        numbers: Indices of the parameters, from 0.

    Returns:
        The mean relative change as the images alone have it, its standard deviation, and z; z is 0 where nothing was
        stated.
    """
    model = fitted.kinematics.model
    stated = {unknown.parameter.name: unknown for unknown in fitted.setup.optics}
    unknowns = [stated[model.names[k]] for k in numbers]
    sizes = np.array([_size(model.parameters[k]) for k in numbers])
    weights = 1.0 / (len(numbers) * sizes)
    changes = fitted.estimate.x[list(numbers)] - [unknown.mean for unknown in unknowns]
    prior = float(np.sum((weights * [unknown.sigma for unknown in unknowns]) ** 2))
    covariance = fitted.estimate.covariance[np.ix_(numbers, numbers)]
    after = float(weights @ covariance @ weights)
    share = float(weights @ changes)
    if prior > _NOT_STATED or not after < prior:
        return share, float(np.sqrt(prior)), 0.0
    of_images = 1.0 / (1.0 / after - 1.0 / prior)
    both = prior + of_images
    by_images = share * both / prior
    return by_images, float(np.sqrt(of_images)), float(abs(by_images) / np.sqrt(both))


def _size(parameter: Parameter) -> float:
    """Return what a change of a parameter is a share of: a focal length, or 1 for a scale."""
    return parameter.nominal if _why(parameter.optic) is Why.FOCAL_LENGTH_OFF else 1.0


def _why(optic: int | None) -> Why | None:
    """Return the code of a number that is other than stated; None for numbers that are not compared."""
    if optic in _FOCAL:
        return Why.FOCAL_LENGTH_OFF
    if optic in range(optics.SCALE.start, optics.SCALE.stop):
        return Why.BOARD_SCALE_OFF
    return None

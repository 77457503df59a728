"""What lowering the weights of rows that do not fit did: the fit with and without it compared.

Robust weights rest on the belief that a few rows are accidents. How much hangs on that belief is seen by fitting again
with every row in full: how far the predictions at the measured poses and the parameters move, and which of the two
fits predicts the rows better that nobody doubts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, ModelError
from calib.identify.crossvalidation import linear_cross_validation
from calib.identify.fitting import Fitted, fit
from calib.identify.prediction import without_rigid_motion
from calib.identify.statistics import Errors, Mask
from calib.model.robot import read_only

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Robustness:
    """The fit with the weights of doubtful rows lowered, beside the one with every row in full.

    Attributes:
        lowered: Whether it is the calibration that has the weights lowered, or the fit that it is compared with.
        flagged: shape (N,), the fitted rows that the calibration flags.
        moved: shape (N,), how far the other fit's prediction at each measured pose lies from the calibration's [m].
        names: Names of the parameters.
        change: shape (p,), the other fit's parameters minus the calibration's, in their units; of target and frame
            both counted from the same place.
        std: shape (p,), standard deviations of the calibration's parameters.
        errors_lowered: Errors of the rows not flagged, left out, with weights lowered.
        errors_full: The same with every row in full.
    """

    lowered: bool
    flagged: Mask
    moved: Array
    names: tuple[str, ...]
    change: Array
    std: Array
    errors_lowered: Errors
    errors_full: Errors

    @property
    def moved_rms(self) -> float:
        """How far the predictions at the measured poses differ, rms [m]."""
        return float(np.sqrt(np.mean(self.moved**2)))

    @property
    def moved_max(self) -> float:
        """How far they differ at most [m]."""
        return float(np.max(self.moved))

    def sentence(self) -> str:
        """What it comes to."""
        head = "Without" if self.lowered else "With"
        text = (
            f"{head} these rows' weights lowered the prediction would move by {1e3 * self.moved_rms:.3f} mm rms at the "
            f"measured poses, {1e3 * self.moved_max:.3f} mm at most"
        )
        now, other = self.errors_lowered, self.errors_full
        if not self.lowered:
            now, other = other, now
        if now.n:
            text += (
                f"; the error of the other rows, left out of a linearised fit, would be {1e3 * other.rms:.3f} mm rms "
                f"in place of {1e3 * now.rms:.3f} mm"
            )
        return text + "."


def compare(fitted: Fitted) -> Robustness:
    """Fit once more with robust weights where there were none, or without where there were, and compare.

    The errors of left-out rows are those of the linearised problem (`calib.identify.crossvalidation`), over the rows
    that the given fit does not flag: the same rows for both.

    Args:
        fitted: The fit.

    Raises:
        ModelError: The paper's solver made the fit, which has no weights.
    """
    if fitted.task.solver == "paper":
        raise ModelError(
            "The solver 'paper' has no weights to compare with and without. Choose --solver lm."
        )
    estimate, rows = fitted.estimate, fitted.estimate.problem.rows
    other = fit(replace(fitted.task, robust=not fitted.task.robust), rows, started=fitted.setup)
    samples = rows.samples
    as_one_body = not any(kind.position for kind in rows.present)
    if as_one_body:
        samples = replace(samples, frame=np.zeros_like(samples.frame))
    here = fitted.kinematics.points(estimate.x, samples)
    there = other.kinematics.points(other.estimate.x, samples)
    moves = (there - here)[:, :, None]
    if as_one_body:
        moves = without_rigid_motion(here, moves)
    flagged = estimate.outliers
    found = [_left_out(one, flagged) for one in (fitted, other)]
    lowered, full = found if fitted.task.robust else found[::-1]
    return Robustness(
        lowered=fitted.task.robust,
        flagged=flagged,
        moved=read_only(np.linalg.norm(moves[:, :, 0], axis=1)),
        names=fitted.kinematics.model.names,
        # Registration is plain least squares and the same for both: they count from one start.
        change=read_only(other.estimate.x - estimate.x),
        std=read_only(np.sqrt(np.diag(estimate.covariance))),
        errors_lowered=lowered,
        errors_full=full,
    )


def _left_out(fitted: Fitted, flagged: Mask) -> Errors:
    """Errors of left-out rows that are not flagged; none of rows of a single pose, of which none can be left out."""
    used = fitted.estimate.problem.rows.used
    try:
        found = linear_cross_validation(fitted)
    except MeasurementError:
        return Errors.of(np.zeros((0, used.shape[1])))
    return Errors.of(found.residual[~flagged], used[~flagged])

"""fit_sample: the fit of one sample of a bootstrap, as a job for any executor; see `calib.identify.uncertainty`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import Fitted
from calib.identify.solvers import levenberg_marquardt
from calib.model.observability import steps

Array = NDArray[np.float64]

#: A prior wider than this is no prior but a hold on what nothing determines; its mean stays [m, rad].
_LEASH = 1.0

#: A fit of a sample ends with steps below this, in steps of 1 mm and 1 mrad.
_STEP = 1e-4


def fit_sample(fitted: Fitted, drawn: tuple[Array, Array]) -> tuple[Array, bool]:
    """The parameters of one sample, and whether its fit converged.

    Args:
        fitted: The fit.
        drawn: How often each row counts, and standard normal numbers for the priors and the known distances.
    """
    problem, start = fitted.estimate.problem, fitted.estimate.x
    count, normal = drawn
    held = problem.precision > 1.0 / _LEASH**2
    wide = np.where(held, 1.0 / np.sqrt(np.where(held, problem.precision, 1.0)), 0.0)
    sample = problem.reweighted(
        problem.weights * count,
        problem.scales,
        problem.precision,
        problem.centre + wide * normal[: len(start)],
    )
    moved = zip(problem.distances, normal[len(start) :].tolist(), strict=True)
    distances = tuple(replace(d, length=d.length + d.sigma * by) for d, by in moved)
    sample = replace(sample, distances=distances)
    size = steps(fitted.kinematics.model.units)
    solution = levenberg_marquardt(sample.system, start, step_size=size, step_tolerance=_STEP)
    return solution.x, solution.status == "converged"

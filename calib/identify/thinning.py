"""A fit to many rows, looked at through some of them.

What is left over is searched for patterns with all derivatives at hand, whose number grows with the rows. Twenty
thousand rows show any pattern that matters; the fit itself, its errors and its uncertainty are those of all rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.identify.fitting import Fitted
from calib.identify.problem import Problem
from calib.identify.rows import evenly

#: Rows that are looked at; of so many all are.
MOST = 20_000


def thin(fitted: Fitted, most: int = MOST) -> Fitted:
    """The fit with about so many of its rows, spread evenly over each frame and target; itself if it has no more.

    Args:
        fitted: The fit.
        most: How many rows.
    """
    problem, estimate = fitted.estimate.problem, fitted.estimate
    if len(problem.rows) <= most:
        return fitted
    some = np.flatnonzero(evenly(problem.rows, most))
    rows = problem.rows.select(np.isin(np.arange(len(problem.rows)), some))
    few = replace(
        Problem.first(problem.kinematics, rows, problem.distances),
        weights=problem.weights[some],
        scales=problem.scales[some][:, : rows.width],
        precision=problem.precision,
        centre=problem.centre,
    )
    return replace(
        fitted,
        estimate=replace(
            estimate,
            problem=few,
            scores=estimate.scores[some],
            weights=estimate.weights[some],
        ),
    )

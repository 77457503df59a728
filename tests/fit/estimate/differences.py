"""A virtual problem, and derivatives by differences to compare with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.fit.estimate.problem import Problem


def differences(function, x, step):
    """Central differences with one step of Richardson extrapolation."""
    columns = []
    for k in range(len(x)):
        e = np.zeros(len(x))
        e[k] = step
        near = (function(x + e) - function(x - e)) / (2 * step)
        far = (function(x + 2 * e) - function(x - 2 * e)) / (4 * step)
        columns.append((4 * near - far) / 3)
    return np.stack(columns, axis=-1)


def problem_of(virtual, rng, precision):
    x = virtual.offsets(rng, 1e-3, 5e-3)
    rows = replace(virtual.rows(rng, x, 12, 1e-3), sigma={"m": rng.uniform(1e-4, 3e-4, 12)})
    centre = 1e-3 * rng.normal(size=27)
    problem = Problem.initial(virtual.kinematics, rows)
    weights = rng.uniform(0, 1, 12)
    noise = np.full(len(problem.noise), 1.3)
    found = replace(
        problem, weights=weights, noise=noise, prior_precision=precision, prior_mean=centre
    )
    return found, x

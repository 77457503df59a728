"""A solver of one's own: Gauss-Newton that halves a step until it helps, in place of Levenberg-Marquardt."""

import numpy as np

import calib
from calib import solvers


def halving(
    system: solvers.System, x: np.ndarray, unit: np.ndarray, tolerance: float
) -> solvers.Solution:
    """Minimise |r|^2 / 2.

    Args:
        system: From parameters x, (p,), to the residual r, (m,), and its Jacobian, (m, p).
        x: Where to start.
        unit: Significant change of each parameter, (p,): metres and radians become comparable.
        tolerance: The last step is to be shorter than this, in these units.
    """
    r, J = system(x)
    step = np.linalg.lstsq(J, -r)[0]
    length, evaluations = np.inf, 1
    while length > max(tolerance, 1e-8) and evaluations < 100:
        length = float(np.linalg.norm(step / unit))
        r_new, J_new = system(x + step)
        evaluations += 1
        if r_new @ r_new <= r @ r:
            x, r, J = x + step, r_new, J_new
            step = np.linalg.lstsq(J, -r)[0]
        else:
            step = step / 2
    status = "converged" if evaluations < 100 else "stopped"
    return solvers.Solution(x, 0.5 * float(r @ r), status, "Gauss-Newton.", evaluations, history=())


solvers.register("halving", halving)  # a name for tables of results, fleets and plugins

robot = calib.Robot.load("ur3", base="base", tip="tool0")
scenario = calib.Scenario(robot, model="dh")
data = scenario.draw(seed=1).measure(scenario.random_poses(40, seed=1), seed=1).measurements

own = calib.calibrate(robot, data, model="dh", solver="halving")
usual = calib.calibrate(robot, data, model="dh")
for result in (own, usual):
    error, count = (
        result.errors["calibrated"]["estimation"]["m"].rms,
        result.method.solution.evaluations,
    )
    print(
        f"solver {result.method.solver}: {1e3 * error:.4f} mm rms, {count} evaluations in the last run"
    )

# Differences are counted in standard deviations of the estimates, again to compare unlike units.
std = np.array([p.std for p in usual.parameters])
difference = float(np.max(np.abs(own.geometry.x - usual.geometry.x) / std))
assert own.method.solver == "halving"
assert difference < 1e-3
print("All parameters agree to a thousandth of their standard deviations.")

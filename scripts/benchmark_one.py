"""One measurement of benchmark.py, in a process of its own for its memory: prints figures as JSON.

    python scripts/benchmark_one.py fit 3000

The robot is the paper's UR3 with DH errors of a usual size, the tracker's noise 0.05 mm; one row in a hundred is an
outlier.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from benchmark_stages import peak_memory
from numpy.typing import NDArray
from scipy.optimize import least_squares
from studies import add_noise, draw_errors

from calib.basics.arrays import Array, rigid_inverse
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import paper_urdf
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.robot.chain import pinocchio_chain
from calib.robot.robot import Robot

#: Position of the target in the tip [m].
TARGET = np.array([0.05, 0.05, 0.05])

#: Noise of a coordinate [m].
SIGMA = 5e-5


def best_time(work: Callable[[], object], times: int) -> float:
    """Return the shortest of some times of a call, after one that does not count [s]."""
    work()
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def simulate(count: int, seed: int = 0) -> tuple[Robot, Measurements]:
    """Draw the robot's errors and measure points.

    Args:
        count: Number of rows.
        seed: Of the random numbers.

    Returns:
        The nominal robot, and a table of points.
    """
    rng = np.random.default_rng(seed)
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    model = error_model(robot, "dh", target=True)
    x = draw_errors(model, 3e-4, 3e-3, rng)
    q = rng.uniform(-2.8, 2.8, (count, 6))
    points = Kinematics(robot, model, np.eye(4), pose_of(TARGET)).points(x, q)
    points = add_noise(points, SIGMA, rng)
    outlier = rng.uniform(size=count) < 0.01
    points[outlier] = add_noise(points[outlier], 5e-3, rng)
    return robot, Measurements(joint_names=robot.joint_names, joints=q, points=points)


def fit_input(count: int) -> tuple[Task, Rows]:
    """Return the input of the fit alone, for so many rows."""
    robot, table = simulate(count)
    cell = Cell(model="dh")
    rows, setup = rows_and_setup(robot, table, cell)
    return Task(robot, cell, setup, "dh"), rows


def one_pass(count: int) -> Callable[[], object]:
    """Return a pass over so many rows: the residual, its 27 columns and the normal equations."""
    task, rows = fit_input(count)
    model = error_model(task.robot, "dh", target=True)
    kinematics = Kinematics(task.robot, model, np.eye(4), np.eye(4))
    x = np.zeros(len(model))
    weights = np.ones((1, len(rows)))

    def run() -> None:
        """Form the normal equations."""
        problem = Problem.initial(kinematics, rows)
        problem.linear(x).normal_equations(weights, problem.stop_shares)

    return run


def measure_pass(count: int) -> dict[str, float]:
    """Measure one pass over so many rows."""
    return {"seconds": best_time(one_pass(count), 5)}


def measure_fit(count: int) -> dict[str, float]:
    """Measure the fit of so many rows alone."""
    task, rows = fit_input(count)
    times = 3
    if count <= 30_000:
        times = 200 if count <= 300 else 20
    return {"seconds": best_time(lambda: fit(task, rows), times), "megabytes": peak_memory()}


def measure_calibration(count: int) -> dict[str, float]:
    """Measure `calibrate` with a given model, the same cross-validated, and with `auto`."""
    robot, table = simulate(count)
    times = 1
    if count <= 30_000:
        times = 20 if count <= 300 else 3
    given = best_time(lambda: calibrate(robot, table, model="dh", validate=False), times)
    megabytes = peak_memory()
    validated = best_time(lambda: calibrate(robot, table, model="dh"), times)
    auto = best_time(lambda: calibrate(robot, table), times)
    return {"given": given, "validated": validated, "auto": auto, "megabytes": megabytes}


@dataclass(frozen=True)
class PlainFit:
    """Plain least squares on the same rows, pose by pose through Pinocchio, by SciPy's solver."""

    robot: Robot
    q: Array  # shape (N, 6), joint values of the chain [rad]
    measured: Array  # shape (N, 3), [m]

    def predict(self, x: Array, *, jacobian: bool) -> tuple[Array, NDArray[np.float64]]:
        """Predict the points.

        Args:
            x: shape (27,), parameters of the model `dh` with a target.
            jacobian: Return the derivative too, by Pinocchio's regressor.

        Returns:
            Points, shape (N, 3), [m], and their derivative, shape (N, 3, 27); (0, 3, 27) if it is not wanted.
        """
        robot = self.robot
        joints = len(robot.joints)
        model = error_model(robot, "dh", target=True)
        D, S = model.displacements(x)  # of the frame, the joints, the tip and the target
        placements = [pin.SE3(T) for T in robot.placements @ D[1 : joints + 2]]
        # The first placement is in the URDF's root; points are measured in the base.
        placements[0] = pin.SE3(rigid_inverse(robot.T_root_base)) * placements[0]
        chain = pinocchio_chain(robot.joints, np.array([T.homogeneous for T in placements]))
        data = chain.createData()
        T_tip_target = pose_of(TARGET)
        T_last_target = placements[-1] * pin.SE3(T_tip_target) * pin.SE3(D[-1])
        target_columns = pin.SE3(T_tip_target @ D[-1]).toActionMatrixInverse() @ S[-12:-6] + S[-6:]
        count = len(self.q)
        points = np.empty((count, 3))
        J = np.empty((count if jacobian else 0, 3, len(x)))
        for i in range(count):
            pin.forwardKinematics(chain, data, self.q[i])
            pose = data.oMi[joints] * T_last_target
            points[i] = pose.translation
            if jacobian:
                regressor = pin.computeJointKinematicRegressor(
                    chain, data, joints, pin.LOCAL_WORLD_ALIGNED, T_last_target
                )
                J[i] = regressor[:3] @ S[6 : 6 * joints + 6]
                J[i] += pose.rotation @ target_columns[:3]
        return points, J

    def residual(self, x: Array) -> Array:
        """Return the whitened residual, shape (3 N,)."""
        points, _ = self.predict(x, jacobian=False)
        return np.asarray((self.measured - points).ravel() / SIGMA)

    def derivative(self, x: Array) -> Array:
        """Return the derivative of the residual, shape (3 N, 27)."""
        _, J = self.predict(x, jacobian=True)
        return np.asarray(-J.reshape(-1, len(x)) / SIGMA)

    def solve(self, jacobian: str | Callable[[Array], Array]) -> float:
        """Fit by SciPy with its own differences (``"2-point"``) or a derivative; return the time [s]."""
        began = time.perf_counter()
        least_squares(self.residual, np.zeros(27), jac=jacobian, x_scale=1e-3)
        return time.perf_counter() - began


def plain_fit(count: int) -> PlainFit:
    """Return plain least squares on so many rows, after a check that it predicts the same points as calib."""
    task, rows = fit_input(count)
    plain = PlainFit(task.robot, task.robot.chain_values(rows.joints), rows.measured[:, :3])
    # Times compare only if both fit the same points.
    points, _ = plain.predict(np.zeros(27), jacobian=False)
    model = error_model(task.robot, "dh", target=True)
    kinematics = Kinematics(task.robot, model, np.eye(4), pose_of(TARGET))
    np.testing.assert_allclose(points, kinematics.points(np.zeros(27), rows.joints), atol=1e-12)
    return plain


def measure_differences(count: int) -> dict[str, float]:
    """Measure plain least squares with finite differences, as most scripts do it."""
    return {"seconds": plain_fit(count).solve("2-point")}


def measure_regressor(count: int) -> dict[str, float]:
    """Measure plain least squares with the derivative by Pinocchio's regressor."""
    plain = plain_fit(count)
    return {"seconds": plain.solve(plain.derivative)}


MEASUREMENTS = {
    "pass": measure_pass,
    "fit": measure_fit,
    "calibration": measure_calibration,
    "differences": measure_differences,
    "regressor": measure_regressor,
}


def main() -> None:
    """Print the figures of one measurement as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("measurement", choices=MEASUREMENTS)
    parser.add_argument("rows", type=int)
    arguments = parser.parse_args()
    print(json.dumps(MEASUREMENTS[arguments.measurement](arguments.rows)))


if __name__ == "__main__":
    main()

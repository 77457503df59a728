"""Joint values from poses of the flange: all solutions of the controller's model, and which of them the arm was at.

An arm reaches a pose in several ways. Which one it was at is told by the limits of its joints, by the other poses (an
arm seldom changes its branch), and by what was measured there: to an arm with errors each branch adds others, and only
the true ones are explained by one set of errors. So each way through all poses is fitted; of the best one the solution
of each pose is then exchanged for any that explains what was measured there better, until none does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, SolverError, UrdfError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot
from calib.verbs.compensate.solutions import joint_solutions
from calib.verbs.joints.branches import detours, unwound, ways

#: A choice is decided by what was measured if it is so many times as likely as any other, as a logarithm: 1000 to 1.
_DECISIVE = float(np.log(1e3))

#: A choice is decided by the other poses if any other one makes the joints move farther by this, in sum [rad]: another
#: branch turns some joint by a quarter turn or more, there and back.
_DETOUR = 0.5 * np.pi

#: A solution that seems less likely by so many times that, as a logarithm, by a fit that has the other one, is fitted
#: too: a pose alone may draw a fit that far.
_MET = 30.0

#: Errors of the robot by which branches are told apart: all that its geometry can have.
_MODEL = "placement"

#: The most rounds in which solutions are exchanged.
_ROUNDS = 5


@dataclass(frozen=True, slots=True, eq=False)
class JointValues(Value):
    """Joint values at N poses of the flange."""

    #: shape (N, m), [rad] or [m], at the likeliest solutions.
    q: Array
    #: shape (N,), number of solutions inside the limits, up to whole turns.
    counts: Integers
    #: shape (N,), True where the solution is the only one, or is decided by the other poses or by what was measured.
    unique: Mask
    #: What decided between ways through all poses: "limits", "poses", "measurements"; "" if nothing did.
    decided_by: str
    #: Names of the joints that may as well be whole turns away at all poses.
    open_turns: tuple[str, ...]
    #: Logarithm of how many times as likely the way is as the next one, by what was measured; NaN if that was not used.
    lead: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredThere(Value):
    """The measurements at the poses, with which the right solution is chosen."""

    #: The chain that is fitted, such as from the camera's link to the board's.
    robot: Robot
    #: The table of R rows; its joint values do not matter.
    measurements: Measurements
    #: What is known of camera, board, frames and targets.
    cell: Cell
    #: Names of the joints whose values are sought, in their order.
    joint_names: tuple[str, ...]
    #: shape (R,), index of each row's pose, from 0.
    pose: Integers

    def fitted(self, q: Array) -> tuple[Fitted, Rows] | None:
        """Fit the robot at joint values of the poses, (N, m); None if these values cannot be fitted at all."""
        try:
            rows, setup = rows_and_setup(self.robot, self._at(q), self.cell)
            cell = replace(self.cell, model=_MODEL)
            distances = known_distances(cell, setup)
            # A pose at another solution would be an outlier, without which all others are likelier.
            task = Task(self.robot, cell, setup, _MODEL, distances, robust=False, allow_absent=True)
            return fit(task, rows), rows
        except (MeasurementError, SolverError):
            return None

    def misfits(self, fitted: Fitted, rows: Rows, q: Array) -> Array:
        """Return what speaks against other joint values of each pose, by a fit: half the sum of squares there, (N,).

        Residuals are in units of the fit's noise.
        """
        others, _ = rows_and_setup(self.robot, self._at(q), self.cell)
        at_values = replace(rows, samples=replace(rows.samples, q=others.samples.q))
        whitened = fitted.residual(at_values) / fitted.estimate.problem.scales
        squares = np.sum(np.where(rows.used, whitened, 0.0) ** 2, axis=1)
        return np.asarray(np.bincount(self.pose, 0.5 * squares, minlength=len(q)))

    def _at(self, q: Array) -> Measurements:
        """Return the table at joint values of the poses, (N, m)."""
        joints = read_only(q[self.pose])
        sliding = [
            name for name in self.joint_names if self.robot.joint_types.get(name) == "prismatic"
        ]
        return replace(
            self.measurements,
            joint_names=self.joint_names,
            joints=joints,
            prismatic=tuple(sliding),
            moves=None,
            units={},
        )


def joint_values(
    robot: Robot, T_base_tip: Array, measured: MeasuredThere | None = None
) -> JointValues:
    """Compute joint values at poses of the flange, and say where they are the only ones.

    Args:
        robot: The robot as its controller has it, from the frame of the poses to the link whose poses they are.
        T_base_tip: The poses in the order in which the arm went to them, shape (N, 4, 4) [m].
        measured: What was measured there; None: limits and the other poses decide alone.

    Raises:
        ModelError: The arm has more than six joints.
        UrdfError: A pose is not reached inside the limits.
    """
    solutions = joint_solutions(robot, T_base_tip)
    counts = np.array([len(values) for values in solutions])
    if not counts.all():
        raise UrdfError(
            f"'{robot.name}' does not reach {np.sum(counts == 0)} of {len(counts)} poses of '{robot.tip}' in "
            f"'{robot.base}' inside its joints' limits; the first is pose {int(np.argmin(counts)) + 1}. Is it the "
            "model that the controller has (--controller), are the poses in this frame (--poses-in) and of this link "
            "(--poses-of), and is it their convention (--orientation) and unit?"
        )
    every_way = ways(robot, solutions)

    def at(way: Integers) -> Array:
        """Return joint values along a way, (N, m)."""
        return unwound(robot, np.array([s[k] for s, k in zip(solutions, way, strict=True)]))[0]

    way, decided_by, lead = every_way[0], "", np.nan
    by_detour = detours(robot, solutions, way) > _DETOUR
    unique = counts == 1
    if unique.all():
        decided_by = "limits"
    elif measured is not None:
        way, lead, by_measurement = _by_measurements(solutions, every_way, at, measured)
        decided_by = "measurements" if lead > _DECISIVE else ""
        by_detour = detours(robot, solutions, way) > _DETOUR
        unique = unique | ((by_measurement | by_detour) & (lead > _DECISIVE))
    elif unique.any() and by_detour.all():
        decided_by, unique = "poses", np.ones_like(unique)
    q, open_turns = unwound(robot, at(way))
    return JointValues(read_only(q), counts, unique, decided_by, open_turns, lead)


def _by_measurements(
    solutions: Sequence[Array],
    every_way: Sequence[Integers],
    at: Callable[[Integers], Array],
    measured: MeasuredThere,
) -> tuple[Integers, float, Mask]:
    """Return the way that explains the measurements best, its lead, and where other solutions explain them far worse.

    The lead is the logarithm of how many times as likely it is as the likeliest way that differs from it at most of the
    poses; ``at`` gives joint values along a way.
    """
    likelihoods = []
    for way in every_way:
        found = measured.fitted(at(way))
        likelihoods.append(-np.inf if found is None else found[0].estimate.log_likelihood)
    best = every_way[int(np.argmax(likelihoods))]

    # Exchange single solutions while any other explains what was measured at its pose better.
    most = max(map(len, solutions))
    way, likelihood = best, -np.inf
    against = np.zeros((most, len(solutions)))
    tried = best
    for _ in range(_ROUNDS):
        found = measured.fitted(at(tried))
        if found is None or found[0].estimate.log_likelihood <= likelihood:
            break
        way, likelihood = tried, found[0].estimate.log_likelihood
        against = np.full((most, len(solutions)), np.inf)
        for k in range(most):
            exists = np.array([k < len(values) for values in solutions])
            index = np.where(exists, k, way)
            misfits = measured.misfits(*found, at(index))
            against[k, exists] = misfits[exists]
        tried = np.argmin(against, axis=0)
    poses = np.arange(len(way))
    margin = -against[way, poses]
    against[way, poses] = np.inf
    margin += against.min(axis=0)

    is_open = np.array([len(values) > 1 for values in solutions])
    rivals = [
        value
        for other, value in zip(every_way, likelihoods, strict=True)
        if np.mean((other != way)[is_open]) > 0.5
    ]
    lead = likelihood - max(rivals, default=-np.inf)
    if lead > _DECISIVE:
        # The fit has come to meet what was measured at a pose: where the next solution is not far worse, it is fitted.
        for n in np.flatnonzero(margin < _MET * _DECISIVE).tolist():
            other = np.where(poses == n, np.argmin(against[:, n]), way)
            found = measured.fitted(at(other))
            if found is not None:
                margin[n] = likelihood - found[0].estimate.log_likelihood
    return way, float(lead), margin > _DECISIVE

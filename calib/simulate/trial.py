"""one_trial: a robot with errors of its own, measured, calibrated from that alone, and compared with its truth.

A trial draws a true robot, sends it to the poses, measures it there with noise, calibrates the nominal robot with these
measurements alone, and asks both robots for the target's position at poses that were not measured: the error there is
known, because the truth is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from calib.design.candidates import draw, planning_ranges
from calib.design.choice import choose_poses
from calib.design.sensitivity import Sensitivity
from calib.identify.calibration import calibrate, fit_table
from calib.identify.fitting import Fitted
from calib.identify.rigid_motion import without_rigid_motion
from calib.identify.verdict import NO
from calib.measure.cell import Cell
from calib.model.kinematics import Samples
from calib.model.robot import read_only, rigid_inverse
from calib.model.torques import gravity_load
from calib.simulate.scenario import Scenario, Simulated
from calib.simulate.truth import Truth

Array = NDArray[np.float64]

#: Poses at which a trial is verified, and the seed that they are drawn with.
VERIFIED = 500
_VERIFY_SEED = 19790401

#: Candidates that each trial's plan is chosen from: it is made anew each time.
PLAN_CANDIDATES = 2000

#: What of a stated region should hold the truth.
_LEVEL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """What is done each time.

    Attributes:
        scenario: What robots and disturbances are drawn.
        cell: What the fit is told; its model too.
        poses: shape (N, m), poses to measure, the same each time; None: ``count`` others each time.
        sets: ``"estimate"`` or ``"validate"`` for each of ``poses``.
        count: Poses to fit, where they are made each time.
        validation: Random poses to validate with, besides.
        planned: Whether they are planned, or drawn at random.
        criterion: Of the plan.
        validate: Whether each fit is cross-validated, for its verdict.
        solver: Of the fit.
    """

    scenario: Scenario
    cell: Cell
    poses: Array | None = None
    sets: tuple[str, ...] = ()
    count: int = 30
    validation: int = 0
    planned: bool = False
    criterion: str = "V"
    validate: bool = True
    solver: str = "lm"

    @property
    def fitted(self) -> int:
        """Number of poses that are fitted each time."""
        return self.count if self.poses is None else self.sets.count("estimate")


@dataclass(frozen=True, slots=True)
class Trial:
    """One robot, calibrated and verified.

    Attributes:
        seed: Of everything that was drawn.
        nominal_rms: Error of the nominal robot, frame and target where they truly are, over the poses of the
            verification [m].
        rms: Error of what the calibrated robot predicts there [m].
        max: The largest [m].
        stated_rms: What the fit itself says of its error there [m].
        covered: Share of these positions inside the 95 % ellipsoid that the fit states.
        sigma: Noise that the fit found, with the larger model where there is one [m].
        model: The parameter set that was fitted.
        verdict: The verdict's word; "" without one.
        outliers: How many rows are outliers in truth.
        flagged: How many of these the fit named.
        false_alarms: How many others it named.
    """

    seed: int
    nominal_rms: float
    rms: float
    max: float
    stated_rms: float
    covered: float
    sigma: float
    model: str
    verdict: str
    outliers: int
    flagged: int
    false_alarms: int


def one_trial(trials: Trials, seed: int) -> Trial:
    """Plan, measure, fit and verify once.

    Args:
        trials: What is done.
        seed: Of everything that is drawn.

    Raises:
        CalibError: The poses, the scenario or the cell do not fit the robot, or the fit has no result.
    """
    virtual = trials.scenario.draw(seed)
    q, sets = trial_poses(trials, seed)
    simulated = virtual.measure(q, seed, sets)
    fitted, verdict, named = _calibrated(trials, simulated)
    outliers = set(simulated.outlier_rows)
    return Trial(
        seed=seed,
        **_verified(trials, simulated.truth, fitted),
        sigma=_sigma(fitted),
        model=fitted.kinematics.model.name,
        verdict=verdict,
        outliers=len(outliers),
        flagged=len(outliers & named),
        false_alarms=len(named - outliers),
    )


def _calibrated(trials: Trials, simulated: Simulated) -> tuple[Fitted, str, frozenset[int]]:
    """The last fit of a calibration, of the larger model where there is one; the verdict's word; the rows it flags.

    Without validation the fits alone are made, not all that is said of them, and the word is "".
    """
    robot, table = trials.scenario.robot, simulated.measurements
    if trials.validate:
        result = calibrate(robot, table, cell=trials.cell, solver=trials.solver)
        assert result.verdict is not None
        assert result.fit is not None
        fitted = result.fit.larger or result.fit.geometry
        return fitted, result.verdict.use, frozenset(outlier.row for outlier in result.outliers)
    fits = fit_table(robot, table, trials.cell, solver=trials.solver)
    fitted = fits.fitted if fits.larger is None else fits.larger
    rows = np.array(table.rows)[table.estimation]
    flagged = frozenset(rows[fits.fitted.estimate.outliers].tolist())
    return fitted, NO if fits.hint else "", flagged


@lru_cache(maxsize=4)
def verification_poses(scenario: Scenario) -> Array:
    """The poses at which every trial is verified, shape (500, m), [rad] or [m]: random ones over the joint ranges."""
    return read_only(scenario.random_poses(VERIFIED, _VERIFY_SEED))


@lru_cache(maxsize=4)
def _nominal_there(scenario: Scenario) -> Array:
    """Where the nominal robot puts its tip at these, shape (500, 4, 4), [m]."""
    return read_only(scenario.robot.poses(verification_poses(scenario)))


def _verified(trials: Trials, truth: Truth, fitted: Fitted) -> dict[str, float]:
    """A calibration against the truth at poses that it has not seen: fields of `Trial`."""
    scenario = trials.scenario
    q = verification_poses(scenario)
    T_base_tip, T_tip_target = truth.tip_poses(q), truth.T_tip_target[0]
    T_base_target = T_base_tip @ T_tip_target
    nominal = ((T_base_tip - _nominal_there(scenario)) @ T_tip_target)[:, :3, 3]
    predicted, J = _predicted(trials, fitted, q)
    if scenario.kind.position:
        error = predicted - (truth.T_frame_base[0] @ T_base_target)[:, :3, 3]
    else:  # lengths do not tell where the base stands: only the shape of all positions counts
        moved = (predicted - T_base_target[:, :3, 3])[:, :, None]
        error = without_rigid_motion(predicted, moved)[:, :, 0]
        J = without_rigid_motion(predicted, J)
    length = np.linalg.norm(error, axis=1)
    estimate = fitted.estimate
    stated = (J.reshape(-1, J.shape[2]) @ estimate.covariance).reshape(J.shape)
    stated = stated @ J.transpose(0, 2, 1)
    return {
        "nominal_rms": _rms(np.linalg.norm(nominal, axis=1)),
        "rms": _rms(length),
        "max": float(np.max(length)),
        "stated_rms": float(np.sqrt(np.mean(np.trace(stated, axis1=1, axis2=2)))),
        "covered": _covered(estimate.freedom, stated, error),
    }


def _predicted(trials: Trials, fitted: Fitted, q: Array) -> tuple[Array, Array]:
    """Predicted positions, in the base where lengths were measured, and their derivative, (N, 3) and (N, 3, p)."""
    robot, cell = trials.scenario.robot, trials.cell
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_load(robot, q, cell.payload, cell.gravity)
    poses, twists = fitted.kinematics.twists(fitted.estimate.x, Samples.at(q, load), rotation=False)
    if not trials.scenario.kind.position:
        poses = rigid_inverse(fitted.placed().T_frame_base[0]) @ poses
    return poses[:, :3, 3], twists


def _covered(freedom: float, stated: Array, error: Array) -> float:
    """The share of positions whose error lies inside the ellipsoid that the fit states."""
    square = np.sum(error * np.linalg.solve(stated, error[:, :, None])[:, :, 0], axis=1)
    limit = 3.0 * fdtri(3, max(freedom, 1.0), _LEVEL)
    return float(np.mean(square <= limit))


def _rms(lengths: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(lengths**2)))


def _sigma(fitted: Fitted) -> float:
    """The noise of one length that the fit found [m]; NaN without lengths."""
    problem = fitted.estimate.problem
    lengths = problem.scales[:, :3][problem.rows.used[:, :3]]
    return float(np.median(lengths)) if lengths.size else float("nan")


def trial_poses(trials: Trials, seed: int) -> tuple[Array, tuple[str, ...]]:
    """The poses of one trial, and the set of each: given, planned, or random by the seed; and to validate with."""
    given = trials.poses
    if given is None and trials.planned:
        given = _planned(trials, seed)
    return trials.scenario.poses(seed, trials.count, trials.validation, given, trials.sets)


def _planned(trials: Trials, seed: int) -> Array:
    """Poses that are planned for this trial; collisions are not looked at, for the robot is a virtual one."""
    robot = trials.scenario.robot
    sensitivity = Sensitivity.of(robot, trials.cell)
    ranges = planning_ranges(robot, trials.scenario.cell.ranges, 0.0)
    pool = draw(robot, ranges, [], max(PLAN_CANDIDATES, trials.count), seed)
    chosen = choose_poses(
        sensitivity,
        pool,
        count=trials.count,
        criterion=trials.criterion,
        ladder=(),
        seed=seed,
        restarts=1,
    )
    return chosen.planned

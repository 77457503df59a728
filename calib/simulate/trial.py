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

import calib.kinds as registry
from calib.design.candidates import draw, planning_ranges
from calib.design.choice import choose_poses
from calib.design.sensitivity import Sensitivity
from calib.identify.calibration import calibrate, fit_table
from calib.identify.fitting import Fitted
from calib.identify.rigid_motion import without_rigid_motion
from calib.identify.verdict import NO
from calib.measure.cell import Cell
from calib.measure.scenario import Scenario
from calib.measure.simulation import Simulated, VirtualCell
from calib.model.kinematics import Samples
from calib.model.robot import read_only, rigid_inverse
from calib.model.torques import gravity_load

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
    return _verified(trials, virtual, simulated, _calibrated(trials, simulated), seed)


@dataclass(frozen=True, slots=True, eq=False)
class _Calibrated:
    """What a trial asks of its calibration.

    Attributes:
        fitted: The last fit: of the larger model where there is one.
        verdict: Its word; "" without one.
        named: The table's rows that are flagged.
    """

    fitted: Fitted
    verdict: str
    named: frozenset[int]


def _calibrated(trials: Trials, simulated: Simulated) -> _Calibrated:
    """Calibrate from the simulated measurements; without validation only the fits are made, not all that is said."""
    robot, table = trials.scenario.robot, simulated.measurements
    if trials.validate:
        result = calibrate(robot, table, cell=trials.cell, solver=trials.solver)
        assert result.verdict is not None
        assert result.fit is not None
        fitted = result.fit.larger or result.fit.geometry
        named = frozenset(outlier.row for outlier in result.outliers)
        return _Calibrated(fitted, result.verdict.use, named)
    fits = fit_table(robot, table, trials.cell, solver=trials.solver)
    fitted = fits.fitted if fits.larger is None else fits.larger
    rows = np.array(table.rows)[table.estimation]
    flagged = frozenset(rows[fits.fitted.estimate.outliers].tolist())
    return _Calibrated(fitted, NO if fits.hint else "", flagged)


@lru_cache(maxsize=4)
def verification_poses(scenario: Scenario) -> Array:
    """The poses at which every trial is verified, shape (500, m), [rad] or [m]: random ones over the joint ranges."""
    return read_only(scenario.random_poses(VERIFIED, _VERIFY_SEED))


def _verified(
    trials: Trials, virtual: VirtualCell, simulated: Simulated, found: _Calibrated, seed: int
) -> Trial:
    """A calibration against the truth, at poses that it has not seen."""
    q, truth = verification_poses(trials.scenario), virtual.truth
    T_base_tip = truth.tip_poses(q)
    T_base_target = T_base_tip @ truth.T_tip_target[0]
    predicted, J = _predicted(trials, found.fitted, q)
    if not registry.get(trials.scenario.kind).position:
        # Lengths do not tell where the base stands: only the shape of all positions counts.
        true = T_base_target[:, :3, 3]
        error = without_rigid_motion(predicted, (predicted - true)[:, :, None])[:, :, 0]
        J = without_rigid_motion(predicted, J)
    else:
        error = predicted - (truth.T_frame_base[0] @ T_base_target)[:, :3, 3]
    length = np.linalg.norm(error, axis=1)
    estimate = found.fitted.estimate
    wide = (J.reshape(-1, J.shape[2]) @ estimate.covariance).reshape(J.shape)
    stated = wide @ J.transpose(0, 2, 1)
    outliers = set(simulated.outlier_rows)
    return Trial(
        seed=seed,
        nominal_rms=float(np.sqrt(np.mean(truth.nominal_errors(q, T_base_tip) ** 2))),
        rms=float(np.sqrt(np.mean(length**2))),
        max=float(np.max(length)),
        stated_rms=float(np.sqrt(np.mean(np.trace(stated, axis1=1, axis2=2)))),
        covered=_covered(estimate.freedom, stated, error),
        sigma=_sigma(found.fitted),
        model=found.fitted.kinematics.model.name,
        verdict=found.verdict,
        outliers=len(outliers),
        flagged=len(outliers & found.named),
        false_alarms=len(found.named - outliers),
    )


def _predicted(trials: Trials, fitted: Fitted, q: Array) -> tuple[Array, Array]:
    """Predicted positions, in the base where lengths were measured, and their derivative, shapes (N, 3) and (N, 3, p).

    By the compiled kernel, however few poses there are: a study asks at the same ones again and again.
    """
    robot, cell = trials.scenario.robot, trials.cell
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_load(robot, q, cell.payload, cell.gravity)
    poses, twists = fitted.kinematics.twists(fitted.estimate.x, Samples.at(q, load), rotation=False)
    if not registry.get(trials.scenario.kind).position:
        poses = rigid_inverse(fitted.placed().T_frame_base[0]) @ poses
    return poses[:, :3, 3], twists


def _covered(freedom: float, stated: Array, error: Array) -> float:
    """The share of positions whose error lies inside the ellipsoid that the fit states."""
    square = np.sum(error * np.linalg.solve(stated, error[:, :, None])[:, :, 0], axis=1)
    limit = 3.0 * fdtri(3, max(freedom, 1.0), _LEVEL)
    return float(np.mean(square <= limit))


def _sigma(fitted: Fitted) -> float:
    """The noise of one length that the fit found [m]; NaN without lengths."""
    problem = fitted.estimate.problem
    lengths = problem.scales[:, :3][problem.rows.used[:, :3]]
    return float(np.median(lengths)) if lengths.size else float("nan")


def trial_poses(trials: Trials, seed: int) -> tuple[Array, tuple[str, ...]]:
    """The poses of one trial, and the set of each."""
    q, sets = trials.poses, trials.sets
    if q is None:
        q = (
            _planned(trials, seed)
            if trials.planned
            else trials.scenario.random_poses(trials.count, seed)
        )
        sets = ("estimate",) * len(q)
    extra = trials.scenario.random_poses(trials.validation, seed, validation=True)
    return np.concatenate([q, extra]), (*sets, *("validate",) * len(extra))


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

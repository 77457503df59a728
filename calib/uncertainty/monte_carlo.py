"""The uncertainty of poses by Monte Carlo (JCGM 101): every input drawn by its distribution, through the kinematics.

A trial draws the parameters from their covariance, the scale of the instrument, families of errors, stated places,
arrivals, joints beside their readings, and temperatures, and computes the pose that the robot would reach. U is the
quantile of the distance from the predicted pose, by the probability that k = 2 stands for. Variances that were
estimated with nu degrees of freedom make Student's t: normal numbers times sqrt(nu / chi^2_nu). Errors of parameters,
of joints and of lengths go through the kinematics itself, so that what the linear law neglects is in it.

Trials are made in blocks until the standard error of U, by the spread of the blocks, is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.model.error_model import FRAME
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import displacements_by
from calib.result.calibration import Calibration
from calib.result.fitted_model import FittedModel
from calib.uncertainty.at_poses import (
    PoseUncertainty,
    arrivals_of,
    beyond_measured,
    by_stated_places,
    scale_std,
    stated_joint_limits,
    uncertainty_at,
    warmer,
)
from calib.uncertainty.coverage import PROBABILITY

#: Trials of a block; its quantile rests on 23 trials beyond it.
_BLOCK = 500

#: The fewest and the most blocks.
_BLOCKS = (5, 40)


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo(Value):
    """Uncertainty of N poses by Monte Carlo, beside that by the linear law."""

    #: Shape (N,), the distance that the position's error stays below with the probability of k = 2 [m]
    position: Array
    #: Shape (N,), the angle that the orientation's error stays below [rad]
    orientation: Array
    #: The same by the linear law
    linear: PoseUncertainty
    #: Number of trials
    trials: int
    #: Standard error of the rms of ``position``, as a share of it
    standard_error: float

    @property
    def ratio(self) -> float:
        """U of positions by the linear law over that by Monte Carlo, rms over the poses each; NaN if both are 0."""
        whole = rms(self.position)
        return rms(self.linear.position) / whole if whole > 0.0 else np.nan


def monte_carlo(
    result: Calibration,
    samples: Samples,
    *,
    non_geometric: bool = True,
    in_base: bool = False,
    seed: int = 0,
    tolerance: float = 1e-2,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Compute the uncertainty of poses by Monte Carlo.

    Args:
        result: The calibration, made here or read from its file.
        samples: N joint values, with the frame, the target, the loads and the last moves of each.
        non_geometric: Whether the non-geometric model predicts, if there is one; else the geometry.
        in_base: Whether the poses are those in the base; else in each sample's measurement frame.
        seed: Of the random numbers.
        tolerance: Standard error of U, as a share, at which no more trials are made.
        progress: Called after each block with the number of blocks done, and the most that there may be.

    Returns:
        U of each pose by Monte Carlo and by the linear law.
    """
    model = result.part(non_geometric=non_geometric)
    draw = _trial(result, model, samples, np.random.default_rng(seed), in_base=in_base)
    least, most = _BLOCKS
    lengths: list[Array] = []
    of_blocks: list[float] = []
    error = np.inf
    while len(of_blocks) < most and (len(of_blocks) < least or error > tolerance):
        block = np.array([draw() for _ in range(_BLOCK)])
        lengths.append(block)
        of_blocks.append(rms(np.quantile(block[:, 0], PROBABILITY, axis=0)))
        if len(of_blocks) > 1:
            spread = float(np.std(of_blocks, ddof=1)) / np.sqrt(len(of_blocks))
            error = spread / max(float(np.mean(of_blocks)), np.finfo(float).tiny)
        if progress is not None:
            progress(len(of_blocks), most)
    position, orientation = np.quantile(np.concatenate(lengths), PROBABILITY, axis=0)
    return MonteCarlo(
        position=read_only(position),
        orientation=read_only(orientation),
        linear=uncertainty_at(result, samples, non_geometric=non_geometric, in_base=in_base),
        trials=_BLOCK * len(of_blocks),
        standard_error=float(error),
    )


def _trial(
    result: Calibration,
    model: FittedModel,
    samples: Samples,
    rng: np.random.Generator,
    *,
    in_base: bool,
) -> Callable[[], Array]:
    """Return a function that draws all errors once and returns the lengths of those of N poses, (2, N) [m], [rad]."""
    kinematics, x = model.kinematics, model.x
    poses, twists = model.twists(samples, in_base=in_base)
    in_frame = kinematics.poses(x, samples)
    origins = model.setup.T_frame_base[samples.frame]
    # Of an estimated frame a prediction in the base does not have the errors.
    to_frame = origins[:, :3, :3] if in_base else np.tile(np.eye(3), (len(poses), 1, 1))
    total = twists @ model.covariance @ twists.transpose(0, 2, 1)
    share, families = beyond_measured(result, model, samples, twists, total, in_base=in_base)
    places = [
        left for _, left in by_stated_places(result, model, samples, poses, twists, in_base=in_base)
    ]
    arrivals = arrivals_of(result, model)
    half_step, lost = stated_joint_limits(result)
    stated, measured_at = result.stated_uncertainty, result.record.temperature_C
    colder, hotter = warmer(result)
    root = _root(model.covariance)
    freedom = result.noise.freedom
    from_base = poses[:, :3, 3] - (0.0 if in_base else origins[:, :3, 3])
    of_frames = model.model.family(FRAME)
    N = len(poses)

    def student(nu: float) -> float:
        """Draw what a normal number is multiplied by if its variance was estimated."""
        if not np.isfinite(nu):
            return 1.0
        nu = max(nu, 1.0)
        return float(np.sqrt(nu / rng.chisquare(nu)))

    def trial() -> Array:
        """Draw all errors once."""
        change = student(freedom) * (root @ rng.standard_normal(root.shape[1]))
        if model.scale is not None:
            s = scale_std(model) * rng.standard_normal()
            if len(measured_at) > 1:
                span = stated.instrument_expansion * (measured_at[1] - measured_at[0])
                s += span * rng.uniform(-0.5, 0.5)
            change = change + model.scale.growth * s
        if in_base:
            change[of_frames] = 0.0
        q = samples.q + rng.uniform(-1.0, 1.0, samples.q.shape) * half_step
        q = q + rng.uniform(-1.0, 1.0, samples.q.shape) * lost
        reached = kinematics.poses(x + change, replace(samples, q=q))
        error = np.empty((N, 6))
        error[:, :3] = reached[:, :3, 3] - in_frame[:, :3, 3]
        error[:, 3:] = _turns(reached[:, :3, :3] @ in_frame[:, :3, :3].transpose(0, 2, 1))
        if in_base:
            R = to_frame.transpose(0, 2, 1)
            error[:, :3] = (R @ error[:, :3, None])[:, :, 0]
            error[:, 3:] = (R @ error[:, 3:, None])[:, :, 0]
            if model.base_motion is not None:
                motion = (model.base_motion @ change)[:, None]
                error[:, :3] -= displacements_by(motion, poses[:, :3, 3])[:, :, 0]
                error[:, 3:] -= motion[3:, 0]

        # What the covariance lacks beyond the measured poses, and stated places, by their derivatives.
        lacking = root @ rng.standard_normal(root.shape[1])
        error += np.sqrt(share)[:, None] * (twists @ lacking)
        error += families @ rng.standard_normal(families.shape[2])
        for left in places:
            error += left @ rng.standard_normal(left.shape[2])
        error[:, :3] += stated.arm_expansion * rng.uniform(colder, hotter) * from_base

        # Arrivals.
        for variances, freedoms in (
            (arrivals.repeatability, arrivals.repeatability_freedom),
            (arrivals.model, arrivals.model_freedom),
            ((arrivals.drift, 0.0), (np.inf, np.inf)),
        ):
            for k, part in enumerate((slice(0, 3), slice(3, 6))):
                if variances[k] > 0.0:
                    size = np.sqrt(variances[k]) * student(freedoms[k])
                    error[:, part] += size * rng.standard_normal((N, 3))
        return np.stack(
            [np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)]
        )

    return trial


def _root(covariance: Array) -> Array:
    """Return R with R R^T = C for a covariance C that may be singular, (p, p)."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _turns(R: Array) -> Array:
    """Return the rotation vectors of rotations by less than a quarter turn, (N, 3, 3), as (N, 3) [rad]."""
    across = np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], 1
    )
    sine = np.minimum(np.linalg.norm(across, axis=1) / 2.0, 1.0)
    ratio = np.where(sine > 0.0, np.arcsin(sine) / np.where(sine > 0.0, sine, 1.0), 1.0)
    return np.asarray(across / 2.0 * ratio[:, None])

"""The uncertainty of poses by Monte Carlo (JCGM 101): every input drawn by its distribution, through the kinematics.

A trial draws the parameters from their covariance, the scale of the instrument, families of errors, stated places,
arrivals, joints beside their readings, and temperatures, and computes the pose that the robot would reach. U is the
quantile of the distance from the predicted pose, by the probability that k = 2 stands for. Variances that were
estimated with nu degrees of freedom make Student's t: normal numbers times sqrt(nu / chi^2_nu). Errors of parameters,
of joints and of lengths go through the kinematics itself, so that what the linear law neglects is in it; unless that
hardly differs in the first trials from what the derivatives say.

Trials are made in blocks until the standard error of U, by the spread of the blocks, is small.
"""

from __future__ import annotations

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
from calib.result.row_scatter import joint_twists
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

#: Trials of a block; its quantile rests on 45 trials beyond it.
_BLOCK = 1000

#: The fewest and the most blocks.
_BLOCKS = (5, 50)

#: First trials in which the kinematics are compared with their derivatives.
_CHECKED = 100

#: The derivatives do for all trials if they differ by no more than this share of the error, rms: added in squares, that
#: changes U by an eighth of a percent.
_LINEAR = 0.05


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
    tolerance: float = 5e-3,
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
    inputs = _Inputs.of(result, model, samples, in_base=in_base)
    rng = np.random.default_rng(seed)
    least, most = _BLOCKS
    lengths: list[Array] = []
    of_blocks: list[float] = []
    error = np.inf
    is_linear = False
    while len(of_blocks) < most and (len(of_blocks) < least or error > tolerance):
        draws = inputs.draw(rng, _BLOCK)
        errors = inputs.linear(draws)
        if not of_blocks:
            exact = inputs.exact(draws, _CHECKED)
            differ = np.linalg.norm(exact[..., :3] - errors[:_CHECKED, :, :3], axis=2)
            size = rms(np.linalg.norm(errors[..., :3] + draws.others[..., :3], axis=2))
            is_linear = rms(differ) <= _LINEAR * size
        if not is_linear:
            errors = inputs.exact(draws, _BLOCK)
        errors = errors + draws.others
        block = np.stack(
            [np.linalg.norm(errors[..., :3], axis=2), np.linalg.norm(errors[..., 3:], axis=2)]
        )
        lengths.append(block)
        of_blocks.append(rms(np.quantile(block[0], PROBABILITY, axis=0)))
        if len(of_blocks) > 1:
            spread = float(np.std(of_blocks, ddof=1)) / np.sqrt(len(of_blocks))
            error = spread / max(float(np.mean(of_blocks)), np.finfo(float).tiny)
        if progress is not None:
            progress(len(of_blocks), most)
    position, orientation = np.quantile(np.concatenate(lengths, axis=1), PROBABILITY, axis=1)
    return MonteCarlo(
        position=read_only(position),
        orientation=read_only(orientation),
        linear=uncertainty_at(result, samples, non_geometric=non_geometric, in_base=in_base),
        trials=_BLOCK * len(of_blocks),
        standard_error=float(error),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Draws:
    """M trials of the errors of N poses: what goes through the kinematics, and what is added to the poses."""

    change: Array  # (M, p), of the parameters
    off: Array  # (M, N, m), of the joints from their readings [rad] or [m]
    others: Array  # (M, N, 6), displacements and turns of the poses [m], [rad]


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """All that errors of N poses are drawn from."""

    result: Calibration
    model: FittedModel
    samples: Samples
    in_base: bool
    poses: Array  # (N, 4, 4), predicted [m]
    twists: Array  # (N, 6, p), their derivatives by the parameters
    by_joints: Array  # (N, 6, m), by the joint readings
    root: Array  # (p, p), R with R R^T = C
    share: Array  # (N,), of the covariance that is lacking
    factors: tuple[Array, ...]  # (N, 6, r) each, derivatives by normal numbers common to all poses
    from_base: Array  # (N, 3) [m]

    @classmethod
    def of(
        cls, result: Calibration, model: FittedModel, samples: Samples, *, in_base: bool
    ) -> _Inputs:
        """Compute what all trials share."""
        poses, twists = model.twists(samples, in_base=in_base)
        by_joints = joint_twists(model.kinematics, model.x, samples)
        T_frame_base = model.setup.T_frame_base[samples.frame]
        if in_base:
            R = T_frame_base[:, :3, :3].transpose(0, 2, 1)
            by_joints = np.concatenate([R @ by_joints[:, :3], R @ by_joints[:, 3:]], axis=1)
        total = twists @ model.covariance @ twists.transpose(0, 2, 1)
        share, families = beyond_measured(result, model, samples, twists, total, in_base=in_base)
        places = by_stated_places(result, model, samples, poses, twists, in_base=in_base)
        return cls(
            result=result,
            model=model,
            samples=samples,
            in_base=in_base,
            poses=poses,
            twists=twists,
            by_joints=by_joints,
            root=_root(model.covariance),
            share=share,
            factors=(families, *(left for _, left in places)),
            from_base=poses[:, :3, 3] - (0.0 if in_base else T_frame_base[:, :3, 3]),
        )

    def draw(self, rng: np.random.Generator, count: int) -> _Draws:
        """Draw all errors so many times."""
        result, model, samples = self.result, self.model, self.samples
        stated, measured_at = result.stated_uncertainty, result.record.temperature_C
        p, (N, m) = len(self.root), samples.q.shape

        def students(freedom: float) -> Array:
            """Draw what normal numbers are multiplied by if their variance was estimated, (M, 1)."""
            if not np.isfinite(freedom):
                return np.ones((count, 1))
            nu = max(freedom, 1.0)
            return np.sqrt(nu / rng.chisquare(nu, (count, 1)))

        change = students(result.noise.freedom) * (rng.standard_normal((count, p)) @ self.root.T)
        if model.scale is not None:
            shares = scale_std(model) * rng.standard_normal(count)
            if len(measured_at) > 1:
                span = stated.instrument_expansion * (measured_at[1] - measured_at[0])
                shares = shares + span * rng.uniform(-0.5, 0.5, count)
            change = change + shares[:, None] * model.scale.growth
        half_step, lost = stated_joint_limits(result)
        off = half_step * rng.uniform(-1.0, 1.0, (count, N, m))
        off = off + lost * rng.uniform(-1.0, 1.0, (count, N, m))

        # What the covariance lacks beyond the measured poses, families and stated places, by their derivatives.
        lacking = rng.standard_normal((count, p)) @ self.root.T
        others = np.sqrt(self.share)[:, None] * _by(self.twists, lacking)
        for factor in self.factors:
            others = others + _by(factor, rng.standard_normal((count, factor.shape[2])))
        warmth = rng.uniform(*warmer(result), count)
        others[..., :3] += stated.arm_expansion * warmth[:, None, None] * self.from_base

        arrivals = arrivals_of(result, model)
        for variances, freedoms in (
            (arrivals.repeatability, arrivals.repeatability_freedom),
            (arrivals.model, arrivals.model_freedom),
            ((arrivals.drift, 0.0), (np.inf, np.inf)),
        ):
            for k, part in enumerate((slice(0, 3), slice(3, 6))):
                if variances[k] > 0.0:
                    size = np.sqrt(variances[k]) * students(freedoms[k])[:, :, None]
                    others[..., part] += size * rng.standard_normal((count, N, 3))
        return _Draws(change, off, others)

    def linear(self, draws: _Draws) -> Array:
        """Return what changes of parameters and joints do to the poses, by their derivatives, (M, N, 6)."""
        of_joints = np.einsum("nkj,tnj->tnk", self.by_joints, draws.off)
        return np.asarray(_by(self.twists, draws.change) + of_joints)

    def exact(self, draws: _Draws, count: int) -> Array:
        """Return the same by the kinematics itself, of the first trials, (count, N, 6)."""
        model, samples = self.model, self.samples
        in_frame = model.kinematics.poses(model.x, samples)
        R = np.eye(3)
        if self.in_base:
            R = model.setup.T_frame_base[samples.frame][:, :3, :3].transpose(0, 2, 1)
        result = np.empty((count, *self.poses.shape[:1], 6))
        for k in range(count):
            change = draws.change[k]
            if self.in_base:  # a prediction in the base does not have the errors of frames
                change = np.where(model.model.family(FRAME), 0.0, change)
            moved = replace(samples, q=samples.q + draws.off[k])
            reached = model.kinematics.poses(model.x + change, moved)
            shift = reached[:, :3, 3] - in_frame[:, :3, 3]
            turn = _turns(reached[:, :3, :3] @ in_frame[:, :3, :3].transpose(0, 2, 1))
            result[k, :, :3] = (R @ shift[:, :, None])[:, :, 0]
            result[k, :, 3:] = (R @ turn[:, :, None])[:, :, 0]
            if self.in_base and model.base_motion is not None:
                motion = (model.base_motion @ change)[:, None]
                result[k, :, :3] -= displacements_by(motion, self.poses[:, :3, 3])[:, :, 0]
                result[k, :, 3:] -= motion[3:, 0]
        return result


def _by(derivatives: Array, numbers: Array) -> Array:
    """Return derivatives (N, 6, r) times numbers (M, r), (M, N, 6)."""
    N, six, r = derivatives.shape
    return np.asarray((numbers @ derivatives.reshape(N * six, r).T).reshape(len(numbers), N, six))


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

"""Errors that the rows do not determine: what families of usual size may add to predictions over the joint limits.

A fit takes the size of a family's errors (the standard deviation tau of their prior) as the one of the highest
likelihood, and a family that is not in the model as absent. Where joints moved little, the rows say hardly anything
about some sizes: an encoder's once-per-turn error looks like a joint's zero. Each family's size is therefore also taken
as unknown. With the parameters x_k and their covariance C_k at each size tau_k of a grid, the others held, and weights
w_k by likelihood, the expected square of a predicted position is

    e^2 = sum_k w_k [ tr(J C_k J^T) + |J (x_k - x)|^2 ]

What this adds to the square that the fit itself expects, over the joint limits and beyond what it adds at the measured
poses, is summed over the families. Bayesian model averaging: J. Hoeting et al., Statistical Science 14 (1999).

At any one pose the same is the square J M J^T of the positive part of

    M = sum over families of sum_k w_k [C_k + (x_k - x) (x_k - x)^T] - C

over the parameters of the fit and those of the further families (`Undetermined`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress

import numpy as np

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.diagnosis.augmented_fit import augment, nominal_under, robot_under, thin
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.special_cases.hands_alone import hands_alone
from calib.fit.registration.setup import Setup
from calib.model.families import FAMILIES
from calib.model.kinematics import Samples
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.rigid_motion import best_motion, displacements_by, without_rigid_motion
from calib.robot.robot import Robot

#: Sizes that a family may have, over the typical one, each as likely before the rows are seen as that of the fit, where
#: it may be absent: of the sizes that were estimated for real arms, nearly all are from a quarter to twice the typical.
_SIZES = np.array([0.25, 0.5, 1.0, 2.0])

#: A family outside of the model is as good as absent with this share of the smallest of these sizes.
_ABSENT = 1e-3

#: Share of the square over the joint limits that directions may have which are left out of the covariance.
_LEFT_OUT = 1e-3

#: Effect of a parameter on positions, squared, over the largest one, below which it counts as this.
_LEAST_EFFECT = 1e-12

#: The most measured poses at which errors are averaged; more do not change them.
_MOST_MEASURED = 200


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Undetermined(Value):
    """Covariance that families add whose sizes the rows do not determine, of the fit's and of further parameters."""

    #: Name of the model with the further families
    model: str
    #: Names of its e parameters that count
    names: tuple[str, ...]
    #: Shape (p + e, r), whose product with its transpose is the covariance, the fit's own parameters first
    factor: Array
    #: Shape (6, e), motion of the base that compensates a unit of each further parameter best over the measured poses
    #: [m] and [rad]; None if the rows determine where the base stands
    base_motion: Array | None = None

    def twists(self, robot: Robot, setup: Setup, samples: Samples, *, in_base: bool) -> Array:
        """Return the derivatives of predicted poses by the further parameters.

        Args:
            robot: The nominal robot.
            setup: Frames and targets of the fit.
            samples: N samples.
            in_base: Whether poses are those in the base, less ``base_motion``; else in the measurement frame.

        Returns:
            Shape (N, 6, e), the linear part first [m, rad].
        """
        kinematics = robot_under(self.model, robot, setup)
        kept = [kinematics.model.index(name) for name in self.names]
        poses, J = kinematics.twists(np.zeros(len(kinematics.model)), samples)
        J = J[:, :, kept]
        if not in_base:
            return J
        T = rigid_inverse(setup.T_frame_base[samples.frame])
        R = T[:, :3, :3]
        J = np.concatenate([R @ J[:, :3], R @ J[:, 3:]], axis=1)
        if self.base_motion is not None:
            J[:, :3] -= displacements_by(self.base_motion, (T @ poses)[:, :3, 3])
            J[:, 3:] -= self.base_motion[3:]
        return J


def undetermined_error(
    fitted: Fitted, everywhere: Samples, *, base_moves: bool = False
) -> tuple[float, Undetermined | None]:
    """Expect the error over the joint limits that families add whose sizes the rows do not determine.

    Args:
        fitted: A fit with priors. Of families outside of its model those that depend on loads or moves are left out:
            the joint values alone say how much a measured region shows of the others. With given priors the sizes of
            the model's own families are known.
        everywhere: Joint values over the joint limits, with loads if the model needs them.
        base_moves: Whether no row determines where the base stands.

    Returns:
        The root of the square that is added to that by the covariance, rms [m], 0 without priors and without rare
        families; and the covariance that is added by all, None without priors.
    """
    estimate, task, kinematics = fitted.estimate, fitted.task, fitted.kinematics
    if not estimate.prior_std or task.cell.priors.source == "off":
        return 0.0, None
    # More rows of the same poses do not show other families: they only count for more.
    few, _ = thin(fitted)
    rows = few.estimate.problem.rows
    prior = PriorTerms.of(task, kinematics.model, fitted.setup)
    prior = prior.at_bounds({k: float(estimate.x[k]) for k in estimate.at_bound})

    # The nominal robot with the usual families that the model does not have, and that depend on joint values alone.
    # Rare ones of this kind count in the covariance alone: an unknown error of the joints, smooth over their values.
    further_names = [
        name
        for name, family in FAMILIES.items()
        if not (family.loaded or family.moved or name in kinematics.model.families)
    ]
    of_joints = [name for name in further_names if not FAMILIES[name].geometric]
    geometry = "placement" if len(of_joints) < len(further_names) else "frames"
    further = nominal_under("+".join((geometry, *of_joints)), fitted)
    zero = np.zeros(len(further.model))
    further_names = [name for name in further_names if np.any(further.model.family(name))]
    families_of = np.array([parameter.family for parameter in further.model.parameters])
    kept = further.model.of_robot & np.isin(families_of, further_names)

    # The problem at the solution, with their parameters at the end.
    columns = rows.derivative(further.linearised(zero, rows.samples))
    linear = augment(few, columns[:, :, kept])
    count = int(np.sum(kept))
    # Which parameters are of which family, (f, p).
    inside = np.pad(prior.families, ((0, 0), (0, count)))
    outside = np.zeros((len(further_names), linear.x.size), dtype=bool)
    outside[:, linear.x.size - count :] = [further.model.family(n)[kept] for n in further_names]
    families = np.vstack([inside, outside])
    own = np.pad(prior.precision, (0, count))
    mean = np.pad(prior.mean, (0, count))

    # The sizes as the fit has them, then those of each family in turn; those of the model's own are known if given.
    typical = np.array([FAMILIES[name].typical for name in (*prior.names, *further_names)])
    fit_sizes = _ABSENT * _SIZES[0] * typical
    fit_sizes[: len(prior.names)] = [estimate.prior_std[name] for name in prior.names]
    first_varied = 0 if task.cell.priors.source == "data" else len(prior.names)
    sizes = _grid_of_sizes(fit_sizes, typical, first_varied)
    varied = (*prior.names, *further_names)[first_varied:]
    precision_by_family = (1.0 / sizes**2) @ families
    priors = GaussianPriors(precision_by_family + own, mean)

    # Parameters, covariance and likelihood at each of the k sizes: one problem, k priors.
    noise = np.tile(estimate.noise, (len(sizes), 1))
    weights = few.estimate.problem.weights
    equations = linear.normal_equations(weights[None], estimate.problem.stop_shares)
    equations = equations.times(float(np.sum(estimate.problem.weights) / np.sum(weights)))
    equations = equations.of_fits(np.zeros(len(sizes), dtype=int))
    x, covariance = equations.posterior(noise, priors)
    is_flat = np.pad(
        prior.flat, (0, count)
    )  # frames and targets, whose weak priors are not counted
    counted_precision = np.where(is_flat, 0.0, priors.precision)
    likelihood = equations.log_likelihood(noise, priors, counted_precision)

    def products(samples: Samples) -> Array:
        """Return J^T J of predicted positions by all parameters, mean over samples, (p + e, p + e)."""
        points, J = kinematics.twists(estimate.x, samples, rotation=False)
        _, J_further = further.twists(zero, samples, rotation=False)
        J = np.concatenate([J, J_further[:, :, kept]], axis=2)
        moves_freely = task.cell.estimate_frame or not any(
            kind.tells_place for kind in rows.present
        )
        if moves_freely and not hands_alone(rows.present, kinematics.robot):
            J = without_rigid_motion(points[:, :3, 3], J)
        return np.asarray(np.einsum("nip,niq->pq", J, J) / len(J))

    def squares(JJ: Array) -> Array:
        """Return the expected squares of predicted positions at each of the sizes [m^2]."""
        of_covariance = np.einsum("pq,kpq->k", JJ, covariance)
        return np.asarray(of_covariance + np.einsum("kp,pq,kq->k", away, JJ, away))

    # Beyond the measured poses, what the sizes of each family in turn, and that of the fit, add by likelihood.
    measured = rows.samples.select(rows.evenly(_MOST_MEASURED))
    of_everywhere = products(everywhere)
    away = x - x[0]
    added = squares(of_everywhere) - squares(products(measured))
    total = 0.0
    M = np.zeros(covariance.shape[1:])
    for first in range(1, len(sizes), len(_SIZES)):
        of_family = [0, *range(first, first + len(_SIZES))]
        weights = np.exp(likelihood[of_family] - np.max(likelihood[of_family]))
        mean_added = float(weights @ added[of_family] / np.sum(weights))
        name = varied[(first - 1) // len(_SIZES)]
        if not FAMILIES[name].rarity or name in prior.names:
            total += max(mean_added - added[0], 0.0)
        shares = weights / np.sum(weights)
        squares_away = np.einsum("kp,kq->kpq", away[of_family], away[of_family])
        M += np.einsum("k,kpq->pq", shares, covariance[of_family] + squares_away) - covariance[0]
    names = tuple(compress(further.model.names, kept))
    base_motion = None
    if base_moves and names:
        poses, J = further.twists(zero, measured)
        T = rigid_inverse(fitted.estimated_setup().T_frame_base[measured.frame])
        linear_part = T[:, :3, :3] @ J[:, :3][:, :, kept]
        base_motion = read_only(best_motion((T @ poses)[:, :3, 3], linear_part))
    return float(np.sqrt(total)), Undetermined(
        model=further.model.name,
        names=names,
        factor=read_only(_factor_of(M, of_everywhere)),
        base_motion=base_motion,
    )


def _factor_of(M: Array, products: Array) -> Array:
    """Return the directions (n, r) of the positive part of M (n, n) that matter to positions, of J^T J = ``products``.

    Eigenvectors are of M with each parameter in units of what it does to positions, so that units do not matter.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(products), _LEAST_EFFECT * np.max(np.diag(products))))
    values, vectors = np.linalg.eigh(M / np.outer(scale, scale))
    factor = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    effects = np.einsum("pr,pq,qr->r", factor, products, factor)
    order = np.argsort(-effects)
    needed = np.cumsum(effects[order]) <= (1.0 - _LEFT_OUT) * np.sum(effects)
    return np.asarray(factor[:, order[: int(np.sum(needed)) + 1]])


def _grid_of_sizes(fit_sizes: Array, typical: Array, first_varied: int) -> Array:
    """Return the sizes (f,) of the fit, then for each family from ``first_varied`` on a row with each of `_SIZES`."""
    grid = [fit_sizes]
    for k in range(first_varied, len(typical)):
        for size in _SIZES * typical[k]:
            varied = fit_sizes.copy()
            varied[k] = size
            grid.append(varied)
    return np.array(grid)

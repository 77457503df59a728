"""Errors that the rows cannot tell: what families of errors of usual size may add to predictions over the joint limits.

A fit takes the size of a family's errors (the standard deviation tau of their prior) as the one of the highest
likelihood, and a family that is not in the model as absent. Where joints moved little, the rows say hardly anything
about some sizes: an encoder's once-per-turn error looks like a joint's zero. Each family's size is therefore also taken
as unknown. With the parameters x_k and their covariance C_k at each size tau_k of a grid, the others held, and weights
w_k by likelihood, the expected square of a predicted position is

    e^2 = sum_k w_k [ tr(J C_k J^T) + |J (x_k - x)|^2 ]

What this adds to the square that the fit itself expects, over the joint limits and beyond what it adds at the measured
poses, is summed over the families. Bayesian model averaging: J. Hoeting et al., Statistical Science 14 (1999).
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.diagnosis.augmented_fit import augment
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.registration.rows import Rows
from calib.model.error_model import ErrorModel
from calib.model.families import FAMILIES
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.rigid_motion import without_rigid_motion

#: Sizes that a family may have, over the typical one, each as likely before the rows are seen as that of the fit, where
#: it may be absent: of the sizes that were estimated for real arms, nearly all are from a quarter to twice the typical.
_SIZES = np.array([0.25, 0.5, 1.0, 2.0])

#: A family outside of the model is as good as absent with this share of the smallest of these sizes.
_ABSENT = 1e-3

#: The most measured poses at which errors are averaged; more do not change them.
_MOST_MEASURED = 200


def untold_error(fitted: Fitted, everywhere: Samples) -> float:
    """Expect the error over the joint limits that families add of which the rows do not tell the sizes.

    Args:
        fitted: A fit with priors. Of families outside of its model those that depend on loads, and rare ones, are left
            out: the joint values alone say how far a measured region tells of the others. With given priors the sizes
            of the model's own families are known.
        everywhere: Joint values over the joint limits, with loads if the model needs them.

    Returns:
        The root of the square that is added to that by the covariance, rms [m]; 0 without priors.
    """
    estimate, task = fitted.estimate, fitted.task
    if not estimate.prior_std or task.cell.priors.source == "off":
        return 0.0
    rows = estimate.problem.rows
    prior = PriorTerms.of(task, fitted.kinematics.model, fitted.setup)
    prior = prior.at_bounds({k: float(estimate.x[k]) for k in estimate.at_bound})
    names = [name for name in _families() if name not in fitted.kinematics.model.families]
    further = _further_model(fitted, names)
    chosen = [further.family(name) for name in names]
    names = [name for name, mask in zip(names, chosen, strict=True) if np.any(mask)]
    kept = further.of_robot & np.isin([p.family for p in further.parameters], names)

    linear = _augmented(fitted, further, kept)
    count = int(np.sum(kept))
    families = np.pad(prior.families, ((0, 0), (0, count)))
    outside = np.zeros((len(names), linear.x.size), dtype=bool)
    outside[:, linear.x.size - count :] = [further.family(name)[kept] for name in names]
    families = np.vstack([families, outside])
    own = np.pad(prior.precision, (0, count))
    mean = np.pad(prior.mean, (0, count))

    # The sizes as the fit has them, then each family's sizes in turn.
    typical = [FAMILIES[name].typical for name in (*prior.names, *names)]
    absent = [_ABSENT * _SIZES[0] * FAMILIES[name].typical for name in names]
    fit_sizes = np.array([*(estimate.prior_std[name] for name in prior.names), *absent])
    sizes = [fit_sizes]
    varied = (
        range(len(typical))
        if task.cell.priors.source == "data"
        else range(len(prior.names), len(typical))
    )
    for k in varied:
        for size in _SIZES * typical[k]:
            other = fit_sizes.copy()
            other[k] = size
            sizes.append(other)
    of_families = (1.0 / np.array(sizes) ** 2) @ families
    priors = GaussianPriors(of_families + own, mean)
    noise = np.tile(estimate.noise, (len(sizes), 1))
    equations = linear.normal_equations(
        estimate.problem.weights[None], estimate.problem.stop_shares
    )
    equations = equations.of_fits(np.zeros(len(sizes), dtype=int))
    x, covariance = equations.posterior(noise, priors)
    flat = np.pad(prior.flat, (0, count))
    likelihood = equations.log_likelihood(noise, priors, np.where(flat, 0.0, priors.precision))

    def squares(samples: Samples) -> Array:
        """Return the expected squares of predicted positions at each of the sizes, mean over samples [m^2]."""
        points, J = fitted.kinematics.twists(estimate.x, samples, rotation=False)
        kinematics, zero = _kinematics(fitted, further), np.zeros(len(further))
        _, J_further = kinematics.twists(zero, samples, rotation=False)
        J = np.concatenate([J, J_further[:, :, kept]], axis=2)
        if task.cell.estimate_frame or not any(kind.tells_place for kind in rows.present):
            J = without_rigid_motion(points[:, :3, 3], J)
        JJ = np.einsum("nip,niq->pq", J, J) / len(J)
        away = x - x[0]
        of_covariance = np.einsum("pq,kpq->k", JJ, covariance)
        return np.asarray(of_covariance + np.einsum("kp,pq,kq->k", away, JJ, away))

    first = rows.evenly(_MOST_MEASURED)
    added = squares(everywhere) - squares(rows.samples.select(first))
    total = 0.0
    for i in range(len(varied)):
        of_family = [0, *range(1 + i * len(_SIZES), 1 + (i + 1) * len(_SIZES))]
        weights = np.exp(likelihood[of_family] - np.max(likelihood[of_family]))
        mean_added = float(weights @ added[of_family] / np.sum(weights))
        total += max(mean_added - added[0], 0.0)
    return float(np.sqrt(total))


def _families() -> list[str]:
    """Return the names of the usual families whose errors depend on joint values alone."""
    return [name for name, family in FAMILIES.items() if not (family.loaded or family.rarity)]


def _further_model(fitted: Fitted, names: list[str]) -> ErrorModel:
    """Return a model that has the families of these names, and perhaps more; frames and targets as a fit has them."""
    joint = [name for name in names if not FAMILIES[name].geometric]
    setup = fitted.setup
    frames = dict.fromkeys(setup.frame_unknowns, ())
    geometry = "placement" if len(joint) < len(names) else "frames"
    return error_model(
        fitted.task.robot,
        "+".join((geometry, *joint)),
        frame=frames,
        target=False,
        targets=setup.target_names,
        gravity=fitted.task.cell.gravity,
    )


def _kinematics(fitted: Fitted, model: ErrorModel) -> Kinematics:
    """Return the nominal robot under a further model, with frames and targets as a fit has them."""
    setup = fitted.estimated_setup()
    return Kinematics(fitted.task.robot, model, setup.T_frame_base, setup.T_tip_target)


def _augmented(fitted: Fitted, further: ErrorModel, kept: Mask) -> LinearProblem:
    """Linearise the problem of a fit at its solution, with the kept parameters of a further model, (k,), at the end."""
    rows: Rows = fitted.estimate.problem.rows
    kinematics = _kinematics(fitted, further)
    columns = rows.derivative(kinematics.linearised(np.zeros(len(further)), rows.samples))
    return augment(fitted, columns[:, :, kept])

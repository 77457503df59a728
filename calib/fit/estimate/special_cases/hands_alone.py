"""Hands that contacts alone relate: what no contact sees is as uncertain as of a robot that nobody has measured.

The prior standard deviation tau_f of a family is estimated from the errors that the rows see. Of two arms that clasp a
part these are few: the offset of the last joints, the size of the arms and more are open, while a handful of offsets
decides tau_f, by chance often far too small. An estimate x^ made with the prior precision P has the expected square

    E (x^ - x)(x^ - x)^T  =  C + C P (S - P^-1) P C,        C = (A^T W A + P)^-1,

if errors have the variances S in place of P^-1. Here S is the square of the family's typical size wherever tau_f is
smaller. What the rows determine is as certain as before, as C P vanishes there; what they do not has the variance S.

If a length or place is measured, or if one hand alone touches what stands still, this does not matter: such directions
hardly change predictions, or are those of base and frame.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.data.kinds import Kind
from calib.robot.robot import Robot


def hands_alone(kinds: Iterable[Kind], robot: Robot) -> bool:
    """Return whether contacts between hands, and joints at their stops, are all that a robot's errors are seen by.

    Args:
        kinds: The kinds of the rows.
        robot: The robot; some chain of it leads up one arm and down another.
    """
    return all(kind.is_contact or kind.of_joint for kind in kinds) and robot.joins_hands


def missing_variance(families: Mask, prior_std: Array, typical: Array) -> Array:
    """Return by how much the prior variance of each parameter is smaller than the square of its family's typical size.

    Args:
        families: shape (K, p), which parameters belong to each family.
        prior_std: shape (K,), prior standard deviations as estimated, in the families' units.
        typical: shape (K,), typical sizes of errors, in these units.

    Returns:
        shape (p,), in the squares of the units; 0 where it is not smaller, and without a family.
    """
    by_family: Array = np.maximum(typical**2 - prior_std**2, 0.0)
    return np.asarray(by_family @ families)


def added_covariance(covariance: Array, precision: Array, missing: Array) -> Array:
    """Return C P (S - P^-1) P C: what typical errors add to the covariance of an estimate with a narrower prior.

    Args:
        covariance: C, shape (p, p).
        precision: shape (p,), the diagonal of P.
        missing: shape (p,), the diagonal of S - P^-1.
    """
    by_prior = covariance * precision
    return np.asarray((by_prior * missing) @ by_prior.T)

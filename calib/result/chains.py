"""Results of a robot of several chains by chain: errors on held-out rows, expected errors, and a verdict of its own.

A fit to all rows may be better on the whole and worse for one hand. So each chain is judged by the rows that are seen
through it, as if there were no others, and the verdict on the whole is no better than that on any chain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.diagnosis.evidence import Evidence
from calib.diagnosis.judge import judge
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.fit.registration.rows import Rows
from calib.numerics.errors import CrossValidation, Errors


@dataclass(frozen=True, slots=True, eq=False)
class ChainResult(Value):
    """Errors, expected errors and verdict of one chain."""

    #: Link of the measurement frames
    base: str
    #: Link of the targets
    tip: str
    #: Number of rows that were fitted
    rows: int
    #: Errors of the nominal robot on held-out rows, outliers aside
    nominal: Errors
    #: Those of the calibrated one
    calibrated: Errors
    #: Expected error of the calibrated robot over the joint limits, rms [m]
    expected: float
    #: That of the nominal robot [m]
    expected_of_nominal: float
    #: The verdict by the rows of this chain
    verdict: Verdict


def evidence_of_chain(
    evidence: Evidence,
    rows: Rows,
    number: int,
    moves: Mask,
    x: Array,
    expected: tuple[float, float, float],
) -> Evidence:
    """Return the evidence of the rows of one chain; doubts about the whole table are left out.

    Args:
        evidence: The evidence of all N rows.
        rows: The rows that were fitted.
        number: Number of the chain in `Robot.chains`, from 0.
        moves: Parameters of the robot that move this chain, shape (p,).
        x: The parameters, shape (p,), in their units.
        expected: Expected errors of the model over the joint limits, of the nominal robot, and the scale's part [m].

    Returns:
        The evidence; validation rows do not count.
    """
    chosen = rows.samples.rows_of_chain(number)
    part = rows.select(chosen)
    outliers = evidence.outliers[chosen]

    def of_part(validation: CrossValidation) -> CrossValidation:
        """Return the errors of a cross-validation on the rows of the chain."""
        residual = validation.residual[chosen]
        return replace(
            validation,
            poses=validation.poses[chosen],
            residual=residual,
            errors=Errors.of(residual, part.channels),
            errors_without_outliers=Errors.of(residual[~outliers], part.channels.select(~outliers)),
        )

    nothing = Errors.of(np.zeros((0, rows.width)), rows.channels.select(chosen[:0]))
    of_model, of_nominal, by_scale = expected
    return replace(
        evidence,
        nominal=of_part(evidence.nominal),
        calibrated=of_part(evidence.calibrated),
        scales=evidence.scales[chosen],
        used=evidence.used[chosen],
        floor=evidence.floor[chosen],
        repeats=_renumbered(evidence.repeats[chosen]),
        pairs=evidence.pairs[chosen],
        outliers=outliers,
        validation=replace(
            evidence.validation, before=nothing, after=nothing, whole=nothing, aside=0
        ),
        parameters=int(np.sum(moves)),
        full_model_parameters=min(evidence.full_model_parameters, int(np.sum(moves))),
        changes=bool(np.any(x[moves])),
        expected=of_model,
        expected_of_nominal=of_nominal,
        by_scale=by_scale,
        doubts=(),
        notes=(),
        images=None if evidence.images is None else evidence.images[chosen],
        non_geometric=None,
    )


def _renumbered(labels: Integers) -> Integers:
    """Return labels as numbers from 0, shape (N,)."""
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def result_of_chain(base: str, tip: str, evidence: Evidence) -> ChainResult:
    """Return the result of a chain between two links by its evidence."""
    return ChainResult(
        base=base,
        tip=tip,
        rows=len(evidence.outliers),
        nominal=evidence.before,
        calibrated=evidence.after,
        expected=evidence.expected,
        expected_of_nominal=evidence.expected_of_nominal,
        verdict=judge(evidence),
    )


def verdict_with_chains(whole: Verdict, chains: tuple[ChainResult, ...]) -> Verdict:
    """Return the verdict on the whole, no better than that on any chain.

    Args:
        whole: The verdict by all rows.
        chains: The results of the chains.
    """
    against = [chain for chain in chains if chain.verdict.use == NO]
    care = [chain for chain in chains if chain.verdict.use == CARE]
    if against and whole.use != NO:
        reasons = [_reason(Why.CHAIN_AGAINST, chain) for chain in against]
        return Verdict(NO, (*reasons, *whole.reasons))
    if care and whole.use == USE:
        reasons = [_reason(Why.CHAIN_CARE, chain) for chain in care]
        return Verdict(CARE, (*reasons, *whole.reasons))
    return whole


def _reason(why: Why, chain: ChainResult) -> Reason:
    """Return a reason about a chain, with both robots' errors on its held-out rows."""
    return Reason.of(
        why, base=chain.base, tip=chain.tip, before=chain.nominal, after=chain.calibrated
    )

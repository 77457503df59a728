"""The search among models for the one of the highest evidence, each fitted once with the weights of one reference fit.

From a model the search moves to neighbours: one family less or more, another geometry, or one family for another. The
geometry for the URDF is the candidate of the highest evidence, unless errors on held-out poses contradict: by a paired
test, whether another one predicts them better beyond chance.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import stdtr

from calib.basics.arrays import Array, Mask
from calib.basics.progress import trying
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import (
    CLEARLY,
    Candidate,
    assess,
    held_out_rms,
    is_vanished,
    model_name,
)
from calib.numerics.errors import CrossValidation

#: Strong evidence: odds of 20 to 1, in log-likelihood.
_STRONG = float(np.log(20.0))

#: Held-out errors contradict the evidence if the p-value of their improvement is below this.
_P_VALUE = 0.1

#: The same against strong evidence.
_P_VALUE_IF_STRONG = 0.01

#: With fewer poses evidence alone decides: held-out errors of non-geometric models are too small, because prior
#: standard deviations are estimated from all poses.
_FEWEST_POSES = 16


def preferred_geometry(candidates: Sequence[Candidate], errors: Sequence[Array]) -> str:
    """Return the name of the candidate with the highest evidence that held-out poses do not contradict.

    They do if the mean error of another one is smaller by the share `CLEARLY`, and that beyond chance: by the p-value
    of the improvement over the poses, which has to be smaller if there is strong evidence against the other one. With
    few poses (`_FEWEST_POSES`) the evidence decides alone.

    Args:
        candidates: One or more models of the same rows.
        errors: Of each candidate the held-out error of each pose, in standard deviations, shape (poses,), see
            `pose_errors`.
    """

    def contradicts(other: int, best: int) -> bool:
        """True if held-out poses prefer another candidate, by index, to the best so far, clearly and beyond chance."""
        if not np.mean(errors[other]) < (1.0 - CLEARLY) * np.mean(errors[best]):
            return False
        strong = candidates[best].evidence - candidates[other].evidence > _STRONG
        limit = _P_VALUE_IF_STRONG if strong else _P_VALUE
        return p_value_of_improvement(errors[best] - errors[other]) < limit

    best = max(range(len(candidates)), key=lambda k: candidates[k].evidence)
    while len(errors[best]) >= _FEWEST_POSES:
        better = [k for k in range(len(candidates)) if contradicts(k, best)]
        if not better:
            break
        best = min(better, key=lambda k: float(np.mean(errors[k])))
    return candidates[best].name


def pose_errors(validation: CrossValidation, scales: Array, kept: Mask) -> Array:
    """Return the held-out error of each pose: root mean square over its rows of |residual / scale|.

    Rows that cross-validation held out together (`CrossValidation.poses`) count as one pose.

    Args:
        validation: Held-out residuals of N rows.
        scales: Standard deviation of each scalar, shape (N, D), in the units of the rows' channels.
        kept: True for the rows that count, shape (N,).

    Returns:
        Errors in standard deviations, shape (poses,), in the order of the poses' numbers; poses of which no row counts
        are left out.
    """
    whitened = validation.residual / scales
    squares = np.sum(whitened[kept] ** 2, axis=1)
    _, pose = np.unique(validation.poses[kept], return_inverse=True)
    return np.sqrt(np.bincount(pose, squares) / np.bincount(pose))


def p_value_of_improvement(improvements: Array) -> float:
    """Return the p-value of a mean improvement over poses: Student's paired t-test, one-sided.

    Args:
        improvements: Error of each pose by the first model minus that by the second, shape (poses,), in any unit;
            above 0 where the second is better.

    Returns:
        Probability of so large a mean, or a larger one, if neither model is better; 1 for fewer than two poses. If all
        improvements are equal, 0 if they are above 0, else 1.
    """
    count = len(improvements)
    if count < 2:
        return 1.0
    mean = float(np.mean(improvements))
    std = float(np.std(improvements, ddof=1))
    if not std > 0.0:
        return float(mean <= 0.0)
    t = mean / std * np.sqrt(count)
    return float(stdtr(count - 1, -t))


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A search among models of the same rows."""

    #: The fit whose model is chosen
    task: Task
    #: Rows by which it is chosen
    rows: Rows
    #: Fit whose weights of the rows are used for all candidates
    reference: Fitted
    #: Geometries to choose from, from the smallest to the largest
    geometries: tuple[str, ...]
    #: Families to choose from, in their order in names
    families: tuple[str, ...]
    #: All that were fitted, in order, by name
    tried: dict[str, Candidate] = field(default_factory=dict)
    #: The fit of the highest evidence so far, if there is one: its neighbours begin there
    _nearest: list[Fitted] = field(default_factory=list)

    def highest_evidence(self, start: str) -> str:
        """Return the name of a model that no neighbour and no geometry exceeds in evidence.

        Neighbours have one family more, less or exchanged, or another geometry. Models are fitted as they are needed.

        Args:
            start: Name of the model to begin with.
        """
        best = self._climb(start)
        geometry = max(self.geometries, key=self.evidence)
        if self.evidence(best) >= self.evidence(geometry):
            return best
        return self._climb(geometry)

    def best_geometry(self) -> str:
        """Return the name of the geometry for the URDF, of those for which the rows are enough: `preferred_geometry`.

        Without priors the evidence already is that of held-out errors, and decides alone.
        """
        fitted = [self.tried[name] for name in self.geometries if self._is_fitted(name)]
        if self.task.cell.priors.source == "off":
            return max(fitted, key=lambda c: c.evidence).name
        estimate = self.reference.estimate
        scales = estimate.problem.scales
        kept = estimate.weights > 0.0
        errors = [pose_errors(c.cross_validation, scales, kept) for c in fitted]
        return preferred_geometry(fitted, errors)

    def best_non_geometric(self, highest: str, geometry: str) -> str:
        """Return the model of the highest evidence that predicts held-out rows better than the geometry.

        Args:
            highest: Name of the model of the highest evidence; without priors it is the best one.
            geometry: Name of the chosen geometry.

        Returns:
            A model's name; the geometry's if ``highest`` has no families, or no model with families predicts better
            and has more evidence.
        """
        if "+" not in highest:
            return geometry
        if self.task.cell.priors.source == "off":
            return highest
        best = self.tried[geometry]
        limit = held_out_rms(best.cross_validation)
        for candidate in self.tried.values():
            closer = held_out_rms(candidate.cross_validation) < limit
            if "+" in candidate.name and closer and candidate.evidence > best.evidence:
                best = candidate
        return best.name

    def evidence(self, name: str) -> float:
        """Return the evidence of a model; minus infinity if the rows are too few for its parameters."""
        return self.tried[name].evidence if self._is_fitted(name) else -np.inf

    def _climb(self, start: str) -> str:
        """Return the name of the model reached by moving to the neighbour of the highest evidence while that is higher.

        Exchanges of one family for another are tried only where no other neighbour has more evidence.
        """
        best = start
        while True:
            geometry, *families = best.split("+")
            toggled = [self._name(geometry, {*families} ^ {family}) for family in self.families]
            others = [self._name(other, families) for other in self.geometries if other != geometry]
            neighbour = max((best, *toggled, *others), key=self.evidence)
            if neighbour == best:
                neighbour = max((best, *self._swaps(best)), key=self.evidence)
            if neighbour == best:
                return best
            best = neighbour

    def _swaps(self, name: str) -> list[str]:
        """List the names of the models that have one of a model's families replaced by another.

        The likelihood is maximised over the prior standard deviations, so a family that vanishes beside all of those
        of the model cannot replace one.
        """
        geometry, *families = name.split("+")
        swaps = []
        for new in self.families:
            if new in families:
                continue
            with_new = {*families, new}
            beside = self._name(geometry, with_new)
            if not self._is_fitted(beside) or is_vanished(new, self.tried[beside].prior_std):
                continue
            swaps += [self._name(geometry, with_new - {old}) for old in families]
        return swaps

    def _name(self, geometry: str, families: Iterable[str]) -> str:
        """Return the name of a geometry with families, in the order of `families` of the search."""
        chosen = set(families)
        ordered = tuple(family for family in self.families if family in chosen)
        return model_name(geometry, ordered)

    def _is_fitted(self, name: str) -> bool:
        """Fit a model unless it was tried before; False if the rows are too few for it."""
        if name in self.tried:
            return True
        task = replace(self.task, model=name)
        trying(name)
        try:
            fitted = fit(
                task,
                self.rows,
                reference=self.reference,
                near=(*self._nearest, self.reference),
                only_compared=True,
            )
        except MeasurementError:
            return False
        best = max((c.evidence for c in self.tried.values()), default=-np.inf)
        self.tried[name] = assess(fitted)
        if self.tried[name].evidence > best:
            self._nearest[:] = [fitted]
        return True

"""The search among models for the one of the highest evidence, each fitted once with the weights of one reference fit.

From a model the search moves to neighbours: one family less or more, another geometry, or one family for another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import Candidate, assess, held_out_rms, is_vanished
from calib.fit.selection.geometry_choice import pose_errors, preferred_geometry
from calib.fit.selection.ladder import model_name


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

    def highest_evidence(self, start: str) -> str:
        """Return the name of a model that no neighbour and no geometry exceeds in evidence.

        Args:
            start: Name of the model to begin with.
        """
        best = self._climb(start)
        geometry = max(self.geometries, key=self.evidence)
        if self.evidence(best) >= self.evidence(geometry):
            return best
        return self._climb(geometry)

    def best_geometry(self) -> str:
        """Return the name of the geometry for the URDF, see `preferred_geometry`.

        Without priors the evidence already is that of held-out errors, and decides alone.
        """
        fitted = [self.tried[name] for name in self.geometries if self._is_fitted(name)]
        if self.task.cell.priors.source == "off":
            return max(fitted, key=lambda c: c.evidence).name
        estimate = self.reference.estimate
        scales = estimate.problem.scales
        kept = self.rows.checked & (estimate.weights > 0.0)
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
        """Return the model reached from a start by moving to the best neighbour as long as that has more evidence."""
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
        """List the models with one family in place of another.

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
        try:
            fitted = fit(task, self.rows, reference=self.reference)
        except MeasurementError:
            return False
        self.tried[name] = assess(fitted)
        return True

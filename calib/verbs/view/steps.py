"""The steps of a page of robots: each a row of a table, or of images all corners of one board in one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.data.measurements import Measurements
from calib.fit.registration.labels import same_poses
from calib.verbs.evaluate.evaluation import Evaluation

#: Rows that are shown at most: the page stays quick.
MOST_ROWS = 400

#: Of `MOST_ROWS`, rows kept free for flagged ones.
_FLAGGED_ROWS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The N steps of a page."""

    #: One row of each step
    m: Measurements
    #: Indices of the rows of each step in the table, from 0
    rows: tuple[Integers, ...]
    #: Name of each step, such as ``"row 31"`` or that of an image
    labels: tuple[str, ...]
    #: shape (N,), steps with a flagged row
    flagged: Mask
    #: shape (2, N), errors of two robots by the unit that they are in, of an image rms; NaN where a step has none
    errors: dict[str, Array]
    #: Index of the step that is shown first, from 0
    start: int

    @property
    def of_images(self) -> bool:
        """True if each step is an image."""
        return bool(np.any(self.m.where(lambda kind: kind.optical)))

    @property
    def shown(self) -> Integers:
        """The ascending indices of the steps that are shown: the first one, flagged ones, and an even choice."""
        count = len(self.flagged)
        if count <= MOST_ROWS:
            return np.arange(count)
        evenly = np.linspace(0, count - 1, MOST_ROWS - _FLAGGED_ROWS).round().astype(int)
        first_flagged = np.flatnonzero(self.flagged)[: _FLAGGED_ROWS - 1]
        return np.unique([self.start, *first_flagged, *evenly])

    @property
    def kinds(self) -> tuple[str, ...]:
        """``"estimation"``, ``"validation"`` or ``"flagged"`` of each step."""
        kinds = np.where(self.m.validation, "validation", "estimation")
        kinds = np.where(self.flagged, "flagged", kinds)
        return tuple(kinds.tolist())


def steps_of(first: Evaluation, last: Evaluation, flagged: Mask) -> Steps:
    """Return the steps of a table: its images where all rows are corners in images, else its rows.

    Args:
        first: The first robot's residuals.
        last: The second robot's of the same rows, or again the first's.
        flagged: shape (M,), the flagged rows.
    """
    m = first.measurements
    rows = _rows_of_steps(m)
    begins = np.zeros(len(m), dtype=bool)
    begins[[int(of_step[0]) for of_step in rows]] = True
    one_each = m.select(begins)
    flagged_steps = np.array([bool(np.any(flagged[of_step])) for of_step in rows])
    errors = _errors_by_unit(first, last, rows)
    leading = next(iter(errors.values()), np.full((2, len(rows)), np.nan))
    return Steps(
        m=one_each,
        rows=rows,
        labels=_labels(m, rows),
        flagged=flagged_steps,
        errors=errors,
        start=typical_step(leading, one_each.estimation & ~flagged_steps),
    )


def _rows_of_steps(m: Measurements) -> tuple[Integers, ...]:
    """Return the indices of the rows of each step, in the order of the first of them."""
    if not len(m) or not np.all(m.where(lambda kind: kind.optical)):
        return tuple(np.arange(len(m))[:, None])
    pose = same_poses(m.joints)
    names = zip(m.images, pose.tolist(), m.groups, m.targets, strict=True)
    views: dict[tuple[str, int, str, str], list[int]] = {}
    for row, (image, number, group, target) in enumerate(names):
        views.setdefault((image, number, group, target), []).append(row)
    return tuple(np.array(of_view) for of_view in views.values())


def _labels(m: Measurements, rows: Sequence[Integers]) -> tuple[str, ...]:
    """Return the names of steps: ``row 31``, by their number in the table, or the name of the image."""
    labels = []
    for of_step in rows:
        first = int(of_step[0])
        image = m.images[first] if m.where(lambda kind: kind.optical)[first] else ""
        labels.append(image or f"row {m.rows[first]}")
    return tuple(labels)


def _errors_by_unit(
    first: Evaluation, last: Evaluation, rows: Sequence[Integers]
) -> dict[str, Array]:
    """Return the errors of two robots at N steps, shape (2, N), rms over the rows of each, by unit; NaN for none.

    Args:
        first: The first robot's residuals.
        last: The second robot's of the same rows, or again the first's.
        rows: Indices of the rows of each step, from 0.
    """
    errors = {}
    for unit in first.channels.present:
        norms = np.array([e.channels.norms(e.residual, unit) for e in (first, last)])
        of_steps = [np.sqrt(np.mean(norms[:, of_step] ** 2, axis=1)) for of_step in rows]
        errors[unit] = np.reshape(of_steps, (-1, 2)).T
    return errors


def typical_step(errors: Array, fitted: Mask) -> int:
    """Return the index of the step that is shown first: the one whose errors, of both robots, are nearest the median.

    Of each robot's errors the steps have ranks; the larger of a step's two distances from the middle rank is least.

    Args:
        errors: shape (2, N), in one unit; NaN where none was measured.
        fitted: shape (N,), the steps to choose from, if any has an error: fitted, and not flagged.

    Returns:
        The index, from 0; of equal ones the first. 0 where no step has an error.
    """
    is_known = np.all(np.isfinite(errors), axis=0)
    steps = np.flatnonzero(is_known & fitted)
    if not len(steps):
        steps = np.flatnonzero(is_known)
    if not len(steps):
        return 0
    ranks = errors[:, steps].argsort(axis=1).argsort(axis=1)
    from_middle = np.abs(ranks - 0.5 * (len(steps) - 1)).max(axis=0)
    return int(steps[from_middle.argmin()])

"""The path of a measurement frame over the rows of a table: steps and a drift, from targets that stand still.

A target that stands still at p is read at places t of the table as

    y = p + sum over changes of  f(t) (v + w x (p - c))  + n,        n ~ N(0, s^2)

where f is t / T of a drift and 1 from some place on of a step, v its displacement and w its rotation about the centre
c. The same changes displace what is measured of the robot. Changes are found one by one: of all that are possible the
one with the largest likelihood in readings and poses together, by Schwarz's criterion, is kept if chance is excluded.

Each source has its own unknown noise, so that its F test is exact. Of two sources they are combined by Fisher's method,

    -2 (ln p_1 + ln p_2) ~ chi^2(4)

and the readings must show the change by themselves too: residuals of poses alone may be the robot's. P-values are
multiplied by the number of changes tried (Bonferroni), so that a table without any gives one with at most `LEVEL`. A
third of that is for drifts of the frame, a third for its steps, and a third for all else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import ReadOnlyMapping, Value

#: The probability that a table without changes gives any.
LEVEL = 0.02

#: The readings alone must show a change with a p-value below this.
_SHOWN = 0.05

#: The most changes of one table.
_MOST = 8

#: A column of which less than this share of the norm is not among the others is no column of its own.
_CUT = 1e-6

#: Places of a step whose probabilities sum up to this are its interval.
INTERVAL = 0.95


class Form(str, Enum):
    """Form of a change, as a function of the place."""

    #: Even, from the first row to the last
    DRIFT = "drift"
    #: Nothing before a place, all from it on
    STEP = "step"
    #: One reading alone
    READING = "reading"


@dataclass(frozen=True, slots=True)
class Change:
    """A possible change."""

    form: Form
    #: The first place of a step, the number of a reading; 0 of a drift
    place: int
    #: What moves
    mover: str
    #: Whether it rotates too
    rigid: bool = False
    #: Whether it is one of the changes that are expected: a translation of the frame
    usual: bool = False

    @property
    def kind(self) -> tuple[Form, str, bool]:
        """The key that changes share if they differ in the place alone."""
        return self.form, self.mover, self.rigid

    @property
    def family(self) -> tuple[Form, bool]:
        """The changes that share a part of the probability of false alarms."""
        return (self.form, True) if self.usual else (Form.READING, False)

    @property
    def unknowns(self) -> int:
        """The number of its unknowns: a displacement, and a rotation."""
        return 6 if self.rigid else 3

    def share(self, places: Array, span: int) -> Array:
        """Return the share of a drift or of a step at places, in the shape of these; ``span`` is the last place."""
        if self.form is Form.DRIFT:
            return np.asarray(places / max(span, 1))
        return np.asarray(1.0 * (places >= self.place))


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """M scalars of one source, with one unknown noise."""

    #: Shape (M, b), orthonormal basis of the regressors that are there without changes
    base: Array
    #: Shape (M,), the scalars, of any unit
    residual: Array
    #: Shape (M,), the place of each scalar
    places: Array
    #: Shape (M, 6), their derivatives by a displacement [m] and by a rotation [rad] of what is measured
    directions: Array
    #: Shape (M,) by the name of what moves: which scalars it displaces; none if it is missing
    moved: Mapping[str, Mask]
    #: Shape (M,), the reading of each scalar; -1 of poses
    readings: Integers
    #: The last place of the table
    span: int

    def columns(self, change: Change) -> Array:
        """Return the derivatives of the scalars by the unknowns of a change, shape (M, 3) or (M, 6)."""
        if change.form is Form.READING:
            share = 1.0 * (self.readings == change.place)
        else:
            moved = self.moved.get(change.mover, np.zeros(len(self.places), dtype=np.bool_))
            share = change.share(self.places, self.span) * moved
        return np.asarray(share[:, None] * self.directions[:, : change.unknowns])

    def beyond(self, changes: Iterable[Change]) -> Evidence:
        """Return the evidence with the regressors of changes in its base."""
        base = self.base
        for change in changes:
            _, basis = _new_directions(base, self.columns(change))
            base = np.hstack([base, basis])
        return replace(self, base=base)

    @property
    def remaining(self) -> Array:
        """The part of the scalars that no regressor explains, shape (M,)."""
        return np.asarray(self.residual - self.base @ (self.base.T @ self.residual))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the noise."""
        return len(self.residual) - int(self.base.shape[1])

    @property
    def noise(self) -> float:
        """Standard deviation of a scalar by what remains; NaN without degrees of freedom."""
        square = float(np.sum(self.remaining**2))
        return float(np.sqrt(square / self.freedom)) if self.freedom > 0 else np.nan


@dataclass(frozen=True, slots=True, eq=False)
class Path(Value):
    """The changes of a frame that were found, with their estimates."""

    #: The changes
    changes: tuple[Change, ...] = ()
    #: P-value of each, times the number of changes tried
    p: tuple[float, ...] = ()
    #: Shape (u,), their displacements [m] and rotations [rad], one after the other
    unknowns: Array = field(default_factory=lambda: np.zeros(0))
    #: Shape (u, u), their covariance
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: Probabilities of the places of each change that is a step, by place
    places: tuple[Mapping[int, float], ...] = ()
    #: Scatter of a coordinate of a reading [m], and its degrees of freedom
    scatter: float = np.nan
    freedom: int = 0

    def slices(self) -> tuple[slice, ...]:
        """Return where the unknowns of each change are."""
        ends = np.cumsum([change.unknowns for change in self.changes]).tolist()
        return tuple(
            slice(end - change.unknowns, end)
            for change, end in zip(self.changes, ends, strict=True)
        )

    def shares(self, k: int, places: Array, span: int) -> Array:
        """Return the expected share of a change at places, a step's averaged over its possible places.

        Args:
            k: The number of the change, from 0; no single reading.
            places: Places, shape (N,).
            span: The last place of the table.
        """
        change = self.changes[k]
        if change.form is not Form.STEP:
            return change.share(places, span)
        first = np.array(list(self.places[k]))
        probabilities = np.array(list(self.places[k].values()))
        return np.asarray((places[:, None] >= first) @ probabilities)


def find_path(
    readings: Evidence, poses: Evidence | None, possible: Sequence[Change], level: float = LEVEL
) -> Path:
    """Find the changes of a frame.

    Args:
        readings: Those of targets that stand still.
        poses: Residuals of a fit to what was measured of the robot, over their noise, with the fit's regressors; None:
            there are none yet.
        possible: All changes that are looked for.
        level: The probability that a table without changes gives any.

    Returns:
        The changes, in the order of their places, with their estimates.
    """
    sources = (readings,) if poses is None else (readings, poses)
    found: list[Change] = []
    while len(found) < _MOST:
        new = _most_likely(sources, possible, found, level)
        if new is None:
            break
        found.append(new)
        found = _settled(sources, possible, found, level)
        if new not in found and new.kind not in {one.kind for one in found}:
            break
    found.sort(key=lambda change: (change.form is not Form.DRIFT, change.place))
    p = []
    for change in found:
        others = [one for one in found if one is not change]
        p.append(_p_value(_beyond(sources, others), change, possible))
    return _estimated(sources, possible, found, p)


def _beyond(sources: Sequence[Evidence], changes: Iterable[Change]) -> tuple[Evidence, ...]:
    """Return sources of evidence with the regressors of changes."""
    listed = list(changes)
    return tuple(source.beyond(listed) for source in sources)


def _most_likely(
    sources: Sequence[Evidence],
    possible: Sequence[Change],
    found: Sequence[Change],
    level: float,
) -> Change | None:
    """Return the most likely of the possible changes beside those found of which chance is excluded; None: none is."""
    beyond = _beyond(sources, found)
    # Of changes that differ in the place alone each is as likely.
    alike = Counter(change.kind for change in possible)
    gains = {
        change: _gain(beyond, change) - float(np.log(alike[change.kind]))
        for change in possible
        if change not in found
    }
    for change in sorted(gains, key=lambda one: -gains[one]):
        if not gains[change] > 0.0:
            break
        if _p_value(beyond, change, possible) < level:
            return change
    return None


def _settled(
    sources: Sequence[Evidence],
    possible: Sequence[Change],
    found: Sequence[Change],
    level: float,
) -> list[Change]:
    """Return changes with each step at its likeliest place beside the others, without those that may be chance."""
    settled = list(found)
    for change in found:
        others = [one for one in settled if one is not change]
        beyond = _beyond(sources, others)
        places = [one for one in possible if one.kind == change.kind and one not in others]
        best = max(places, key=lambda one: _gain(beyond, one))
        is_sure = _p_value(beyond, best, possible) < level
        settled = [*others, best] if is_sure else others
    return settled


def _new_directions(base: Array, Z: Array) -> tuple[Array, Array]:
    """Return what of columns (M, c) is beyond an orthonormal base, (M, c), and an orthonormal basis of it."""
    size = np.linalg.norm(Z, axis=0)
    scaled = Z / np.where(size > 0.0, size, 1.0)
    left = scaled - base @ (base.T @ scaled)
    left -= base @ (base.T @ left)
    vectors, values, _ = np.linalg.svd(left, full_matrices=False)
    return left * size, np.asarray(vectors[:, values > _CUT])


class _Effect(NamedTuple):
    """Fit of a change to the scalars of one source."""

    #: Its columns beyond the regressors, shape (M, c)
    columns: Array
    #: The sum of squares that it explains, by so many independent columns; and what is left, of so much freedom
    square: float
    independent: int
    left: float
    freedom: int

    @property
    def variance(self) -> float:
        """Variance of a scalar with the change."""
        return max(self.left / self.freedom, np.finfo(float).tiny)


def _effect(source: Evidence, change: Change) -> _Effect | None:
    """Return what a change explains of a source; None if that tells nothing of it."""
    Z = source.columns(change)
    if not Z.any():
        return None
    left, basis = _new_directions(source.base, Z)
    remaining = source.remaining
    square = float(np.sum((basis.T @ remaining) ** 2))
    independent = basis.shape[1]
    freedom = source.freedom - independent
    if not independent or freedom < 1:
        return None
    unexplained = max(float(remaining @ remaining) - square, 0.0)
    return _Effect(left, square, independent, unexplained, freedom)


def _gain(sources: Sequence[Evidence], change: Change) -> float:
    """Return by how much a change, of one size in all sources, raises the log-likelihood, less Schwarz's penalty."""
    H, g = np.zeros((change.unknowns, change.unknowns)), np.zeros(change.unknowns)
    count = 0
    for source in sources:
        effect = _effect(source, change)
        if effect is not None:
            H += effect.columns.T @ effect.columns / effect.variance
            g += effect.columns.T @ source.remaining / effect.variance
            count += len(source.residual)
    if not H.any():
        return 0.0
    theta, *_ = np.linalg.lstsq(H, g, rcond=_CUT)
    return float(0.5 * g @ theta - 0.5 * change.unknowns * np.log(count))


def _p_value(sources: Sequence[Evidence], change: Change, possible: Sequence[Change]) -> float:
    """Return the p-value of a change, times the number of possible ones of its family and that of families.

    Half of the probability of a false alarm is spent on the readings alone, which tell steps between the same two of
    them apart no more than once, half on readings and poses together.
    """
    p = []
    for source in sources:
        effect = _effect(source, change)
        if effect is None:
            p.append(1.0)
        else:
            F = effect.square / effect.independent / effect.variance
            p.append(float(fdtrc(effect.independent, effect.freedom, F)))
    by_readings = p[0]
    family = [one for one in possible if one.family == change.family]
    families = len({one.family for one in possible})
    different = families * len(_tellable(sources[0], family))
    if len(p) == 1:
        return min(by_readings * different, 1.0)
    together = 1.0
    if by_readings < _SHOWN and p[1] < 1.0:
        logs = np.log(np.maximum(p, np.finfo(float).tiny))
        together = float(chdtrc(4.0, -2.0 * np.sum(logs)))
    return min(2.0 * by_readings * different, 2.0 * together * families * len(family), 1.0)


def _tellable(readings: Evidence, possible: Sequence[Change]) -> set[tuple[object, ...]]:
    """Return what of the possible changes the readings tell apart: steps between the same two of them are one."""
    return {
        (
            change.form,
            change.mover,
            change.rigid,
            int(np.sum(readings.places < change.place))
            if change.form is Form.STEP
            else change.place,
        )
        for change in possible
    }


def _estimated(
    sources: Sequence[Evidence],
    possible: Sequence[Change],
    found: Sequence[Change],
    p: Sequence[float],
) -> Path:
    """Estimate the unknowns of all changes together, and the probabilities of the places of steps."""
    after = _beyond(sources, found)
    scatter, freedom = after[0].noise, after[0].freedom
    if not found:
        return Path(scatter=scatter, freedom=freedom)
    count = sum(change.unknowns for change in found)
    H, g = np.zeros((count, count)), np.zeros(count)
    for source, settled in zip(sources, after, strict=True):
        if settled.freedom < 1:
            continue
        Z = np.hstack([source.columns(change) for change in found])
        left, _ = _new_directions(source.base, Z)
        variance = max(settled.noise**2, np.finfo(float).tiny)
        H += left.T @ left / variance
        g += left.T @ source.remaining / variance
    covariance: Array = np.asarray(np.linalg.pinv(H, rcond=_CUT**2, hermitian=True), np.float64)
    places = []
    for change in found:
        probabilities: Mapping[int, float] = ReadOnlyMapping({})
        if change.form is Form.STEP:
            beyond = _beyond(sources, [one for one in found if one is not change])
            probabilities = _probable_places(beyond, change, possible)
        places.append(probabilities)
    return Path(
        changes=tuple(found),
        p=tuple(p),
        unknowns=covariance @ g,
        covariance=covariance,
        places=tuple(places),
        scatter=scatter,
        freedom=freedom,
    )


def _probable_places(
    sources: Sequence[Evidence], step: Change, possible: Sequence[Change]
) -> Mapping[int, float]:
    """Return the probabilities of the places of a step, by place; each is as likely before any measurement."""
    alike = [one for one in possible if one.kind == step.kind]
    gains = np.array([_gain(sources, one) for one in alike])
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    return ReadOnlyMapping(
        {one.place: float(w) for one, w in zip(alike, weights, strict=True) if w > 1e-6}
    )


def interval_of_places(
    places: Mapping[int, float], share: float = INTERVAL
) -> tuple[int, int, int]:
    """Return the median of the places of a step, and the first and last of an interval of them.

    Args:
        places: Probabilities by place, ascending.
        share: Probability of the interval, as much outside on either side.

    Returns:
        Median, first, last.
    """
    listed = np.array(list(places))
    below = np.cumsum(list(places.values()))
    tail = 0.5 * (1.0 - share)

    def quantile(p: float) -> int:
        """Return the place below which a probability is."""
        return int(listed[min(int(np.searchsorted(below, p)), len(listed) - 1)])

    return quantile(0.5), quantile(tail), quantile(1.0 - tail)

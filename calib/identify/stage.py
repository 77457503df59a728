"""One stage of an estimation: noise, prior sizes and weights, and the linearised problem that they are found on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.families import FAMILIES
from calib.identify.problem import Linear, Problem
from calib.identify.robust import (
    Limits,
    cauchy_weights,
    median_noise,
    repeats,
)
from calib.identify.variance import (
    Known,
    Masks,
    Sizes,
    precision_of,
    sizes_by_reml,
)
from calib.measure.cell import Priors
from calib.model.parameters import (
    FRAME,
    TARGET,
    ErrorModel,
)

Array = NDArray[np.float64]

#: The noise may be ten times larger or smaller than the one given or assumed, a standard deviation of its logarithm.
NOISE_SPREAD = float(np.log(10.0))

#: With fewer degrees of freedom no row can be told from the others, and all keep their weight.
FEWEST_FREEDOM = 6.0

#: Without priors this holds what no measurement determines: far wider than an arm's errors [m and rad].
_LEASH = 1.0

#: Target and frame stay within this of where registration put them, unless the data say otherwise: far more than
#: registration is off by, and a hold where nothing tells them from each other [m and rad].
_PLACED = 1.0

#: How tightly a parameter is held at its bound, in its unit.
_FIXED = 1e-10

#: Weights that change by less have settled, and noise and sizes that change by less of themselves.
SETTLED, SETTLED_SIZES = 0.02, 0.01

#: Repeats must leave this many degrees of freedom before their scatter is believed.
_TELLING_REPEATS = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Holds:
    """What holds parameters besides the measurements: families with a size each, and single priors.

    Attributes:
        names: The families' names.
        families: For each which parameters belong to it, shape (p,).
        start: The sizes to begin with.
        precision: shape (p,), of parameters with a prior of their own, and of frames and targets.
        flat: shape (p,), frames and targets without a prior of their own: what holds them is none.
        adapts: Whether the sizes are found from the data.
        off: Whether there are no priors but the leash.
        fixed: Parameters that stand at a bound, and their values.
        means: Means of single priors that are not 0, by number: of a target whose change counts from where it was said
            to be, not from where it was registered.
    """

    names: tuple[str, ...]
    families: Masks
    start: tuple[float, ...]
    precision: Array
    flat: NDArray[np.bool_]
    adapts: bool
    off: bool
    fixed: tuple[tuple[int, float], ...] = ()
    means: tuple[tuple[int, float], ...] = ()

    @classmethod
    def of(
        cls,
        model: ErrorModel,
        priors: Priors,
        single: Mapping[str, float] | None = None,
        nominal: Array | None = None,
    ) -> Holds:
        """From the cell's priors.

        Args:
            model: The error model.
            priors: Sizes by family.
            single: Standard deviations of single parameters, by name.
            nominal: shape (p,), where each parameter's change is 0; None: where x is.
        """
        single = single or {}
        placed = model.family(FRAME, TARGET)
        precision = np.where(placed, 1.0 / _PLACED**2, 0.0)
        alone = np.array([name in single for name in model.names], dtype=bool)
        for k in np.flatnonzero(alone):
            precision[k] = 1.0 / single[model.names[k]] ** 2
        off = priors.sizes == "off"
        known = np.zeros(len(model)) if nominal is None else np.where(alone, nominal, 0.0)
        names = [f for f in model.families if np.any(model.family(f) & ~alone)]
        return cls(
            names=tuple(names),
            families=tuple(model.family(f) & ~alone for f in names),
            start=tuple(_LEASH if off else priors.of(f) for f in names),
            precision=precision,
            flat=placed & ~alone,
            adapts=priors.sizes == "data",
            off=off,
            means=tuple((int(k), float(known[k])) for k in np.flatnonzero(known)),
        )

    def at_bounds(self, fixed: Mapping[int, float]) -> Holds:
        """With some parameters, by their numbers, held at these values."""
        if not fixed:
            return self
        at = np.zeros(len(self.precision), dtype=bool)
        at[list(fixed)] = True
        kept = [k for k, members in enumerate(self.families) if np.any(members & ~at)]
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            families=tuple(self.families[k] & ~at for k in kept),
            start=tuple(self.start[k] for k in kept),
            precision=np.where(at, 1.0 / _FIXED**2, self.precision),
            flat=self.flat & ~at,
            fixed=tuple(sorted(fixed.items())),
        )

    @property
    def centre(self) -> Array:
        """The priors' means, shape (p,): 0 but for parameters at a bound, and what was said to be elsewhere."""
        result = np.zeros(len(self.precision))
        for k, value in (*self.means, *self.fixed):
            result[k] = value
        return result

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Smallest and largest size of each family."""
        return tuple(FAMILIES[f].bounds for f in self.names)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Weights, noise and prior sizes at one time of the estimation.

    Attributes:
        holds: What holds the parameters.
        weights: shape (N,), robust weights.
        share: shape (N,), what a row counts for beside its repeats.
        noise: Of each instrument, in units of the sigma given.
        sizes: Of each family.
    """

    holds: Holds
    weights: Array
    share: Array
    noise: tuple[float, ...]
    sizes: tuple[float, ...]

    @classmethod
    def first(
        cls, holds: Holds, rows: int, instruments: int, weights: Array | None = None
    ) -> Stage:
        """The noise as given, the priors as wide as they were given; all rows in full, or with these weights."""
        ones = np.ones(rows)
        noise = (1.0,) * instruments
        return cls(holds, ones if weights is None else weights, ones, noise, holds.start)

    @property
    def effective(self) -> Array:
        """The weights of the rows, repeats shared out, shape (N,)."""
        return self.weights * self.share

    @property
    def precision(self) -> Array:
        """1 / tau^2 of each parameter, shape (p,)."""
        own = precision_of(self.holds.families, self.sizes, len(self.holds.precision))
        return own + self.holds.precision

    def known(self, linear: Linear) -> Known:
        """All that is known besides the measurements, at these sizes."""
        return linear.known(self.precision, self.holds.centre)

    def problem(self, problem: Problem) -> Problem:
        """The problem in this form."""
        instruments, _ = problem.rows.instruments
        scales = np.append(np.array(self.noise), 1.0)[instruments] * problem.rows.scales
        return problem.reweighted(self.effective, scales, self.precision, self.holds.centre)

    def by_median(self, linear: Linear) -> Stage:
        """Robust weights against a scale that outliers cannot move, on the linearised problem."""
        weights, noise = self.weights, self.noise
        for _ in range(3):
            effective = weights * self.share
            data, known = linear.data(effective), self.known(linear)
            residual, covariance, _ = linear.fit(effective, noise, known, data)
            found = []
            for c, smallest in enumerate(linear.smallest):
                single = linear.norms(residual, covariance / noise[c] ** 2, effective, c)
                found.append(max(median_noise(single, linear.instruments == c), smallest))
            noise = tuple(found)
            # Scores in units of the new noise need the covariance that goes with it.
            residual, covariance, _ = linear.fit(effective, noise, known, data)
            weights = cauchy_weights(linear.scores(residual, covariance, effective, noise))
        return replace(self, weights=weights, noise=noise)

    def by_likelihood(self, linear: Linear, *, robust: bool) -> Stage:
        """Noise and prior sizes by restricted likelihood, and the weights that go with them."""
        stage = self
        for _ in range(2 if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            data = linear.data(stage.effective)
            held = self.holds.precision if self.holds.adapts else self.precision
            found = sizes_by_reml(
                data,
                self.holds.families if self.holds.adapts else (),
                Sizes(stage.noise, stage.sizes if self.holds.adapts else ()),
                smallest_noise=linear.smallest,
                noise_spread=NOISE_SPREAD,
                known=linear.known(held, self.holds.centre),
                bounds=self.holds.bounds if self.holds.adapts else (),
            )
            sizes = found.families if self.holds.adapts else stage.sizes
            stage = replace(stage, noise=found.noise, sizes=sizes)
        return stage

    def _row_weights(self, linear: Linear) -> Array:
        """The weights that the scores of the linear fit ask for."""
        effective = self.effective
        residual, covariance, freedom = linear.fit(effective, self.noise, self.known(linear))
        if freedom <= FEWEST_FREEDOM:
            return np.ones(len(effective))
        row_scores = linear.scores(residual, covariance, effective, self.noise)
        found = Limits.of(len(effective), freedom).weights(row_scores)
        # Half of the rows cannot be outliers of the other half: then it is the noise that is taken too small.
        return found if np.sum(found) > 0.5 * len(found) else np.ones(len(found))

    def sharing(self, linear: Linear, poses: NDArray[np.int_], mode: str) -> Stage:
        """What each of n repeats counts for, 1 / (1 + (n - 1) rho), with their correlation rho from what is left over.

        Args:
            linear: The linearised problem.
            poses: shape (N,), the pose of each row.
            mode: ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: found.
        """
        alive = self.weights > 0.0
        counts = np.bincount(poses[alive], minlength=int(poses.max()) + 1)[poses]
        if mode == "independent" or np.max(counts) < 2:
            return self
        rho = 1.0
        if mode == "weighted":
            residual, _, freedom = linear.fit(self.effective, self.noise, self.known(linear))
            scale = linear.noise_of(self.noise)
            paid = float(np.sum(self.effective @ linear.used)) - freedom
            found = repeats(
                residual / scale,
                linear.used,
                poses,
                self.weights,
                fitted=max(paid, 0.0),
            )
            rho = found.rho if found.freedom >= _TELLING_REPEATS else 1.0
        return replace(self, share=1.0 / (1.0 + (np.maximum(counts, 1) - 1.0) * rho))

    def is_like(self, other: Stage) -> bool:
        """Whether two stages differ by too little to matter."""
        return bool(
            np.max(np.abs(self.effective - other.effective)) < SETTLED
            and np.allclose(
                [*self.noise, *self.sizes], [*other.noise, *other.sizes], rtol=SETTLED_SIZES
            )
        )

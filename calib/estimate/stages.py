"""The stages of an estimation: robust weights, noise and prior sizes on the linearised problem, until they settle.

First come robust weights whose scale is a median; then noise and prior standard deviations by restricted likelihood,
with weights that single out the outliers. B fits, each without some of the rows, go through the stages at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.estimate.linear import Linear
from calib.estimate.prior_terms import PriorTerms
from calib.model.families import FAMILIES
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.reml import VarianceLimits, prior_std_by_reml
from calib.numerics.repeats import scatter_of_repeats
from calib.numerics.scores import Limits, median_noise
from calib.units import Array, Integers, Mask

#: Prior standard deviation of the logarithm of the noise: a factor of ten either way from the one given or assumed.
_NOISE_SPREAD = float(np.log(10.0))


#: With fewer degrees of freedom all rows keep their weight.
FEWEST_FREEDOM = 6.0


#: With fewer degrees of freedom the scatter of repeats is not used.
_TELLING_REPEATS = 6.0


#: Noise up to so many times the smallest one allowed is rounding.
_ROUNDING = 2.0


#: Weights that change by less have settled.
_SETTLED = 0.02


#: Noise and sizes whose relative change is less have settled.
_SETTLED_SIZES = 0.01


#: The most rounds of each kind of stage.
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Weights, noise and prior sizes at one point of an estimation, of B fits, each without some of the rows."""

    prior: PriorTerms
    kept: Mask  # (B, N), the rows that each fit has
    weights: Array  # (B, N), robust weights; 0 for rows that are not there
    share: Array  # (B, N), the factor on the weight of a row that has repeats
    noise: Array  # (B, C), of each instrument, in units of the sigma given
    prior_std: Array  # (B, K), of each family
    rho: Array  # (B, C, 2), shares of each instrument's variance that targets of a stop have in common

    @classmethod
    def first(
        cls, prior: PriorTerms, kept: Mask, instruments: int, weights: Array | float = 1.0
    ) -> Stage:
        """Noise and priors as given; every row with weight one, or with these weights."""
        prior_std = np.tile(np.array(prior.start, dtype=np.float64), (len(kept), 1))
        noise = np.ones((len(kept), instruments))
        own = np.asarray(kept * weights, np.float64)
        rho = np.zeros((*noise.shape, 2))
        return cls(prior, kept, own, np.ones(kept.shape), noise, prior_std, rho)

    @property
    def effective(self) -> Array:
        """The weights of the rows, times the factor for repeats, shape (B, N)."""
        return self.weights * self.share

    @property
    def priors(self) -> GaussianPriors:
        """The priors of all parameters, at these sizes."""
        own = (1.0 / self.prior_std**2) @ self.prior.families
        return GaussianPriors(own + self.prior.precision, self.prior.centre)

    def fit(self, linear: Linear) -> tuple[Array, Array, Array]:
        """See `calib.estimate.problem.Linear.fit`."""
        return linear.fit(self.effective, self.rho, self.noise, self.priors)

    def judged(self, linear: Linear) -> tuple[Array, Array, Array]:
        """The fit, with the covariance as if all rows were independent, by which single rows are scored."""
        x, covariance, freedom = self.fit(linear)
        if np.any(self.rho):
            alone = replace(self, rho=np.zeros(self.rho.shape))
            _, covariance, freedom = alone.fit(linear)
        return x, covariance, freedom

    def by_median(self, linear: Linear) -> Stage:
        """Robust weights against a scale that outliers cannot move."""
        stage = self
        for _ in range(3):
            x, covariance, _ = stage.fit(linear)
            noise = np.empty_like(stage.noise)
            for c, smallest in enumerate(linear.smallest):
                unit = covariance / stage.noise[:, c, None, None] ** 2
                own = linear.instruments == c
                single = linear.norms(x, unit, stage.effective, own[None].astype(np.float64))
                typical = median_noise(single, own, stage.kept)
                noise[:, c] = np.maximum(typical, smallest)
            stage = replace(stage, noise=noise)
            # Scores in units of the new noise need the covariance that goes with it.
            x, covariance, _ = stage.fit(linear)
            scores = linear.scores(x, covariance, stage.effective, noise)
            # Cauchy's weights are never quite 0, while the fit may still be wrong for all rows.
            stage = replace(stage, weights=1.0 / (1.0 + (scores / 3.4) ** 2) * stage.kept)
        return stage

    def by_likelihood(self, linear: Linear, robust: bool) -> Stage:
        """Noise and prior sizes by restricted likelihood, and the weights that go with them."""
        stage, prior = self, self.prior
        adapts = prior.source == "data"
        free = slice(None) if adapts else slice(0)
        for _ in range(2 if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            noise, prior_std = prior_std_by_reml(
                linear.data(stage.effective, stage.rho),
                prior.families[free],
                (stage.noise, stage.prior_std[:, free]),
                GaussianPriors(prior.precision, prior.centre) if adapts else self.priors,
                VarianceLimits(
                    linear.smallest,
                    tuple(FAMILIES[f].bounds for f in prior.names[free]),
                    _NOISE_SPREAD,
                ),
            )
            stage = replace(stage, noise=noise, prior_std=prior_std if adapts else stage.prior_std)
        return stage

    def _row_weights(self, linear: Linear) -> Array:
        """The weights that follow from the scores of the linear fit."""
        x, covariance, freedom = self.judged(linear)
        count = np.sum(self.kept, axis=1)
        scores = linear.scores(x, covariance, self.effective, self.noise)
        found = Limits.of(count[:, None], freedom[:, None]).weights(scores) * self.kept
        # Half of the rows cannot be outliers of the other half: then the noise is underestimated.
        enough = (freedom > FEWEST_FREEDOM) & (np.sum(found, axis=1) > 0.5 * count)
        return np.where(enough[:, None], found, self.kept)

    def sharing(self, linear: Linear, poses: Integers, mode: str) -> Stage:
        """Weight each of n repeats by 1 / (1 + (n - 1) rho), with their correlation rho.

        The mode is ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: found. ``poses`` has the shape (N,).
        """
        number, alive = int(poses.max()) + 1, self.weights > 0.0
        counts = np.array([np.bincount(poses[own], minlength=number)[poses] for own in alive])
        if mode == "independent" or np.max(counts) < 2:
            return self
        rho = np.ones(len(alive))
        if mode == "weighted":
            x, _, freedom = self.fit(linear)
            residual = linear.residual(x) / linear.noise_of(self.noise)
            paid = np.maximum(np.sum(self.effective @ linear.used, axis=1) - freedom, 0.0)
            for b, weights in enumerate(self.weights):
                found = scatter_of_repeats(
                    residual[b], linear.used, poses, weights, fitted=float(paid[b])
                )
                rho[b] = found.rho if found.freedom >= _TELLING_REPEATS else 1.0
        return replace(self, share=1.0 / (1.0 + (np.maximum(counts, 1) - 1.0) * rho[:, None]))

    def by_stops(self, linear: Linear) -> Stage:
        """Estimate the shares of stops, see `calib.estimate.stop_errors`; zero where the noise is rounding."""
        if linear.stops is None:
            return self
        x, covariance, _ = self.fit(linear)
        rho = linear.shares(x, covariance, self.effective, self.rho)
        rounding = self.noise <= _ROUNDING * np.array(linear.smallest)
        return replace(self, rho=np.where(rounding[:, :, None], 0.0, rho))


def staged(
    stage: Stage,
    linear_at: Callable[[Stage], Linear],
    poses: Integers,
    repeats: str,
    *,
    robust: bool,
) -> tuple[Stage, Array]:
    """Weights, noise and sizes from the first stage on, until they settle, for each fit of the stage.

    Also returned are the degrees of freedom of the first fit, (B,): where they are few no row loses its weight.
    """
    linear = linear_at(stage)
    stage = stage.sharing(linear, poses, repeats)
    freedom = stage.fit(linear)[2]
    robust = robust and bool(np.any(freedom > FEWEST_FREEDOM))
    # The fields of a stage that have one entry for each fit.
    names = ("kept", "weights", "share", "noise", "prior_std", "rho")
    each = {name: getattr(stage, name).copy() for name in names}
    for likely in (False, True) if robust else (True,):
        going = np.arange(len(stage.kept))  # the fits that still change
        for _ in range(_ROUNDS):
            before = replace(stage, **{name: values[going] for name, values in each.items()})
            after = before.by_likelihood(linear, robust) if likely else before.by_median(linear)
            after = after.sharing(linear, poses, repeats)
            after = after.by_stops(linear) if likely else after
            linear = linear_at(after)
            for name, values in each.items():
                values[going] = getattr(after, name)
            same = np.abs(after.effective - before.effective).max(axis=1) < _SETTLED
            if likely:
                now, then = (np.hstack([one.noise, one.prior_std]) for one in (after, before))
                same &= np.isclose(now, then, rtol=_SETTLED_SIZES).all(axis=1)
                own, of_before = (1.0 - one.rho.sum(axis=2) for one in (after, before))
                same &= np.isclose(own, of_before, rtol=_SETTLED_SIZES).all(axis=1)
            going = going[~same]
            if not len(going):
                break
    stage = replace(stage, **each)
    return stage, freedom

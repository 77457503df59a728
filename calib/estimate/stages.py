"""Stages of an estimation: row weights, noise and prior standard deviations are estimated until they settle.

On the linearised problem: first robust weights whose scale is a median; then noise and prior standard deviations by
restricted likelihood, with weights that single out the outliers. B fits, each without some of the rows, go through the
stages together. Letters of shapes: see `calib.estimate.problem`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.estimate.linear import LinearProblem
from calib.estimate.prior_terms import PriorTerms
from calib.model.families import FAMILIES
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.reml import VarianceLimits, prior_std_by_reml
from calib.numerics.repeats import scatter_of_repeats
from calib.numerics.scores import Limits, median_noise
from calib.registration.rows import Rows
from calib.units import Array, Integers, Mask

#: Prior standard deviation of the logarithm of the noise: a factor of ten either way from the one given or assumed.
_NOISE_SPREAD = float(np.log(10.0))

#: With fewer degrees of freedom all rows keep their weight.
FEWEST_FREEDOM = 6.0

#: With fewer degrees of freedom the scatter of repeats is not used.
_TELLING_REPEATS = 6.0

#: Score at which a row has half its weight in the robust start, by Cauchy's weights.
_CAUCHY = 3.4

#: Rounds of weights and median noise on one linearisation.
_MEDIAN_ROUNDS = 3

#: Rounds of weights and likelihood on one linearisation.
_LIKELIHOOD_ROUNDS = 2

#: Outliers have no more than this share of the weight: otherwise the noise is underestimated, and all rows keep theirs.
_MOST_OUTLIERS = 0.5

#: Noise up to so many times the lowest one allowed is rounding.
_ROUNDING = 2.0

#: Weights that change by less have settled.
_SETTLED_WEIGHT = 0.02

#: Noise and prior standard deviations whose relative change is less have settled.
_SETTLED_STD = 0.01

#: The most rounds of each kind of stage.
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Weighting:
    """Treatment of the rows' weights in a fit."""

    #: Repeats of a pose: "independent", "average" (as one row), or "weighted" by their correlation
    repeats: str
    #: Whether outliers lose their weight
    robust: bool
    #: (N,), weights to begin with; or 1 for all rows
    start: Array | float

    @classmethod
    def of(cls, repeats: str, robust: bool, rows: Rows) -> Weighting:
        """Return the treatment that a cell and task ask for, or, if the rows come with weights, to keep these.

        Args:
            repeats: See the field.
            robust: See the field.
            rows: N rows. In their weights, if any, repeats are already shared out.
        """
        if rows.weights is None:
            return cls(repeats, robust, 1.0)
        return cls("independent", False, rows.weights)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Weights, noise and prior standard deviations at one point of an estimation of B fits."""

    #: Priors as given, the same for all fits
    prior: PriorTerms
    #: (B, N), the rows that each fit has
    kept: Mask
    #: (B, N), robust weights; 0 for rows that a fit does not have
    weights: Array
    #: (B, N), factor on the weight of a row that has repeats
    share: Array
    #: (B, C), of each instrument, in units of the given sigma
    noise: Array
    #: (B, K), of each family, in its parameters' unit
    prior_std: Array
    #: (B, C, 2), shares of each instrument's variance that targets of a stop have in common
    rho: Array

    @classmethod
    def initial(
        cls, prior: PriorTerms, kept: Mask, instruments: int, weights: Array | float = 1.0
    ) -> Stage:
        """Return the first stage: noise and priors as given.

        Args:
            prior: Priors of the parameters.
            kept: shape (B, N), the rows that each fit has.
            instruments: Their number C.
            weights: Weights to begin with, shape (N,), or one for all rows.
        """
        B = len(kept)
        return cls(
            prior=prior,
            kept=kept,
            weights=np.asarray(kept * weights, np.float64),
            share=np.ones(kept.shape),
            noise=np.ones((B, instruments)),
            prior_std=np.tile(np.array(prior.start, dtype=np.float64), (B, 1)),
            rho=np.zeros((B, instruments, 2)),
        )

    @property
    def effective(self) -> Array:
        """Weights of the rows, times the factor for repeats, shape (B, N)."""
        return self.weights * self.share

    @property
    def priors(self) -> GaussianPriors:
        """Priors of all parameters, with the prior standard deviations of this stage: precision (B, p)."""
        of_families = (1.0 / self.prior_std**2) @ self.prior.families
        return GaussianPriors(of_families + self.prior.precision, self.prior.centre)

    def fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit the linearised problem at this stage's weights, noise and priors.

        Returns:
            x, shape (B, p), its covariance, shape (B, p, p), and degrees of freedom, shape (B,).
        """
        return linear.fit(self.effective, self.rho, self.noise, self.priors)

    def scoring_fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit for the scores of single rows: `fit`, with covariance and freedom as if all rows were independent."""
        x, covariance, freedom = self.fit(linear)
        if np.any(self.rho):
            independent = replace(self, rho=np.zeros(self.rho.shape))
            _, covariance, freedom = independent.fit(linear)
        return x, covariance, freedom

    def by_median(self, linear: LinearProblem) -> Stage:
        """Return the stage with the noise of medians, which outliers hardly move, and Cauchy's robust weights."""
        stage = self
        for _ in range(_MEDIAN_ROUNDS):
            stage = replace(stage, noise=stage._median_noise(linear))
            # Scores in units of the new noise need the covariance that goes with it.
            x, covariance, _ = stage.fit(linear)
            scores = linear.scores(x, covariance, stage.effective, stage.noise)
            # Cauchy's weights are never quite 0, while the fit may still be wrong for all rows.
            weights = 1.0 / (1.0 + (scores / _CAUCHY) ** 2) * stage.kept
            stage = replace(stage, weights=weights)
        return stage

    def _median_noise(self, linear: LinearProblem) -> Array:
        """Noise of each instrument by the median of its rows' deleted residuals, shape (B, C)."""
        x, covariance, _ = self.fit(linear)
        noise = np.empty_like(self.noise)
        for c, smallest in enumerate(linear.smallest_noise):
            # In units of this instrument's sigma, as if its noise were 1.
            unit_covariance = covariance / self.noise[:, c, None, None] ** 2
            of_instrument = linear.instruments == c
            factors = of_instrument[None].astype(np.float64)
            norms = linear.norms(x, unit_covariance, self.effective, factors)
            noise[:, c] = np.maximum(median_noise(norms, of_instrument, self.kept), smallest)
        return noise

    def by_likelihood(self, linear: LinearProblem, robust: bool) -> Stage:
        """Return the stage with noise and prior standard deviations by restricted likelihood.

        Args:
            linear: The linearised problem.
            robust: Whether to give the rows the weights that follow from their scores first.
        """
        stage, prior = self, self.prior
        from_data = prior.source == "data"
        families = slice(None) if from_data else slice(0)
        limits = VarianceLimits(
            smallest_noise=linear.smallest_noise,
            prior_std=tuple(FAMILIES[name].bounds for name in prior.names[families]),
            noise_spread=_NOISE_SPREAD,
        )
        for _ in range(_LIKELIHOOD_ROUNDS if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            priors = self.priors
            if from_data:
                priors = GaussianPriors(prior.precision, prior.centre)
            noise, prior_std = prior_std_by_reml(
                linear.normal_equations(stage.effective, stage.rho),
                prior.families[families],
                (stage.noise, stage.prior_std[:, families]),
                priors,
                limits,
            )
            stage = replace(stage, noise=noise)
            if from_data:
                stage = replace(stage, prior_std=prior_std)
        return stage

    def _row_weights(self, linear: LinearProblem) -> Array:
        """Weight the rows of each fit by their scores under the linear fit.

        Where few degrees of freedom are left, or the weights would reject more than `_MOST_OUTLIERS` of a fit's rows,
        every row that the fit has keeps the weight 1.

        Args:
            linear: The linearised problem.

        Returns:
            shape (B, N), from 0 to 1; 0 for rows that a fit does not have.
        """
        x, covariance, freedom = self.scoring_fit(linear)
        count = np.sum(self.kept, axis=1)
        scores = linear.scores(x, covariance, self.effective, self.noise)
        limits = Limits.of(count[:, None], freedom[:, None])
        weights = limits.weights(scores) * self.kept
        remains_enough = np.sum(weights, axis=1) > (1.0 - _MOST_OUTLIERS) * count
        enough = (freedom > FEWEST_FREEDOM) & remains_enough
        return np.where(enough[:, None], weights, self.kept)

    def sharing(self, linear: LinearProblem, poses: Integers, mode: str) -> Stage:
        """Return the stage with each of n repeats weighted by 1 / (1 + (n - 1) rho), with their correlation rho.

        Args:
            linear: The linearised problem.
            poses: shape (N,), rows of one number are repeats.
            mode: ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: estimated.
        """
        number = int(poses.max()) + 1
        alive = self.weights > 0.0
        counts = np.array([np.bincount(poses[rows], minlength=number)[poses] for rows in alive])
        if mode == "independent" or np.max(counts) < 2:
            return self
        rho = np.ones(len(alive))
        if mode == "weighted":
            rho = self._correlation_of_repeats(linear, poses)
        others = np.maximum(counts, 1) - 1.0
        return replace(self, share=1.0 / (1.0 + others * rho[:, None]))

    def _correlation_of_repeats(self, linear: LinearProblem, poses: Integers) -> Array:
        """Estimate the correlation of repeats in each fit, shape (B,); 1 where there are too few of them."""
        x, _, freedom = self.fit(linear)
        residual = linear.residual(x) / linear.noise_by_scalar(self.noise)
        scalars = np.sum(self.effective @ linear.used, axis=1)
        fitted = np.maximum(scalars - freedom, 0.0)
        rho = np.ones(len(x))
        for b, weights in enumerate(self.weights):
            repeats = scatter_of_repeats(
                residual[b], linear.used, poses, weights, fitted=float(fitted[b])
            )
            if repeats.freedom >= _TELLING_REPEATS:
                rho[b] = repeats.rho
        return rho

    def by_stops(self, linear: LinearProblem) -> Stage:
        """Return the stage with the shares of stops estimated, see `calib.estimate.stop_errors`.

        They are zero where the noise is rounding.
        """
        if linear.stops is None:
            return self
        x, covariance, _ = self.fit(linear)
        rho = linear.stop_shares(x, covariance, self.effective, self.rho)
        rounding = self.noise <= _ROUNDING * np.array(linear.smallest_noise)
        return replace(self, rho=np.where(rounding[:, :, None], 0.0, rho))

    def select(self, fits: Integers) -> Stage:
        """Return the stage of some of the B fits, by their numbers."""
        return replace(
            self,
            kept=self.kept[fits],
            weights=self.weights[fits],
            share=self.share[fits],
            noise=self.noise[fits],
            prior_std=self.prior_std[fits],
            rho=self.rho[fits],
        )

    def updated(self, fits: Integers, new: Stage) -> Stage:
        """Return the stage with some of the B fits replaced.

        Args:
            fits: Numbers of the fits to replace, from 0, shape (n,).
            new: A stage of these n fits alone, in the order of ``fits``.
        """

        def joined(old_values: Array, new_values: Array) -> Array:
            values: Array = old_values.copy()
            values[fits] = new_values
            return values

        return replace(
            self,
            weights=joined(self.weights, new.weights),
            share=joined(self.share, new.share),
            noise=joined(self.noise, new.noise),
            prior_std=joined(self.prior_std, new.prior_std),
            rho=joined(self.rho, new.rho),
        )


def run_stages(
    stage: Stage,
    linear_at: Callable[[Stage], LinearProblem],
    poses: Integers,
    weighting: Weighting,
) -> tuple[Stage, Array]:
    """Estimate weights, noise and prior standard deviations of B fits, until they settle.

    Args:
        stage: The first stage.
        linear_at: Maps a stage to the problem linearised at its solution.
        poses: shape (N,), rows of one number are repeats.
        weighting: Treatment of the rows' weights.

    Returns:
        The last stage, and the degrees of freedom of the first fit, shape (B,): where they are few no row loses weight.
    """
    linear = linear_at(stage)
    stage = stage.sharing(linear, poses, weighting.repeats)
    freedom = stage.fit(linear)[2]
    robust = weighting.robust and bool(np.any(freedom > FEWEST_FREEDOM))
    for by_likelihood in (False, True) if robust else (True,):
        moving = np.arange(len(stage.kept))  # the fits that have not settled
        for _ in range(_ROUNDS):
            before = stage.select(moving)
            if by_likelihood:
                after = before.by_likelihood(linear, robust)
                after = after.sharing(linear, poses, weighting.repeats).by_stops(linear)
            else:
                after = before.by_median(linear)
                after = after.sharing(linear, poses, weighting.repeats)
            linear = linear_at(after)
            stage = stage.updated(moving, after)
            settled = _has_settled(before, after, weights_only=not by_likelihood)
            moving = moving[~settled]
            if not len(moving):
                break
    return stage, freedom


def _has_settled(before: Stage, after: Stage, *, weights_only: bool) -> Mask:
    """Mask of the fits that no longer change from one stage to the next, shape (B,)."""
    change = np.abs(after.effective - before.effective).max(axis=1)
    settled: Mask = change < _SETTLED_WEIGHT
    if weights_only:
        return settled
    std_before = np.hstack([before.noise, before.prior_std])
    std_after = np.hstack([after.noise, after.prior_std])
    settled &= np.isclose(std_after, std_before, rtol=_SETTLED_STD).all(axis=1)
    unshared_before = 1.0 - before.rho.sum(axis=2)
    unshared_after = 1.0 - after.rho.sum(axis=2)
    settled &= np.isclose(unshared_after, unshared_before, rtol=_SETTLED_STD).all(axis=1)
    return settled

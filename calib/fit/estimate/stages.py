"""Stages of an estimation: row weights, noise and prior standard deviations are estimated until they settle.

On the linearised problem: first robust weights whose scale is a median; then noise and prior standard deviations by
restricted likelihood, with weights that single out the outliers. B fits, each without some of the rows, go through the
stages together. Letters of shapes: see `calib.fit.estimate.problem`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.stop_shares import PARTS
from calib.fit.registration.rows import Rows
from calib.model.families import FAMILIES
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.reml import VarianceLimits, prior_std_by_reml
from calib.numerics.repeats import scatter_of_repeats
from calib.numerics.scores import Limits, median_noise

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
    """Treatment of the rows' weights in a fit to N rows."""

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
            repeats: How repeats of a pose count: "independent", "average" (as one row), or "weighted" by their
                correlation.
            robust: True if outliers lose their weight.
            rows: N rows of measurements. In their weights, if any, repeats are already shared out; None for rows whose
                weights the fit estimates.

        Returns:
            The treatment as asked for; of rows with weights "independent" and not robust, to begin with these weights.
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
    #: (B, C, 3), shares of each instrument's variance that targets of a stop have in common
    rho: Array

    @classmethod
    def initial(
        cls,
        prior: PriorTerms,
        kept: Mask,
        instruments: int,
        weights: Array | float = 1.0,
    ) -> Stage:
        """Return the first stage: noise and priors as given.

        Args:
            prior: Priors of the p parameters, the same for all B fits: K families with a prior standard deviation each.
            kept: shape (B, N), which of the N rows each fit has.
            instruments: Number C of instruments: lengths of each kind of rows, and angles of each kind.
            weights: Weights of the rows to begin with, shape (N,), or one number for all rows.

        Returns:
            The stage with noise 1 (the given sigma), repeats that count as independent rows, and nothing that targets
            of a stop have in common.
        """
        B = len(kept)
        return cls(
            prior=prior,
            kept=kept,
            weights=np.asarray(kept * weights, np.float64),
            share=np.ones(kept.shape),
            noise=np.ones((B, instruments)),
            prior_std=np.tile(np.array(prior.start, dtype=np.float64), (B, 1)),
            rho=np.zeros((B, instruments, len(PARTS))),
        )

    @property
    def effective(self) -> Array:
        """Weights with which the rows count in the fits: the robust ones, times the factor for repeats.

        Uses `weights`, shape (B, N), robust weights of N rows in B fits, and `share`, shape (B, N), the factor by which
        each of several repeats of a pose counts less.

        Returns:
            shape (B, N), from 0 to 1; 0 for rows that a fit does not have. A row's variance is divided by its weight.
        """
        return self.weights * self.share

    @property
    def priors(self) -> GaussianPriors:
        """Priors of all p parameters, with the prior standard deviations of this stage.

        Uses `prior_std`, shape (B, K), standard deviation of each of K families in B fits, and of `prior`, the priors
        as given, the members of each family (``families``, shape (K, p)), and 1 / variance and mean (``precision`` and
        ``centre``, shape (p,)) of parameters with a prior of their own, at a bound, or of frames and targets.

        Returns:
            1 / variance of each parameter in each of B fits, shape (B, p), and the means, shape (p,), in the
            parameters' units.
        """
        of_families = (1.0 / self.prior_std**2) @ self.prior.families
        return GaussianPriors(of_families + self.prior.precision, self.prior.centre)

    def fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit the linearised problem at this stage's weights, noise and priors, for each of B fits.

        Uses `effective`, shape (B, N), row weights; `rho`, shape (B, C, 3), shares of variance that the targets of a
        stop have in common; `noise`, shape (B, C), of each instrument as a multiple of the given sigma; and `priors`, 1
        / variance, (B, p), and mean of each parameter.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            x, shape (B, p), the parameters themselves [m, rad, ...]; its covariance, shape (B, p, p); and the degrees
            of freedom left for the noise, shape (B,): scalars by weight, less those that the fit spent.
        """
        return linear.fit(self.effective, self.rho, self.noise, self.priors)

    def scoring_fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit for the scores of single rows: `fit`, with covariance and freedom as if all rows were independent.

        Uses `rho`, shape (B, C, 3), shares of variance that the targets of a stop have in common, and what `fit` uses:
        row weights, noise and priors of B fits.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            x, shape (B, p), [m, rad, ...], which takes into account what the targets of a stop have in common; and,
            without it, the covariance, shape (B, p, p), and the degrees of freedom left for the noise, shape (B,).
        """
        x, covariance, freedom = self.fit(linear)
        if np.any(self.rho):
            independent = replace(self, rho=np.zeros(self.rho.shape))
            _, covariance, freedom = independent.fit(linear)
        return x, covariance, freedom

    def by_median(self, linear: LinearProblem) -> Stage:
        """Return the stage with the noise of medians, which outliers hardly move, and Cauchy's robust weights.

        Noise and weights are computed in turn, three times, from where this stage is. A row's weight is 1 / (1 + (score
        / 3.4)^2), with the norm of its deleted residual in standard deviations as the score.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            The stage with new `weights`, shape (B, N), 0 for rows that a fit does not have, and a new `noise`, shape
            (B, C), as a multiple of the given sigma; prior standard deviations stay.
        """
        stage = self
        for _ in range(_MEDIAN_ROUNDS):
            stage = replace(stage, noise=stage._median_noise(linear))
            # Scores in units of the new noise need the covariance that goes with it.
            x, covariance, _ = stage.fit(linear)
            scores = linear.scores(x, covariance, stage.effective, stage.noise)
            # Cauchy's weights are never quite 0, while the fit may still be wrong for all rows.
            cauchy = 1.0 / (1.0 + (scores / _CAUCHY) ** 2)
            stage = replace(stage, weights=cauchy * stage.kept)
        return stage

    def _median_noise(self, linear: LinearProblem) -> Array:
        """Noise of each instrument by the median of its rows' deleted residuals, which outliers hardly move.

        Fits with this stage's weights, noise and priors. `kept`, shape (B, N), are the rows that each of B fits has.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma; ``linear.instruments``, shape (N, D), is the index of each scalar's instrument,
                ``linear.smallest_noise`` the lowest noise of each of C instruments that is no rounding, as a multiple
                of the given sigma.

        Returns:
            shape (B, C), standard deviation of a scalar as a multiple of the given sigma; at least the lowest.
        """
        x, covariance, _ = self.fit(linear)
        noise = np.empty_like(self.noise)
        for c, smallest in enumerate(linear.smallest_noise):
            # In units of this instrument's sigma, as if its noise were 1.
            unit_covariance = covariance / self.noise[:, c, None, None] ** 2
            of_instrument = linear.instruments == c
            factors = of_instrument[None].astype(np.float64)
            norms = linear.norms(x, unit_covariance, self.effective, factors)
            by_median = median_noise(norms, of_instrument, self.kept)
            noise[:, c] = np.maximum(by_median, smallest)
        return noise

    def by_likelihood(self, linear: LinearProblem, robust: bool) -> Stage:
        """Return the stage with noise and prior standard deviations by restricted likelihood.

        Prior standard deviations are estimated where the source of the priors (``prior.source``) is "data"; else they
        stay.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.
            robust: Whether to give the rows the weights that follow from their scores first; then weights and
                likelihood are computed in turn, twice.

        Returns:
            The stage of B fits with a new `noise`, shape (B, C), as a multiple of the given sigma, and, where these are
            estimated, a new `prior_std`, shape (B, K), of each family, and new robust `weights`, shape (B, N).
        """
        stage = self
        for _ in range(_LIKELIHOOD_ROUNDS if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            if self.prior.source == "data":
                stage = stage._with_noise_and_priors_by_likelihood(linear)
            else:
                stage = stage._with_noise_by_likelihood(linear)
        return stage

    def _with_noise_and_priors_by_likelihood(self, linear: LinearProblem) -> Stage:
        """The stage with the noise and the prior standard deviations of the highest restricted likelihood.

        Uses the stage's row weights and `rho`, what the targets of a stop have in common, as they are, and begins at
        its `noise` and `prior_std`. Of `prior` it uses the families' names and members (K, p), and 1 / variance and
        mean, (p,), of the parameters that have a prior besides these.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            The stage with a new `noise`, shape (B, C), of C instruments in B fits, as a multiple of the given sigma,
            and a new `prior_std`, shape (B, K), of K families, in their parameters' unit. Log noise has a normal prior
            about 0.
        """
        prior = self.prior
        limits = VarianceLimits(
            smallest_noise=linear.smallest_noise,
            prior_std=tuple(FAMILIES[name].bounds for name in prior.names),
            noise_spread=_NOISE_SPREAD,
        )
        equations = linear.normal_equations(self.effective, self.rho)
        besides_families = GaussianPriors(prior.precision, prior.centre)
        start = (self.noise, self.prior_std)
        noise, prior_std = prior_std_by_reml(
            equations, prior.families, start, besides_families, limits
        )
        return replace(self, noise=noise, prior_std=prior_std)

    def _with_noise_by_likelihood(self, linear: LinearProblem) -> Stage:
        """The stage with the noise of the highest restricted likelihood, at the priors of this stage.

        Uses the stage's row weights, `rho`, what the targets of a stop have in common, and `priors`, 1 / variance, (B,
        p), and mean of each of p parameters, as they are, and begins at its `noise`.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            The stage with a new `noise`, shape (B, C), of C instruments in B fits, as a multiple of the given sigma.
            Log noise has a normal prior about 0.
        """
        limits = VarianceLimits(
            smallest_noise=linear.smallest_noise, prior_std=(), noise_spread=_NOISE_SPREAD
        )
        equations = linear.normal_equations(self.effective, self.rho)
        no_families = self.prior.families[:0]
        start = (self.noise, self.prior_std[:, :0])
        noise, _ = prior_std_by_reml(equations, no_families, start, self.priors, limits)
        return replace(self, noise=noise)

    def _row_weights(self, linear: LinearProblem) -> Array:
        """Weight the rows of each of B fits by their scores under the linear fit.

        A weight is 1 up to the score that a good row keeps within with probability 0.99, and falls linearly to 0 at the
        score from which on a row is an outlier. Where at most 6 degrees of freedom are left, or the weights add up to
        no more than half the number of a fit's rows (`_MOST_OUTLIERS`), every row that the fit has keeps the weight 1.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.

        Returns:
            shape (B, N), robust weights from 0 to 1; 0 for rows that a fit does not have (`kept`, shape (B, N), is
            False).
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

        Of the n repeats only rows count whose robust weight (`weights`, shape (B, N)) is above 0 in the fit.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma.
            poses: shape (N,), rows of one number >= 0 are repeats: of one pose, frame, target and kind of measurement.
            mode: ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: estimated from the residuals of each
                fit.

        Returns:
            The stage with a new `share`, shape (B, N), the factors on the weights; itself where no pose has repeats, or
            they are independent.
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
        """Estimate the correlation of repeats in each of B fits, from their residuals.

        Fits with this stage's row weights, noise and priors; `weights`, shape (B, N), are the robust ones of the rows.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma; ``linear.used``, shape (N, D), are the scalars that were measured.
            poses: shape (N,), rows of one number are repeats.

        Returns:
            shape (B,), intraclass correlation from 0 to 1; 1 where repeats have fewer than 6 degrees of freedom.
        """
        x, _, freedom = self.fit(linear)
        residual = linear.residual(x) / linear.noise_by_scalar(self.noise)
        scalars = np.sum(self.effective @ linear.used, axis=1)
        fitted = np.maximum(scalars - freedom, 0.0)
        rho = np.ones(len(x))
        for b, weights in enumerate(self.weights):
            repeats = scatter_of_repeats(
                residual[b], linear.channels, poses, weights, fitted=float(fitted[b])
            )
            if repeats.freedom >= _TELLING_REPEATS:
                rho[b] = repeats.rho
        return rho

    def by_stops(self, linear: LinearProblem) -> Stage:
        """Return the stage with the shares of variance that the targets of a stop have in common estimated.

        A stop is a standstill of the robot at which several targets are measured; see `calib.fit.estimate.stop_errors`.
        Uses the residuals of a fit with this stage's row weights `effective`, shape (B, N), priors, `rho`, and `noise`,
        shape (B, C): standard deviation of each instrument as a multiple of the given sigma.

        Args:
            linear: The least-squares problem linearised: N rows of D scalars by p parameters, in units of the given
                sigma; ``linear.stops`` are its stops, None where there are none.

        Returns:
            The stage with a new `rho`, shape (B, C, 3), shares by translation, rotation and joints of each of C
            instruments, 0 where its noise is at most twice the lowest, which is rounding; itself where there are no
            stops.
        """
        if linear.stops is None:
            return self
        x, covariance, _ = self.fit(linear)
        rho = linear.stop_shares(x, covariance, self.effective, self.rho)
        rounding = self.noise <= _ROUNDING * np.array(linear.smallest_noise)
        return replace(self, rho=np.where(rounding[:, :, None], 0.0, rho))

    def select(self, fits: Integers) -> Stage:
        """Return the stage of some of the B fits.

        Takes these from `kept`, the rows that each fit has, `weights`, robust, and `share`, the factor for repeats, all
        of shape (B, N); `noise`, shape (B, C), of each instrument as a multiple of the given sigma; `prior_std`, shape
        (B, K), of each family of parameters; and `rho`, shape (B, C, 3), shared by the targets of a stop.

        Args:
            fits: shape (n,), indices of the fits to keep, from 0.

        Returns:
            The stage of these n fits, in the order of ``fits``.
        """
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
        """Return the stage with some of the B fits replaced; which rows each fit has, and the priors as given, stay.

        Args:
            fits: Indices of the fits to replace, from 0, shape (n,).
            new: A stage of these n fits alone, in the order of ``fits``, of which robust weights, factors for repeats,
                noise, prior standard deviations and what stops share are taken.

        Returns:
            The stage of all B fits.
        """

        def joined(old_values: Array, new_values: Array) -> Array:
            """A copy of an array of all fits, with the rows of the fits to replace exchanged.

            Args:
                old_values: shape (B, ...), of all B fits.
                new_values: shape (n, ...), of the n fits to replace, in the order of ``fits``.

            Returns:
                shape (B, ...).
            """
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
        stage: The first stage: row weights, noise and prior standard deviations to begin with; ``stage.kept``, shape
            (B, N), are the rows that each fit has.
        linear_at: Maps a stage to the least-squares problem linearised at its solution (N rows of D scalars by p
            parameters, in units of the given sigma); B fits share one linearisation.
        poses: shape (N,), rows of one number are repeats.
        weighting: Treatment of the rows' weights: ``weighting.repeats``, "independent", "average" or "weighted", and
            ``weighting.robust``, whether outliers lose their weight.

    Returns:
        The last stage, and the degrees of freedom of the fits at the first one, shape (B,): where they are few no row
        loses weight.
    """
    linear = linear_at(stage)
    stage = stage.sharing(linear, poses, weighting.repeats)
    _, _, freedom = stage.fit(linear)
    robust = weighting.robust and bool(np.any(freedom > FEWEST_FREEDOM))
    by_likelihood_in_turn = (False, True) if robust else (True,)
    for by_likelihood in by_likelihood_in_turn:
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
    """Mask of the fits that no longer change from one stage to the next.

    A fit has settled if no row's weight changes by 0.02 or more, and noise, prior standard deviations, and the share of
    each instrument's variance that the targets of a stop do not have in common change by no more than 1 per cent.

    Args:
        before: Stage of B fits: row weights, noise and prior standard deviations.
        after: The next stage of the same fits.
        weights_only: True to compare the weights of the rows alone.

    Returns:
        shape (B,).
    """
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

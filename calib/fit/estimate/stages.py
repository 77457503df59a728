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
from calib.fit.estimate.special_cases.stop_shares import PARTS, extrapolated
from calib.fit.registration.rows import Rows
from calib.model.families import FAMILIES
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.neighbours import along_path, independent_share
from calib.numerics.reml import VarianceLimits, prior_std_by_reml
from calib.numerics.repeats import scatter_of_repeats
from calib.numerics.scores import Limits, median_noise
from calib.robot.kernel import BLOCK

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

#: Of a fit's stops at most this share is thrown out. If more of them are far from the others, what they share is not
#: normal: a stop that is off as a whole is an accident, and accidents are rare.
_MOST_STOPS = 0.15

#: Blocks of rows that the correlation of neighbours is estimated from: 130,000 rows know it to a hundredth.
_RUNS = 32

#: Noise up to so many times the lowest one allowed is rounding.
_ROUNDING = 2.0

#: Weights that change by less have settled.
_SETTLED_WEIGHT = 0.02

#: Noise and prior standard deviations whose relative change is less have settled.
_SETTLED_STD = 0.01

#: So has the share of rows that count, whose root counts.
_SETTLED_SHARE = 0.05

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
    #: Whether rows follow each other, so that what neighbours tell may be much the same
    along_path: bool = False

    @classmethod
    def of(cls, repeats: str, robust: bool, rows: Rows) -> Weighting:
        """Return the treatment that is asked for; if the rows come with weights, one that keeps these.

        Repeats are already shared out in such weights.

        Args:
            repeats: How a cell treats them: "independent", "average" or "weighted".
            robust: Whether outliers are to lose their weight.
            rows: N rows of measurements.
        """
        if rows.weights is None:
            if along_path(rows.joints):
                # What looks like repeats are neighbours where the arm was slow.
                return cls("independent", robust, 1.0, along_path=True)
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
    repeat_factor: Array
    #: (B, 1), share of rows that count where neighbours are correlated, see `calib.numerics.neighbours`; else 1
    row_share: Array
    #: (B, C), of each channel, in units of the given sigma
    noise: Array
    #: (B, K), of each family, in its parameters' unit
    prior_std: Array
    #: (B, C, 3), shares of each channel's variance that targets of a stop have in common
    stop_shares: Array

    @classmethod
    def initial(
        cls,
        prior: PriorTerms,
        kept: Mask,
        channels: int,
        weights: Array | float = 1.0,
    ) -> Stage:
        """Return the first stage: noise and priors as given, repeats and the targets of a stop independent.

        Args:
            prior: Priors as given.
            kept: shape (B, N), which of the rows each fit has.
            channels: Number C of channels.
            weights: Weights of the rows to begin with, shape (N,), or one number for all rows.
        """
        B = len(kept)
        return cls(
            prior=prior,
            kept=kept,
            weights=np.asarray(kept * weights, np.float64),
            repeat_factor=np.ones(kept.shape),
            row_share=np.ones((B, 1)),
            noise=np.ones((B, channels)),
            prior_std=np.tile(np.array(prior.start, dtype=np.float64), (B, 1)),
            stop_shares=np.zeros((B, channels, len(PARTS))),
        )

    @property
    def effective(self) -> Array:
        """Weights with which the rows count, (B, N): the robust ones, times the factors of repeats and neighbours."""
        return self.weights * self.repeat_factor * self.row_share

    @property
    def priors(self) -> GaussianPriors:
        """Priors of all p parameters, of each of B fits, with the prior standard deviations of this stage."""
        of_families = (1.0 / self.prior_std**2) @ self.prior.families
        return GaussianPriors(of_families + self.prior.precision, self.prior.mean)

    def fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit the linearised problem at this stage's weights, noise and priors.

        Returns:
            Of B fits the parameters x, shape (B, p), their covariance, (B, p, p), and the degrees of freedom left for
            the noise, (B,): see `LinearProblem.fit`.
        """
        return linear.fit(self.effective, self.stop_shares, self.noise, self.priors)

    def scoring_fit(self, linear: LinearProblem) -> tuple[Array, Array, Array]:
        """Fit for the scores of single rows: with covariance and freedom as if all rows were independent.

        Returns:
            As `fit`: x, shape (B, p), its covariance, (B, p, p), and the degrees of freedom, (B,).
        """
        x, covariance, freedom = self.fit(linear)
        if np.any(self.stop_shares):
            independent = replace(self, stop_shares=np.zeros(self.stop_shares.shape))
            _, covariance, freedom = independent.fit(linear)
        return x, covariance, freedom

    def stop_excess(self, linear: LinearProblem, x: Array) -> Array:
        """Compute how far stops are off as a whole: their scores, by displacements of bodies, over the limit of these.

        Args:
            linear: The linearised problem, with S stops.
            x: shape (B, p), parameters of each fit [m, rad, ...].

        Returns:
            shape (B, S), >= 0; 0 if few degrees of freedom are left. Rows without weight count only in stops that have
            none with a weight: these are compared with what the others predict.
        """
        assert linear.stops is not None
        _, covariance, freedom = self.fit(linear)
        in_fit = linear.stops.weights_of_stops(self.effective) > 0.0
        within = self.effective.copy()
        rows = linear.stops.rows
        apart = ~in_fit[:, linear.stops.stop_of_row]
        within[:, rows] = np.where(apart, self.repeat_factor[:, rows], within[:, rows])
        scores, directions = linear.stop_scores(
            x, covariance, within, self.noise, self.stop_shares, in_fit
        )
        # What the parameters take from the scalars, they take from the displacements.
        taken = np.sum(self.effective @ linear.used, axis=1) - freedom
        left = np.sum(directions * in_fit, axis=1) - taken
        limits = Limits.of(np.sum(in_fit, axis=1)[:, None], left[:, None])
        return np.where(left[:, None] > FEWEST_FREEDOM, scores / limits.flagged, 0.0)

    def without_stops(self, linear: LinearProblem) -> Stage:
        """Return the stage without the rows of stops that are off as a whole."""
        assert linear.stops is not None
        x, _, _ = self.fit(linear)
        off = self.stop_excess(linear, x) > 1.0
        kept = self.kept.copy()
        kept[:, linear.stops.rows] &= ~off[:, linear.stops.stop_of_row]
        return replace(self, kept=kept, weights=self.weights * kept)

    def by_median(self, linear: LinearProblem) -> Stage:
        """Return the stage with the noise of medians, which outliers hardly move, and Cauchy's robust weights.

        Noise and weights are computed in turn, from where this stage is. A row's weight is 1 / (1 + (score / c)^2) with
        c = `_CAUCHY`, and with the norm of its deleted residual in standard deviations as the score.
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
        """Noise of each channel, (B, C), from the median norm of its deleted residuals, in units of the given sigma.

        It is never below the lowest noise of the channel.
        """
        x, covariance, _ = self.fit(linear)
        noise = np.empty_like(self.noise)
        for c, smallest in enumerate(linear.smallest_noise):
            # In units of this channel's sigma, as if its noise were 1.
            unit_covariance = covariance / self.noise[:, c, None, None] ** 2
            of_channel = linear.channels.index == c
            factors = of_channel[None].astype(np.float64)
            norms = linear.norms(x, unit_covariance, self.effective, factors)
            by_median = median_noise(norms, of_channel, self.kept)
            noise[:, c] = np.maximum(by_median, smallest)
        return noise

    def by_likelihood(
        self,
        linear: LinearProblem,
        robust: bool,
        rounds: int = _LIKELIHOOD_ROUNDS,
        *,
        only_compared: bool = False,
    ) -> Stage:
        """Return the stage with noise and prior standard deviations of the highest restricted likelihood.

        Log noise has a normal prior about 0. Prior standard deviations are estimated if the source of the priors is
        "data"; else they stay.

        Args:
            linear: The linearised problem.
            robust: Whether to give the rows the weights that follow from their scores first; then weights and
                likelihood are computed in turn.
            rounds: How often, if so.
            only_compared: Whether the likelihood is only compared with that of other models.
        """
        prior = self.prior
        stage = self
        for _ in range(rounds if robust else 1):
            if robust:
                stage = replace(stage, weights=stage._row_weights(linear))
            equations = linear.normal_equations(stage.effective, stage.stop_shares)
            if prior.source == "data":
                limits = VarianceLimits(
                    smallest_noise=linear.smallest_noise,
                    prior_std=tuple(FAMILIES[name].bounds for name in prior.names),
                    noise_spread=_NOISE_SPREAD,
                )
                start = (stage.noise, stage.prior_std)
                besides_families = GaussianPriors(prior.precision, prior.mean)
                noise, prior_std = prior_std_by_reml(
                    equations,
                    prior.families,
                    start,
                    besides_families,
                    limits,
                    only_compared=only_compared,
                )
                stage = replace(stage, noise=noise, prior_std=prior_std)
            else:
                limits = VarianceLimits(
                    smallest_noise=linear.smallest_noise, prior_std=(), noise_spread=_NOISE_SPREAD
                )
                start = (stage.noise, stage.prior_std[:, :0])
                no_families = prior.families[:0]
                noise, _ = prior_std_by_reml(equations, no_families, start, stage.priors, limits)
                stage = replace(stage, noise=noise)
        return stage

    def _row_weights(self, linear: LinearProblem) -> Array:
        """Weight the rows of each of B fits by their scores under the linear fit, (B, N), from 0 to 1.

        A weight is 1 up to the score that a good row keeps within with probability 0.99, and falls linearly to 0 at the
        score from which on a row is an outlier. If few degrees of freedom are left, or the weights add up to too small
        a part of a fit's rows (`_MOST_OUTLIERS`), every row that the fit has keeps the weight 1.
        """
        return self._weights_by(linear, self.scoring_fit(linear))

    def _weights_by(self, linear: LinearProblem, fit: tuple[Array, Array, Array]) -> Array:
        """The weights by the scores under a fit: x, (B, p), its covariance, (B, p, p), and degrees of freedom, (B,)."""
        x, covariance, freedom = fit
        count = np.sum(self.kept, axis=1)
        limits = Limits.of(count[:, None], freedom[:, None])
        weights = np.empty(self.weights.shape)

        def effective_of(scores: Array, rows: slice) -> Array:
            """The next effective weights, (B, n), of some of the rows by their scores, (B, n)."""
            weights[:, rows] = limits.weights(scores) * self.kept[:, rows]
            return weights[:, rows] * self.repeat_factor[:, rows] * self.row_share

        shared = bool(np.any(self.stop_shares))
        linear.weigh_by_scores(
            x, covariance, self.effective, self.noise, effective_of, shared=shared
        )
        remains_enough = np.sum(weights, axis=1) > (1.0 - _MOST_OUTLIERS) * count
        enough = (freedom > FEWEST_FREEDOM) & remains_enough
        return np.where(enough[:, None], weights, self.kept)

    def by_repeats(self, linear: LinearProblem, poses: Integers, mode: str) -> Stage:
        """Return the stage with each of n repeats weighted by 1 / (1 + (n - 1) rho), with their correlation rho.

        Of the n repeats only rows count whose robust weight is above 0 in the fit.

        Args:
            linear: The linearised problem.
            poses: shape (N,), rows of one number >= 0 are repeats: of one pose, frame, target and kind of measurement.
            mode: ``"independent"``: rho = 0; ``"average"``: 1; ``"weighted"``: estimated from the residuals of each
                fit.

        Returns:
            The stage with a new `repeat_factor`; itself if no pose has repeats, or they are independent.
        """
        if mode == "independent":
            return self
        number = int(poses.max()) + 1
        alive = self.weights > 0.0
        counts = np.array([np.bincount(poses[rows], minlength=number)[poses] for rows in alive])
        if np.max(counts) < 2:
            return self
        rho = np.ones(len(alive))
        if mode == "weighted":
            # The intraclass correlation, by the scatter of residuals; 1 if these are too few.
            x, _, freedom = self.fit(linear)
            residual = linear.residual(x) / linear.noise_by_scalar(self.noise)
            scalars = np.sum(self.effective @ linear.used, axis=1)
            fitted = np.maximum(scalars - freedom, 0.0)
            for b, weights in enumerate(self.weights):
                repeats = scatter_of_repeats(
                    residual[b], linear.channels, poses, weights, fitted=float(fitted[b])
                )
                if repeats.freedom >= _TELLING_REPEATS:
                    rho[b] = repeats.rho
        others = np.maximum(counts, 1) - 1.0
        return replace(self, repeat_factor=1.0 / (1.0 + others * rho[:, None]))

    def by_neighbours(self, linear: LinearProblem) -> Stage:
        """Return the stage with a new `row_share`, by the correlation of residuals of rows that follow each other.

        It is estimated from `_RUNS` blocks of consecutive rows at most.
        """
        x, _, _ = self.fit(linear)
        starts = np.arange(0, len(linear) - BLOCK + 1, BLOCK)
        chosen = np.unique(np.linspace(0, len(starts) - 1, _RUNS).round().astype(np.int_))
        blocks = [slice(int(k), int(k) + BLOCK) for k in starts[chosen]]
        residuals = [linear.residual_of(x, rows) for rows in blocks]
        share = np.ones(self.row_share.shape)
        for b, noise in enumerate(self.noise):
            runs = []
            for rows, residual in zip(blocks, residuals, strict=True):
                channel = linear.channels.index[rows]
                weights = self.weights[b, rows, None] * (channel >= 0)
                runs.append((residual[b] / np.append(noise, 1.0)[channel], weights))
            share[b] = independent_share(runs)
        return replace(self, row_share=share)

    def by_stops(self, linear: LinearProblem) -> Stage:
        """Return the stage with new `stop_shares`, estimated from the residuals; itself if there are no stops.

        They are 0 in channels whose noise is mere rounding.
        """
        if linear.stops is None:
            return self
        x, covariance, _ = self.fit(linear)
        shares = linear.stops.estimate_shares(
            linear.columns_of(slice(None)),
            x - linear.x,
            covariance,
            self.effective,
            self.stop_shares,
        )
        rounding = self.noise <= _ROUNDING * np.array(linear.smallest_noise)
        return replace(self, stop_shares=np.where(rounding[:, :, None], 0.0, shares))

    def of_all_rows(self, linear: LinearProblem, covariance: Array, *, robust: bool) -> Stage:
        """Return the first stage of a fit to all rows, from that of a fit to some of them as it settled (B = 1).

        Noise and prior standard deviations stay.

        Args:
            linear: The problem of all rows, linearised at the solution of this stage.
            covariance: shape (1, p, p), of this solution.
            robust: Whether each row has the weight that follows from its score, or 1.
        """
        N = len(linear)
        every_row = np.ones((1, N), dtype=bool)
        of_all = replace(
            self,
            kept=every_row,
            weights=np.ones((1, N)),
            repeat_factor=np.ones((1, N)),
        )
        if not robust:
            return of_all
        # By all rows the covariance is smaller, as their number is larger.
        share = np.sum(self.kept, axis=1)[:, None, None] / N
        fit = linear.x[None], share * covariance, np.array([float(np.sum(linear.used))])
        return replace(of_all, weights=of_all._weights_by(linear, fit))

    def select(self, fits: Integers) -> Stage:
        """Return the stage of n of the B fits, by their indices, shape (n,)."""
        return replace(
            self,
            kept=self.kept[fits],
            weights=self.weights[fits],
            repeat_factor=self.repeat_factor[fits],
            row_share=self.row_share[fits],
            noise=self.noise[fits],
            prior_std=self.prior_std[fits],
            stop_shares=self.stop_shares[fits],
        )

    def updated(self, fits: Integers, new: Stage) -> Stage:
        """Return the stage with n of the B fits, by their indices, (n,), replaced by a stage of these n alone."""

        def updated(values: Array, new_values: Array) -> Array:
            """A copy of an array of all fits with those of the fits to replace."""
            result: Array = values.copy()
            result[fits] = new_values
            return result

        kept = self.kept.copy()
        kept[fits] = new.kept
        return replace(
            self,
            kept=kept,
            weights=updated(self.weights, new.weights),
            repeat_factor=updated(self.repeat_factor, new.repeat_factor),
            row_share=updated(self.row_share, new.row_share),
            noise=updated(self.noise, new.noise),
            prior_std=updated(self.prior_std, new.prior_std),
            stop_shares=updated(self.stop_shares, new.stop_shares),
        )


def run_stages(
    stage: Stage,
    linear_at: Callable[[Stage], LinearProblem],
    poses: Integers,
    weighting: Weighting,
    *,
    only_compared: bool = False,
    near: bool = False,
) -> tuple[Stage, Array]:
    """Estimate weights, noise and prior standard deviations of B fits, until they settle.

    Args:
        stage: The first stage.
        linear_at: Maps a stage to the problem linearised at its solution; B fits share one linearisation.
        poses: shape (N,), rows of one number are repeats.
        weighting: Treatment of repeats and outliers.
        only_compared: Whether the likelihood of the last stage is only compared with that of other models: a stage that
            is linearised where the last one was then has settled.
        near: Whether the first stage is near the last one, as that of some of the rows is: it needs no robust start.

    Returns:
        The last stage, and the degrees of freedom of the fits at the first one, shape (B,): if they are few no row
        loses weight.
    """
    linear = linear_at(stage)
    stage = stage.by_repeats(linear, poses, weighting.repeats)
    _, _, freedom = stage.fit(linear)
    robust = weighting.robust and bool(np.any(freedom > FEWEST_FREEDOM))
    by_likelihood_in_turn = (False, True) if robust and not near else (True,)

    def settle(
        stage: Stage, linear: LinearProblem, by_likelihood: bool
    ) -> tuple[Stage, LinearProblem]:
        """Repeat stages of one kind until the fits settle; return the last one, and the problem at its solution."""
        moving = np.arange(len(stage.kept))  # the fits that have not settled
        last = None  # shares that the last round began with, and those it came to
        for _ in range(_ROUNDS):
            before = stage.select(moving)
            if by_likelihood:
                # A round is a pass over all rows, of which there are many if the start is near.
                times = 1 if near else _LIKELIHOOD_ROUNDS
                after = before.by_likelihood(linear, robust, times, only_compared=only_compared)
                after = after.by_repeats(linear, poses, weighting.repeats).by_stops(linear)
                if weighting.along_path:
                    after = after.by_neighbours(linear)
            else:
                after = before.by_median(linear)
                after = after.by_repeats(linear, poses, weighting.repeats)
            settled = _has_settled(before, after, weights_only=not by_likelihood)
            rounds = (before.stop_shares, after.stop_shares)
            if last is not None:
                ahead = extrapolated(last, rounds)
                ahead[settled] = after.stop_shares[settled]  # with the noise that belongs to them
                after = replace(after, stop_shares=ahead)
            last = (rounds[0][~settled], rounds[1][~settled])
            linear, begun_at = linear_at(after), linear
            stage = stage.updated(moving, after)
            if only_compared and linear is begun_at and linear.stops is None:
                break
            moving = moving[~settled]
            if not len(moving):
                break
        return stage, linear

    # Medians are of scalars that are independent.
    shares = stage.stop_shares
    stage = replace(stage, stop_shares=np.zeros(shares.shape))
    for by_likelihood in by_likelihood_in_turn:
        if by_likelihood:
            stage = replace(stage, stop_shares=shares)
        stage, linear = settle(stage, linear, by_likelihood)
    if not robust or linear.stops is None:
        return stage, freedom

    # Stops that are off as a whole are thrown out, until none is left or they are too many.
    whole = stage
    moving = np.arange(len(stage.kept))
    while len(moving):
        before = stage.select(moving)
        after = before.without_stops(linear)
        fewer = np.any(after.kept != before.kept, axis=1)
        some = linear.stops.weights_of_stops(whole.kept.astype(np.float64)[moving]) > 0.0
        left = linear.stops.weights_of_stops(after.kept.astype(np.float64)) > 0.0
        too_many = np.sum(left, axis=1) < (1.0 - _MOST_STOPS) * np.sum(some, axis=1)
        if np.any(too_many):
            stage = stage.updated(moving[too_many], whole.select(moving[too_many]))
            linear = linear_at(stage)
        going = fewer & ~too_many
        moving = moving[going]
        if len(moving):
            changed, linear = settle(after.select(np.flatnonzero(going)), linear, True)
            stage = stage.updated(moving, changed)
    return stage, freedom


def _has_settled(before: Stage, after: Stage, *, weights_only: bool) -> Mask:
    """Mask of the fits, (B,), that no longer change from one stage to the next.

    Compared are the rows' weights, and, unless ``weights_only``, noise, prior standard deviations, and the share of
    each channel's variance that the targets of a stop do not have in common.
    """
    change = np.abs(after.effective / after.row_share - before.effective / before.row_share)
    change = change.max(axis=1)
    settled: Mask = change < _SETTLED_WEIGHT
    if weights_only:
        return settled
    std_before = np.hstack([before.noise, before.prior_std])
    std_after = np.hstack([after.noise, after.prior_std])
    settled &= np.isclose(std_after, std_before, rtol=_SETTLED_STD).all(axis=1)
    settled &= np.isclose(after.row_share, before.row_share, rtol=_SETTLED_SHARE).all(axis=1)
    unshared_before = 1.0 - before.stop_shares.sum(axis=2)
    unshared_after = 1.0 - after.stop_shares.sum(axis=2)
    settled &= np.isclose(unshared_after, unshared_before, rtol=_SETTLED_STD).all(axis=1)
    return settled

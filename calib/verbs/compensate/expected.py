"""Expected position errors of commands, in the frame of the program, and the sources that they come from.

The position error of the actual robot at a command is taken to be normal, with the covariance

    S  =  s^2 / 3 I  +  C_position

    s           errors that the model lacks: held-out errors less the instrument's noise and the prediction's variance
    C_position  of the predicted position, see `calib.verbs.compensate.pose_covariance`

The error to expect is the mean length of such an error, with n = (tr S)^2 / tr S^2 degrees of freedom
(F. E. Satterthwaite, An approximate distribution of estimates of variance components, 1946):

    E|e|  =  sqrt(2 tr S / n)  Gamma((n + 1) / 2) / Gamma(n / 2)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri, fdtri, gammaln

from calib.basics.arrays import Array, Integers, read_only
from calib.basics.values import Value, keep_read_only
from calib.model.kinematics import Samples
from calib.numerics.errors import CrossValidation, Errors
from calib.result.calibration import Calibration
from calib.result.doubts import CONTRADICTED
from calib.result.fitted_model import FittedModel
from calib.verbs.compensate.nominal_actual import Pair
from calib.verbs.compensate.pose_covariance import (
    PoseCovariance,
    View,
    pose_covariance,
    unknown_base_directions,
    unmodelled_base,
)

Source = Literal["model", "parameters", "poses", "tool", "base", "scale"]
"""Source of an expected error: errors that the model lacks; its parameters, at poses like the measured ones; what other
poses of the program add; a tool that is not the measured target; the base, if its frame was estimated; the scale of
the instrument, which the lengths of the arm absorb."""

NoiseSource = Literal["stated", "repeats", "unknown"]
"""Source of the instrument's noise: cell or table; repeated poses; or unknown, then it counts as error."""

#: Share of robots whose mean error lies in `ExpectedErrors.band`.
BAND = 0.8

#: Units of a pose: of its position and of its orientation.
_POSE_UNITS = ("m", "rad")

#: Held-out errors that noise alone exceeds with a larger probability than this do not show that the model lacks any.
_CHANCE = 0.05

#: With fewer degrees of freedom, the scatter of repeats does not determine the noise.
_FEWEST_REPEATS = 6.0

#: The largest value of h (1 - h), for a leverage h.
_LARGEST_RATIO = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedErrors(Value):
    """Expected errors of N commands, in the frame of the program."""

    #: shape (N, 2), mean distance [m] and angle [rad] of the tool from its wanted pose.
    errors: Array
    #: Part of the mean square of the position error that each source adds [m^2], in the order of `Source`.
    contributions: Mapping[Source, float]
    #: Degrees of freedom of the mean square error over all rows: how many unknowns they share, and how well their
    #: variances are known.
    freedom: float
    #: Mean error of the same program in the measurement frame [m]; None if the program is in that frame.
    in_measured_frame: float | None
    #: Source of the instrument's noise.
    noise: NoiseSource
    #: Whether there are held-out errors; without them errors that the model lacks are not known, and not included.
    validated: bool

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "contributions")

    @property
    def mean(self) -> float:
        """Mean error over all rows [m]."""
        return float(np.mean(self.errors[:, 0]))

    @property
    def band(self) -> tuple[float, float]:
        """Ends of the range [m] in which the mean error over all rows lies for a share `BAND` of calibrations.

        It differs from robot to robot, because the errors of all rows come from the same few unknowns. Its distribution
        is taken to be a multiple of chi, the root of chi-squared, with the expected mean.
        """
        if not np.isfinite(self.freedom):
            return self.mean, self.mean
        tail = 0.5 * (1.0 - BAND)
        quantiles = np.sqrt(chdtri(self.freedom, np.array([1.0 - tail, tail])))
        low, high = self.mean * quantiles / mean_of_chi(self.freedom)
        return float(low), float(high)

    @property
    def largest(self) -> Source:
        """The source that adds most."""
        return max(self.contributions, key=self.contributions.__getitem__)


def expected_errors(pair: Pair, q: Array) -> ExpectedErrors:
    """Compute the expected errors of the true robot at joint values to command.

    Args:
        pair: The nominal robot and that of a result, with the tool and the frame of the program, and with the joints'
            last moves before each row if they are known.
        q: shape (N, m), joint values to command [rad] or [m].

    Returns:
        The errors of the N rows, and their sources.

    Raises:
        ValueError: The pair is of two robots, without a result.
    """
    result = _result(pair)
    part = result.part(non_geometric=pair.non_geometric)
    views = _views(pair, result, part, q)
    target, tool, arrived = (pose_covariance(part, view) for view in views)
    held_out = _held_out(pair, result, part)
    lacking = _lacking(result, part, held_out, float(target.mean_square[1]))
    measured = None
    if views[2].in_base and not views[1].in_base:
        measured = float(_mean_errors(tool.covariance, lacking)[:, 0].mean())
    return ExpectedErrors(
        errors=read_only(_mean_errors(arrived.covariance, lacking)),
        contributions=_contributions(lacking[0], part.noise_measured**2, target, tool, arrived),
        freedom=_freedom(result, arrived, float(lacking[0]), part.cross_validation),
        in_measured_frame=measured,
        noise=_instrument_noise(result)[0],
        validated=part.cross_validation is not None,
    )


def _result(pair: Pair) -> Calibration:
    """Return the calibration of a pair of robots; raises `ValueError` if there is none, so that errors are unknown."""
    if pair.result is None:
        raise ValueError("the errors of a robot without a result are not known")
    return pair.result


def _views(pair: Pair, result: Calibration, part: FittedModel, q: Array) -> tuple[View, View, View]:
    """Return views of the measured target, of the tool, and of the tool in the program's frame, at joint values (N, m).

    The first two are in the measurement frame. If the tool is not a target, the target nearest to it is measured.
    """
    setup, ends = part.setup, pair.nominal.robot
    # Of several chains, those on the links of the commanded one.
    targets_there = _on_link(setup.target_links, ends.tip, len(setup.targets))
    groups_there = _on_link(setup.frame_links, ends.base, len(setup.groups))
    if pair.target is None:
        # The target nearest to the tool.
        places = setup.T_tip_target[targets_there, :3, 3]
        away = places - pair.actual.T_tip_tool[:3, 3]
        target = int(targets_there[np.argmin(np.linalg.norm(away, axis=1))])
    else:
        target = setup.targets.index(pair.target)
    group = int(groups_there[0]) if pair.group is None else setup.groups.index(pair.group)
    frames, targets = np.full(len(q), group), np.full(len(q), target)
    chain = setup.chains(result.nominal, frames, targets)
    if chain is not None:
        samples = Samples(pair.of_all_joints(q), frames, targets, chain=chain)
    else:
        samples = replace(pair.actual.samples(q), frame=frames, target=targets)
    T_tip_tool = pair.actual.T_tip_tool if pair.target is None else None

    in_base = pair.group is None
    unknown = bool(unknown_base_directions(result, None if chain is None else ends.base))
    known = np.zeros((6, 6))
    number = 0 if chain is None else int(chain[0])
    base = unmodelled_base(result, part, number) if in_base and unknown else known
    # If no positions were measured, poses in the base are determined up to a rigid motion of the base.
    as_base = not result.rows.tells_place or (in_base and not unknown)
    gauge = known if result.rows.tells_place else None
    return (
        View(samples, None, as_base, gauge),
        View(samples, T_tip_tool, as_base, gauge),
        View(samples, T_tip_tool, in_base, base),
    )


def _on_link(links: tuple[str, ...], link: str, count: int) -> Integers:
    """Return the numbers of those, of a count, that are mounted on a link; of all if none is said to be elsewhere."""
    numbers = [k for k in range(count) if not links or links[k] == link]
    return np.array(numbers or range(count))


def _mean_errors(covariance: Array, lacking: Array) -> Array:
    """Return the mean distance [m] and angle [rad] of each pose from its wanted one, (N, 2).

    It is that of their covariances (N, 6, 6) and of mean squares of what the model lacks, (2,), [m^2], [rad^2].
    """
    blocks = np.stack([covariance[:, :3, :3], covariance[:, 3:, 3:]], axis=1)
    blocks = blocks + (lacking / 3.0)[:, None, None] * np.eye(3)
    trace = np.trace(blocks, axis1=2, axis2=3)
    square = np.sum(blocks**2, axis=(2, 3))
    freedom = np.maximum(trace**2 / np.maximum(square, np.finfo(np.float64).tiny), 1.0)
    return np.asarray(np.sqrt(trace / freedom) * mean_of_chi(freedom))


def _freedom(
    result: Calibration,
    arrived: PoseCovariance,
    lacking: float,
    held_out: CrossValidation | None,
) -> float:
    """Return the degrees of freedom of the mean square error over the program, a multiple of chi-squared.

    It is the sum of what the model lacks, s^2 (``lacking`` [m^2]), estimated from held-out rows, and of sum_k g_k z_k^2
    of the unknowns that the program's rows share, with standard normal z. The variances g are estimates as well: the
    part b that comes from the priors, whose standard deviations are estimated from as many errors as there are joints;
    and the rest, from the noise.

        n  =  (s^2 + sum g)^2 / (s^4 / rows + sum g^2 + b^2 / joints + (sum g - b)^2 / freedom of the noise)
    """
    rows = 1 if held_out is None else max(held_out.errors_without_outliers["m"].n, 1)
    shared = float(np.sum(arrived.shared))
    by_priors = min(arrived.by_priors, shared)
    spread = lacking**2 / rows + float(np.sum(arrived.shared**2))
    spread += (shared - by_priors) ** 2 / max(result.noise.freedom, 1.0)
    if result.method.prior_std_from == "data":
        spread += by_priors**2 / len(result.nominal.inputs)
    return (lacking + shared) ** 2 / spread if spread > 0.0 else np.inf


def mean_of_chi(freedom: ArrayLike) -> Array:
    """Return the mean of chi, sqrt(2) Gamma((n + 1) / 2) / Gamma(n / 2), with n > 0 degrees of freedom."""
    n = np.asarray(freedom, dtype=np.float64)
    return np.asarray(np.sqrt(2.0) * np.exp(gammaln(0.5 * (n + 1.0)) - gammaln(0.5 * n)))


def _contributions(
    lacking: float,
    near: float,
    target: PoseCovariance,
    tool: PoseCovariance,
    arrived: PoseCovariance,
) -> dict[Source, float]:
    """Split the mean square of the positions' errors [m^2] into contributions of all sources, none below 0.

    They are what the model lacks, ``lacking``; the target near the measured poses, ``near``; and, each as far as it
    exceeds the one before, the target at the program's poses, the tool there, and the tool in the program's frame; and,
    besides these, the scale of the instrument.
    """
    views = [float(view.mean_square[0]) - view.by_scale for view in (target, tool, arrived)]
    # A pose or tool that is known better than the one before it takes its share off the sources before.
    totals = np.minimum.accumulate([near, *views][::-1])[::-1]
    squares = [lacking, *np.diff(totals, prepend=0.0).tolist(), arrived.by_scale]
    sources: tuple[Source, ...] = ("model", "parameters", "poses", "tool", "base", "scale")
    return dict(zip(sources, squares, strict=True))


def _held_out(pair: Pair, result: Calibration, part: FittedModel) -> Errors | None:
    """Return errors of held-out rows without outliers, of several chains those of the commanded one; None: none."""
    ends = pair.nominal.robot
    for chain in result.trust.chains:
        if (chain.base, chain.tip) == (ends.base, ends.tip):
            return chain.calibrated
    return None if part.cross_validation is None else part.cross_validation.errors_without_outliers


def _lacking(
    result: Calibration, part: FittedModel, errors: Errors | None, predicted_angle: float
) -> Array:
    """Return mean squares of the errors that a model cannot describe, of positions [m^2] and angles [rad^2], (2,).

    They are 0 if the model was not cross-validated, so that there are no held-out errors (None), or if these are
    explained by noise and by the errors of its parameters; for angles the mean square of the latter is given, [rad^2].
    """
    if errors is None:
        return np.zeros(2)
    _, sigma, freedom = _instrument_noise(result)
    predicted = {"m": part.noise_measured**2, "rad": predicted_angle}
    channels = result.rows.channels.select(result.rows.estimation)
    lacking = []
    for unit in _POSE_UNITS:
        # The mean number of scalars of the fitted rows that measure any in this unit.
        counts = channels.where(unit).sum(axis=1)
        scalars = float(counts.sum()) / max(int(np.sum(counts > 0)), 1)
        rows, rms = errors[unit].n, errors[unit].rms
        excess = _beyond_noise(rows, rms, scalars, predicted[unit], sigma[unit], freedom[unit])
        lacking.append(excess)
    return np.array(lacking)


def _beyond_noise(
    rows: int, rms: float, scalars: float, predicted: float, sigma: float, freedom: float
) -> float:
    """Return the mean square of held-out errors beyond noise and prediction, three axes together; 0 if it is by chance.

    All are of positions ([m], squares [m^2]) or all of angles ([rad], [rad^2]); ``predicted`` is a mean square too.
    With the mean square v = rms^2 / scalars of a held-out scalar and u = predicted / 3 of its prediction by a fit of
    all rows, the leverage h of a row solves u = v h (1 - h), and v (1 - h) is the variance of the noise and of what the
    model lacks. The noise sigma of a scalar has degrees of freedom; one of NaN is not known and counts as error.
    """
    if not rows or not scalars or not rms:
        return 0.0
    u, v = predicted / 3.0, rms**2 / scalars
    if not np.isfinite(sigma):
        return 3.0 * max(v - u, 0.0)
    kept = 0.5 * (1.0 + float(np.sqrt(1.0 - 4.0 * min(u / v, _LARGEST_RATIO))))
    independent = rows * scalars * kept
    if np.isfinite(freedom):
        chance = float(fdtri(independent, freedom, 1.0 - _CHANCE))
    else:
        chance = float(chdtri(independent, _CHANCE)) / independent
    variance = v * kept
    return 3.0 * (variance - sigma**2) if variance > chance * sigma**2 else 0.0


def _instrument_noise(
    result: Calibration,
) -> tuple[NoiseSource, dict[str, float], dict[str, float]]:
    """Return the source of the noise of lengths, and its standard deviations and degrees of freedom by unit, m and rad.

    A standard deviation is of one scalar: as stated, with infinite degrees of freedom, unless it is far above the
    residuals; else from repeated rows, else NaN.
    """
    sigma = dict.fromkeys(_POSE_UNITS, np.nan)
    freedom = dict.fromkeys(_POSE_UNITS, 0.0)
    if result.noise.repeats is not None:
        for unit in _POSE_UNITS:
            freedom[unit] = result.noise.repeats.freedoms.get(unit, 0.0)
            if freedom[unit] >= _FEWEST_REPEATS:
                sigma[unit] = result.noise.repeats.within[unit]
    believed = []
    for unit, stated in result.noise.sigma_given.items():
        found = result.noise.sigma.get(unit, stated)
        # One that is far above that of the residuals is not believed, and the verdict says so. One that is too small is
        # harmless: what exceeds it counts as error that the model lacks, as it does if no noise is stated.
        if unit in _POSE_UNITS and stated < CONTRADICTED * found:
            sigma[unit] = stated
            freedom[unit] = np.inf
            believed.append(unit)
    source: NoiseSource = "stated" if "m" in believed else "repeats"
    if not np.isfinite(sigma["m"]):
        source = "unknown"
    return source, sigma, freedom

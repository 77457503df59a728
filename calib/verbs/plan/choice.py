"""Choice of the poses of a plan out of a pool of candidates, and what they will reach."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.basics.arguments import (
    check_flags,
    check_number,
    check_type,
    check_whole,
    finite_numbers,
    numbers,
)
from calib.basics.arrays import Array, read_only
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.errors import ModelError
from calib.model.observability import steps
from calib.verbs.plan.candidates import Pool
from calib.verbs.plan.forecast import Forecast, Workspace, information
from calib.verbs.plan.optimal import RESTARTS, Basis, Indices, choose, exchange, ranking, short_list
from calib.verbs.plan.sensitivity import Sensitivity

#: For more poses than this one random start is enough: many choices are as good.
_MANY = 100

#: Candidates for other numbers of poses: enough to show where more poses stop paying.
_LADDER_POOL = 2000

#: Draws of random poses, of which the median is shown.
_RANDOM = 9

#: Poses that differ by less than this in every joint are the same one [rad or m].
_SAME = 1e-3

#: Poses of a plan at most: exchanging thousands takes hours, and nothing is gained that random ones do not have.
MOST_POSES = 300

#: Other numbers of poses that are forecast, as shares of the plan's.
_RUNGS = (0.5, 0.67, 0.83, 1.0, 1.33, 1.67, 2.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest(Value):
    """Poses that are wanted of a plan."""

    #: Poses to fit.
    count: int = 30
    #: Poses to validate with, drawn at random from the same candidates.
    validation: int = 5
    #: ``"V"``: least mean variance of predicted positions; ``"D"``: largest determinant of the information; ``"A"``:
    #: least mean variance of the parameters, in squares of their steps.
    criterion: str = "V"
    #: Poses to choose from.
    candidates: int = 20_000
    #: Distance to the URDF's limits of joints that turn [rad]; sliding ones keep 5 mm, unless it is 0.
    margin: float = math.radians(5.0)
    #: shape (m,), the robot's joint values before the first move [rad] or [m]; None: it begins at any pose.
    start: ArrayLike | None = None
    #: Whether other numbers of poses, from half to three times ``count``, are forecast too.
    ladder: bool = True
    #: The same seed makes the same plan.
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values of another type, and numbers that are none."""
        for name in ("count", "validation", "candidates"):  # how many is checked in `check`
            check_type(name, getattr(self, name), (int, np.integer), "a whole number")
        check_whole("seed", self.seed, 0)
        check_type("criterion", self.criterion, str, "'V', 'D' or 'A'")
        check_number("margin", self.margin, 0.0)
        check_flags(ladder=self.ladder)
        if self.start is not None:
            start = numbers("start", self.start, "joint values of shape (m,), [rad] or [m]")
            finite_numbers("start", start.ravel(), (None,), "finite joint values")

    def check(self, candidates: int) -> None:
        """Refuse an unknown criterion, and numbers of poses that cannot be had.

        Uses ``criterion`` (``"V"``, ``"D"`` or ``"A"``); ``count``, the poses to fit, 1 or more; and ``validation``,
        the poses to validate with, 0 or more. Together they must be no more than the candidates, or 300.

        Args:
            candidates: Number of poses that can be measured, to choose from.

        Raises:
            ModelError: The request cannot be met.
        """
        if self.criterion not in ("V", "D", "A"):
            raise ModelError(f"There is no criterion '{self.criterion}'. Choose V, D or A.")
        total = self.count + self.validation
        most = min(candidates, MOST_POSES)
        if self.count < 1 or self.validation < 0 or total > most:
            raise ModelError(
                f"{self.count} poses and {self.validation} validation poses were asked for, of "
                f"{candidates} candidates that can be measured; it takes 1 pose or more and {most} "
                "or fewer in all. Draw more candidates, ask for fewer poses, or drop a condition."
            )


class Choice(NamedTuple):
    """Poses that were chosen out of a pool, as `calib.verbs.plan.plan.Plan` has them."""

    #: Shape (count, m), poses to fit, [rad] or [m].
    planned: Array
    #: Shape (validation, m), poses to validate with, [rad] or [m].
    validation: Array
    #: Forecast of a fit of the poses taken and planned.
    forecast: Forecast
    #: Forecast of a fit of the poses taken alone; None where none are taken.
    before: Forecast | None
    #: Forecast of the poses taken and as many random ones as are planned: the median of several draws.
    at_random: Forecast
    #: Numbers of planned poses in rising order, and the forecast for each.
    ladder: tuple[tuple[int, Forecast], ...]


def choose_poses(
    sensitivity: Sensitivity,
    pool: Pool,
    request: PlanRequest,
    taken: Array | None = None,
    *,
    restarts: int = RESTARTS,
    progress: Progress | None = None,
) -> Choice:
    """Choose the poses of a plan from candidates, and forecast what a fit of them will reach.

    Args:
        sensitivity: The nominal robot in its cell under the error model of the fit: differentiates what is measured at
            joint values by the parameters.
        pool: The candidates: ``q``, joint values that can be measured, shape (n, m), [rad] or for sliding joints [m];
            and ``workspace``, shape (k, m), those over which accuracy counts.
        request: ``count`` and ``validation``, the numbers of poses to fit and to validate with; ``criterion`` of the
            choice, ``"V"``, ``"D"`` or ``"A"``; ``ladder``, whether other numbers of poses are forecast; ``seed``.
        taken: Poses that are measured already, shape (T, m), [rad] or [m]: they count in the information, and are not
            planned again; None: none are.
        restarts: Number of random starts of the exchange, for up to 100 poses; of more, there is one start.
        progress: Called with the number of forecasts of the ladder that are done, and of all; None: nothing is called.

    Returns:
        ``planned``, joint values of the poses to fit, shape (count, m), and of those to ``validation``, shape
        (validation, m), drawn at random from the other candidates, [rad] or [m]. ``forecast`` of a fit of the poses
        taken and planned; for comparison ``before``, of those taken alone (None without any), ``at_random``, with
        random candidates in place of the planned poses, and ``ladder``, by the number of planned poses.

    Raises:
        ModelError: Too few poses for the model, or a request that cannot be met.
    """
    if taken is None:
        taken = pool.q[:0]
    q = _not_taken(pool.q, taken)
    request.check(len(q))
    search = _Search.of(sensitivity, pool, q, taken, request.criterion)
    if request.count < search.fewest_poses:
        _refuse_too_few(search, request.count)
    chosen = search.best(request, restarts)
    planned = search.forecast(chosen)
    ladder = _ladder(search, request, planned, progress)
    rng = np.random.default_rng([request.seed, 1])
    others = rng.permutation(np.setdiff1d(np.arange(len(q)), chosen))
    return Choice(
        planned=read_only(q[chosen]),
        validation=read_only(q[others[: request.validation]]),
        forecast=planned,
        before=search.forecast(chosen[:0]) if len(taken) else None,
        at_random=_median_at_random(search, request.count, rng),
        ladder=ladder,
    )


def _not_taken(q: Array, taken: Array) -> Array:
    """Return the candidates that are none of the poses measured already.

    A candidate within 1e-3 rad or m of a pose in every joint is that pose. Differences are taken modulo 2 pi, also
    those of sliding joints.

    Args:
        q: Joint values of the candidates, shape (n, m), [rad] or for sliding joints [m].
        taken: Joint values of the poses measured already, shape (T, m), [rad] or [m]; T may be 0.

    Returns:
        The other candidates, shape (n or fewer, m), in the same order.
    """
    repeated = np.zeros(len(q), dtype=np.bool_)
    for pose in taken:
        gap = np.remainder(q - pose + np.pi, 2.0 * np.pi) - np.pi
        repeated |= np.all(np.abs(gap) < _SAME, axis=1)
    return q[~repeated]


def _median_at_random(search: _Search, count: int, rng: np.random.Generator) -> Forecast:
    """Forecast fits of the poses taken and random candidates nine times, and return the forecast with the median rms.

    It shows what the choice of the poses gains.

    Args:
        search: ``q``, joint values of the n candidates, shape (n, m), [rad] or [m]; and the poses taken, which each
            forecast includes.
        count: Number of different candidates of each draw.
        rng: Draws the candidates; its state advances.

    Returns:
        The forecast whose ``rms``, expected error of a predicted position over the workspace [m], is the fifth of nine.
    """
    forecasts = []
    for _ in range(_RANDOM):
        drawn = rng.choice(len(search.q), count, replace=False)
        forecasts.append(search.forecast(drawn))
    forecasts.sort(key=lambda forecast: forecast.rms)
    return forecasts[_RANDOM // 2]


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Candidates, differentiated and along a basis, ready to be chosen from."""

    #: The nominal robot in its cell under the error model of the fit.
    sensitivity: Sensitivity
    #: Poses over which accuracy counts.
    workspace: Workspace
    #: Shape (n, m), the candidates [rad] or [m].
    q: Array
    #: Shape (T, m), poses measured already [rad] or [m].
    taken: Array
    #: Shape (n, d, r), whitened derivatives at the candidates of the d scalars measured, along the basis.
    blocks: Array
    #: Directions of the parameters that the candidates can tell apart, r of them.
    basis: Basis
    #: Shape (n,), `ranking` of the candidates.
    rank: Array

    @classmethod
    def of(
        cls,
        sensitivity: Sensitivity,
        pool: Pool,
        q: Array,
        taken: Array,
        criterion: str,
    ) -> _Search:
        """Differentiate what is measured at candidates, and find the basis of a criterion.

        Args:
            sensitivity: The nominal robot in its cell under the error model of the fit, with p parameters;
                ``precision``, shape (p,), is 1 / tau^2 of their priors.
            pool: ``pool.workspace``, joint values of the poses over which accuracy counts, shape (k, m), [rad] or [m].
            q: Joint values of the n candidates, shape (n, m), [rad] or for sliding joints [m].
            taken: Joint values of poses measured already, shape (T, m), [rad] or [m]; T may be 0.
            criterion: ``"V"``, least mean variance of predicted positions; ``"D"``, largest determinant of the
                information; ``"A"``, least variances of the parameters.

        Returns:
            The candidates with their derivatives along the basis, ``blocks``, shape (n, d, r), whitened by the noise,
            and their `ranking`. The information of the priors and of the poses taken is that known before.
        """
        measured = sensitivity.measured(q)
        # Images are measured only where the camera sees the board.
        optical = registry.get(sensitivity.kind).optical
        workspace = Workspace.of(sensitivity, pool.workspace, pool.q if optical else None)
        known = np.diag(sensitivity.precision)
        if len(taken):
            known += information(sensitivity.measured(taken))
        weight = _weight(criterion, sensitivity, workspace)
        basis = Basis.of(information(measured) / len(measured), known, weight)
        blocks = measured @ basis.directions
        rank = ranking(blocks, basis)
        return cls(sensitivity, workspace, q, taken, blocks, basis, rank)

    @property
    def fewest_poses(self) -> int:
        """Fewest poses, besides those taken, that measure as many scalars as parameters are identifiable; at least 1.

        Uses ``workspace.rank``, the number of parameters or combinations that all of the workspace determines;
        ``blocks``, shape (n, d, r), of which d is the number of scalars measured at a pose; and ``taken``, shape
        (T, m), poses measured already.
        """
        scalars: int = self.blocks.shape[1]
        needed = -(-self.workspace.rank // scalars)
        return max(1, needed - len(self.taken))

    def best(self, request: PlanRequest, restarts: int) -> Indices:
        """Choose the best candidates that are found, by the criterion of the basis.

        Uses ``blocks``, whitened derivatives of the d scalars measured at each of n candidates along the r directions
        of ``basis``, shape (n, d, r); and ``rank``, the `ranking` of the candidates, shape (n,).

        Args:
            request: ``request.count``, the number of poses to fit, and ``request.seed`` of the random starts.
            restarts: Number of random starts, for up to 100 poses; of more, there is one start.

        Returns:
            Shape (count,), indices of the candidates in ``q``, from 0, all different.
        """
        if request.count > _MANY:
            restarts = 1
        return choose(self.blocks, self.basis, request.count, request.seed, restarts, self.rank)

    def forecast(self, indices: Indices) -> Forecast:
        """Forecast a fit of measurements at the poses taken and at some candidates.

        Uses ``taken``, poses measured already, shape (T, m), and the candidates ``q``, shape (n, m), [rad] or [m];
        ``sensitivity``, the robot under the error model of the fit; and ``workspace``, the poses over which accuracy
        counts.

        Args:
            indices: Shape (K,), indices of candidates in ``q``, from 0; empty: the poses taken alone.

        Returns:
            Expected accuracy of a fit of all T + K poses.
        """
        q = np.concatenate([self.taken, self.q[indices]])
        return Forecast.of(self.sensitivity, self.workspace, q)


def _weight(criterion: str, sensitivity: Sensitivity, workspace: Workspace) -> Array | None:
    """Return the matrix T of a criterion tr(T C), with the covariance C of the p parameters.

    Args:
        criterion: ``"A"``: tr(T C) is the sum of the variances of the parameters, each in squares of the step of its
            unit, such as 1 mm or 1 mrad; ``"V"``: the mean variance of a predicted position over the workspace;
            ``"D"``: the determinant, which has no such matrix.
        sensitivity: ``sensitivity.units``, the units of the parameters.
        workspace: ``workspace.located``, derivative J of the positions (x, y, z) of the k targets at n poses by the
            parameters, shape (n, 3 k, p), [m per unit of the parameter].

    Returns:
        Shape (p, p): 1 / step^2 on the diagonal for ``A``, [1/unit^2]; for ``V`` the mean of J^T J over the n k
        positions, J of each of shape (3, p), [m^2 per product of units], so that all three coordinates add up; None for
        ``D``.
    """
    if criterion == "D":
        return None
    if criterion == "A":
        return np.diag(1.0 / steps(sensitivity.units) ** 2)
    # The mean over poses and targets of J^T J.
    positions = workspace.located[:, :, 0].size // 3
    return information(workspace.located) / positions


def _refuse_too_few(search: _Search, count: int) -> None:
    """Raise the error that the model has more identifiable parameters than scalars are measured.

    Args:
        search: ``taken``, the poses measured already, shape (T, m); ``blocks``, shape (n, d, r), of which d is the
            number of scalars measured at a pose; and, for the message, the model's name, the number of identifiable
            parameters and the fewest poses.
        count: Number of poses that were wanted besides those taken.

    Raises:
        ModelError: Always.
    """
    taken = len(search.taken)
    numbers = search.blocks.shape[1] * (count + taken)
    before = f" with the {taken} measured already" if taken else ""
    raise ModelError(
        f"{count} poses give {numbers} numbers{before}, and the model "
        f"'{search.sensitivity.kinematics.model.name}' has {search.workspace.rank} identifiable "
        f"parameters: at least {search.fewest_poses} poses are needed, twice as many are better. Ask for more "
        "poses, or choose a smaller --model."
    )


def _rungs(request: PlanRequest, fewest: int, candidates: int) -> list[int]:
    """Return the numbers of poses that are forecast, in rising order, that of the plan among them.

    Args:
        request: ``request.count``, the number of poses of the plan, and ``request.ladder``, whether others are
            forecast.
        fewest: Least number that determines the parameters; smaller ones are left out.
        candidates: Number of poses to choose from; larger numbers are left out, and those above 300.

    Returns:
        0.5, 0.67, 0.83, 1, 1.33, 1.67, 2 and 3 times the plan's number, rounded, each once; empty where
        ``request.ladder`` is False.
    """
    if not request.ladder:
        return []
    numbers = {request.count, *(round(share * request.count) for share in _RUNGS)}
    most = min(candidates, MOST_POSES)
    return sorted(n for n in numbers if fewest <= n <= most)


def _ladder(
    search: _Search,
    request: PlanRequest,
    planned: Forecast,
    progress: Progress | None,
) -> tuple[tuple[int, Forecast], ...]:
    """Forecast other numbers of poses than the plan's, to show where more poses stop paying.

    Each design is the one before it (the plan's aside) with more poses, exchanged again within the 2000 candidates that
    `ranking` puts first.

    Args:
        search: The n candidates, with ``blocks``, their whitened derivatives along the r directions of ``basis``, shape
            (n, d, r), and ``rank``, their `ranking`, shape (n,); and the poses taken.
        request: ``request.count``, the number of poses of the plan, and ``request.ladder``, whether others are
            forecast.
        planned: Forecast of the plan itself.
        progress: Called with the number of forecasts done and of all; None: nothing is called.

    Returns:
        Numbers of poses besides those taken, in rising order, that of the plan among them, and the forecast for each;
        empty where ``request.ladder`` is False.
    """
    rungs = _rungs(request, search.fewest_poses, len(search.q))
    short = short_list(search.rank, max(_LADDER_POOL, *rungs, 0))
    few = search.blocks[short]
    design = np.zeros(0, dtype=np.int_)
    ladder: list[tuple[int, Forecast]] = []
    for number in rungs:
        if number == request.count:
            ladder.append((number, planned))
        else:
            design, _ = exchange(few, search.basis, design, number)
            ladder.append((number, search.forecast(short[design])))
        if progress is not None:
            progress(len(ladder), len(rungs))
    return tuple(ladder)

"""Choice of the poses of a plan out of a pool of candidates, and what they will reach."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.design.candidates import Pool
from calib.design.forecast import Forecast, Workspace, information
from calib.design.optimal import RESTARTS, Basis, Indices, choose, exchange, ranking, short_list
from calib.design.sensitivity import Sensitivity
from calib.errors import ModelError
from calib.jobs import Progress
from calib.model.observability import steps
from calib.robot.robot import read_only
from calib.units import Array

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
class PlanRequest:
    """Poses that are wanted of a plan."""

    #: Poses to fit.
    count: int = 30
    #: Poses to validate with, drawn at random from the same candidates.
    validation: int = 5
    #: ``"V"``: least mean variance of predicted positions; ``"D"``: largest determinant of the information; ``"A"``:
    #: least mean variance of the parameters.
    criterion: str = "V"
    #: Poses to choose from.
    candidates: int = 20_000
    #: Distance to the joint limits of the URDF [rad].
    margin: float = math.radians(5.0)
    #: shape (m,), the robot's joint values before the first move [rad] or [m]; None: it begins at any pose.
    start: ArrayLike | None = None
    #: Whether other numbers of poses, from half to three times ``count``, are forecast too.
    ladder: bool = True
    #: The same seed makes the same plan.
    seed: int = 0

    def check(self, candidates: int) -> None:
        """Refuse an unknown criterion, and numbers of poses that cannot be.

        Args:
            candidates: Number of poses that can be measured.

        Raises:
            ModelError: It cannot be met.
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
    """Poses that were chosen out of a pool, as `calib.design.plan.Plan` has them."""

    #: Shape (count, m), to fit.
    planned: Array
    #: Shape (validation, m).
    validation: Array
    #: Of poses taken and planned.
    forecast: Forecast
    #: Of the poses taken alone; None without.
    before: Forecast | None
    #: Of as many random poses: the median of several draws.
    at_random: Forecast
    #: Of other numbers of poses.
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
    """Choose poses from a pool of candidates.

    Args:
        sensitivity: The robot in its cell.
        pool: The candidates.
        request: Poses that are wanted.
        taken: shape (T, m), poses measured already; they count, and are not planned again.
        restarts: Random starts of the exchange; one in place of several is a few percent worse.
        progress: Called with the forecasts of the ladder done and all.

    Returns:
        The choice.

    Raises:
        ModelError: Too few poses for the model, or a request that cannot be met.
    """
    if taken is None:
        taken = pool.q[:0]
    q = _not_taken(pool.q, taken)
    request.check(len(q))
    search = _Search.of(sensitivity, pool, q, taken, request.criterion)
    fewest = search.fewest_poses
    if request.count < fewest:
        _refuse_too_few(search, request.count, fewest)
    restarts = restarts if request.count <= _MANY else 1
    chosen = choose(search.blocks, search.basis, request.count, request.seed, restarts, search.rank)
    rng = np.random.default_rng([request.seed, 1])
    others = rng.permutation(np.setdiff1d(np.arange(len(q)), chosen))
    plan = search.forecast(chosen)
    rungs = _rungs(request, fewest, len(q))
    ladder = _ladder(search, rungs, request.count, plan, progress)
    draws = [
        search.forecast(rng.choice(len(q), request.count, replace=False)) for _ in range(_RANDOM)
    ]
    draws.sort(key=lambda forecast: forecast.rms)
    return Choice(
        planned=read_only(q[chosen]),
        validation=read_only(q[others[: request.validation]]),
        forecast=plan,
        before=search.forecast(chosen[:0]) if len(taken) else None,
        at_random=draws[_RANDOM // 2],
        ladder=ladder,
    )


def _not_taken(q: Array, taken: Array) -> Array:
    """Return the candidates that are none of the poses measured already, whole turns of joints aside."""
    repeated = np.zeros(len(q), dtype=np.bool_)
    for pose in taken:
        gap = np.remainder(q - pose + np.pi, 2.0 * np.pi) - np.pi
        repeated |= np.all(np.abs(gap) < _SAME, axis=1)
    return q[~repeated]


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Candidates, differentiated and along a basis, ready to be chosen from."""

    sensitivity: Sensitivity
    #: Where accuracy counts
    workspace: Workspace
    #: (n, m), the candidates [rad] or [m]
    q: Array
    #: (T, m), poses measured already
    taken: Array
    #: (n, d, r), their whitened derivatives along the basis
    blocks: Array
    basis: Basis
    #: (n,), `ranking` of the candidates
    rank: Array

    @classmethod
    def of(
        cls, sensitivity: Sensitivity, pool: Pool, q: Array, taken: Array, criterion: str
    ) -> _Search:
        """Differentiate candidates and find the basis of a criterion."""
        measured = sensitivity.measured(q)
        workspace = Workspace.of(sensitivity, pool.workspace)
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
        """Number of poses that is needed for the rank of the workspace, besides those taken; at least 1."""
        scalars: int = self.blocks.shape[1]
        needed = -(-self.workspace.rank // scalars)
        return max(1, needed - len(self.taken))

    def forecast(self, indices: Indices) -> Forecast:
        """Forecast a fit of the poses taken and some candidates."""
        q = np.concatenate([self.taken, self.q[indices]])
        return Forecast.of(self.sensitivity, self.workspace, q)


def _weight(criterion: str, sensitivity: Sensitivity, workspace: Workspace) -> Array | None:
    """Return W or B of a criterion, shape (p, p); None for ``D``."""
    if criterion == "D":
        return None
    if criterion == "A":
        return np.diag(1.0 / steps(sensitivity.units) ** 2)
    # The mean over poses and targets of J^T J.
    positions = workspace.located[:, :, 0].size // 3
    return information(workspace.located) / positions


def _refuse_too_few(search: _Search, count: int, fewest: int) -> None:
    """Raise the error that the model has more parameters than the poses give numbers."""
    taken = len(search.taken)
    numbers = search.blocks.shape[1] * (count + taken)
    before = f" with the {taken} measured already" if taken else ""
    raise ModelError(
        f"{count} poses give {numbers} numbers{before}, and the model "
        f"'{search.sensitivity.kinematics.model.name}' has {search.workspace.rank} identifiable "
        f"parameters: at least {fewest} poses are needed, twice as many are better. Ask for more "
        "poses, or choose a smaller --model."
    )


def _rungs(request: PlanRequest, fewest: int, candidates: int) -> list[int]:
    """Return the numbers of poses that are forecast, in rising order, that of the plan among them."""
    if not request.ladder:
        return []
    numbers = {request.count, *(round(share * request.count) for share in _RUNGS)}
    most = min(candidates, MOST_POSES)
    return sorted(n for n in numbers if fewest <= n <= most)


def _ladder(
    search: _Search, rungs: list[int], count: int, plan: Forecast, progress: Progress | None
) -> tuple[tuple[int, Forecast], ...]:
    """Forecast other numbers of poses; each design starts from the one before it.

    Args:
        search: The candidates.
        rungs: The numbers, in rising order.
        count: That of the plan.
        plan: Its forecast.
        progress: Called with the forecasts done and all.
    """
    short = short_list(search.rank, max(_LADDER_POOL, *rungs, 0))
    few = search.blocks[short]
    design = np.zeros(0, dtype=np.int_)
    ladder: list[tuple[int, Forecast]] = []
    for number in rungs:
        if number == count:
            ladder.append((number, plan))
        else:
            design, _ = exchange(few, search.basis, design, number)
            ladder.append((number, search.forecast(short[design])))
        if progress is not None:
            progress(len(ladder), len(rungs))
    return tuple(ladder)

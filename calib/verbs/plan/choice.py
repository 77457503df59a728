"""Choice of the poses of a plan from a pool of candidates, and the accuracy that they will reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import (
    check_flags,
    check_number,
    check_type,
    check_whole,
    finite_numbers,
    numbers,
)
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.errors import ModelError
from calib.instruments.camera import USUAL_LIMITS, SightLimits
from calib.instruments.instrument import Instrument
from calib.model.observability import steps
from calib.numerics.moves import last_moves
from calib.verbs.plan.approach import SIDES, visits
from calib.verbs.plan.forecast import Forecast, Workspace, information
from calib.verbs.plan.optimal import RESTARTS, Basis, Indices, choose, exchange, ranking, short_list
from calib.verbs.plan.pose_candidates import Pool, drawing_of
from calib.verbs.plan.sensitivity import Sensitivity

#: Number of poses above which one random start is enough: many choices are equally good.
_MANY = 100

#: Number of candidates for other numbers of poses: enough to show from where on more poses hardly help.
_LADDER_POOL = 2000

#: Number of draws of random poses, whose median is shown.
_RANDOM = 9

#: Poses that differ by less than this in every joint are the same one [rad or m].
_SAME = 1e-3

#: Largest number of poses of a plan: exchanging thousands takes hours, and gains nothing over random ones.
MOST_POSES = 300

#: Other numbers of poses that are forecast, as shares of the plan's.
_RUNGS = (0.5, 0.67, 0.83, 1.0, 1.33, 1.67, 2.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest(Value):
    """Poses that are wanted of a plan."""

    #: Number of poses to fit.
    count: int = 30
    #: Number of poses to validate with, drawn at random from the same candidates.
    validation: int = 5
    #: ``"V"``: least mean variance of predicted positions; ``"D"``: largest determinant of the information; ``"A"``:
    #: least mean variance of the parameters, in squares of their steps.
    criterion: str = "V"
    #: Number of poses to choose from; None: 20000, or 600 for images.
    candidates: int | None = None
    #: Distance to the URDF's limits of joints that turn [rad]; sliding ones keep 5 mm, unless it is 0.
    margin: float = math.radians(5.0)
    #: shape (m,), the robot's joint values before the first move [rad] or [m]; None: any pose may be the first.
    start: ArrayLike | None = None
    #: Whether other numbers of poses, from half to three times ``count``, are forecast too.
    ladder: bool = True
    #: How poses are approached: ``"straight"``, from the pose before; ``"one"``, with every joint rising; ``"both"``:
    #: each pose is measured twice, once with every joint rising and once falling.
    approach: str = "straight"
    #: The same seed makes the same plan.
    seed: int = 0
    #: For images: where the board may be in the camera.
    sight: SightLimits = USUAL_LIMITS

    def __post_init__(self) -> None:
        """Refuse values of another type, and numbers that are not finite or are negative: `CalibError`."""
        for name in ("count", "validation"):  # how many is checked in `check`
            check_type(name, getattr(self, name), (int, np.integer), "a whole number")
        whole_or_none = (int, np.integer, type(None))
        check_type("candidates", self.candidates, whole_or_none, "a whole number, or None")
        check_whole("seed", self.seed, 0)
        check_type("criterion", self.criterion, str, "'V', 'D' or 'A'")
        check_type("approach", self.approach, str, "'straight', 'one' or 'both'")
        check_number("margin", self.margin, 0.0)
        check_flags(ladder=self.ladder)
        check_type("sight", self.sight, SightLimits, "SightLimits")
        if self.start is not None:
            start = numbers("start", self.start, "joint values of shape (m,), [rad] or [m]")
            finite_numbers("start", start.ravel(), (None,), "finite joint values")

    def complete(self, instrument: Instrument) -> PlanRequest:
        """Return the request with the number of candidates that is enough for an instrument, if it has none."""
        enough = drawing_of(instrument).enough if self.candidates is None else self.candidates
        self.check(enough)
        return replace(self, candidates=enough)

    def check(self, candidates: int) -> None:
        """Raise `ModelError` for an unknown criterion or approach, no pose, or more than candidates or `MOST_POSES`."""
        if self.criterion not in ("V", "D", "A"):
            raise ModelError(f"There is no criterion '{self.criterion}'. Choose V, D or A.")
        if self.approach not in SIDES:
            raise ModelError(
                f"There is no approach '{self.approach}'. Choose straight, one (side) or both (sides)."
            )
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
    #: Forecast of a fit of the poses taken alone; None if none are taken.
    before: Forecast | None
    #: Forecast of the poses taken and as many random ones as are planned: the median of several draws.
    at_random: Forecast
    #: Numbers of planned poses in rising order, and the forecast for each.
    ladder: tuple[tuple[int, Forecast], ...]
    #: The poses over which accuracy is forecast.
    workspace: Workspace
    #: Shape (count + validation, v), which views measure at the poses to fit, then at those to validate with; None:
    #: all.
    seen: Mask | None = None


def choose_poses(
    sensitivity: Sensitivity,
    pool: Pool,
    request: PlanRequest,
    taken: Array | None = None,
    *,
    taken_moves: Array | None = None,
    taken_seen: Mask | None = None,
    sides: Array | None = None,
    progress: Progress | None = None,
) -> Choice:
    """Choose the poses of a plan from candidates, and forecast what a fit of them will reach.

    Args:
        sensitivity: The nominal robot in its cell under the error model of the fit.
        pool: The candidates.
        request: Numbers of poses, criterion and seed.
        taken: Poses that are measured already, shape (T, m), [rad] or [m]: they count in the information, and are not
            planned again; None: none are.
        taken_moves: Last move of each joint before each of these, shape (T, m), [rad] or [m]; None: from the pose
            before.
        taken_seen: Which of the v views measured at each of these, shape (T, v); None: all.
        sides: Moves by which the joints arrive at each pose, shape (s, m), see `calib.verbs.plan.approach.approaches`;
            None: straight from the pose before.
        progress: Called with the number of forecasts of the ladder that are done, and of all; None: nothing is called.

    Returns:
        The poses, those to validate with drawn at random from the other candidates, and the forecasts.

    Raises:
        ModelError: Too few poses for the model, or a request that cannot be met.
    """
    if taken is None:
        taken = pool.q[:0]
    if taken_moves is None:
        taken_moves = last_moves(taken)
    if sides is None:
        sides = pool.q[:0]
    # The candidates that differ from all poses measured already in some joint.
    repeated = np.zeros(len(pool.q), dtype=np.bool_)
    for pose in taken:
        gap = np.remainder(pool.q - pose + np.pi, 2.0 * np.pi) - np.pi  # of sliding joints too
        repeated |= np.all(np.abs(gap) < _SAME, axis=1)
    q = pool.q[~repeated]
    request.check(len(q))
    seen = None
    if pool.seen is not None:
        seen = pool.seen[~repeated]
        if taken_seen is None:
            taken_seen = np.ones((len(taken), seen.shape[1]), dtype=np.bool_)

    def seen_at(indices: Indices | slice) -> Mask | None:
        """Return what is seen at the visits of some candidates; None if there is one view."""
        return None if seen is None else np.repeat(seen[indices], max(len(sides), 1), axis=0)

    # What all visits of a pose measure, (n, s d, p).
    measured = sensitivity.measured(*visits(q, sides), seen_at(slice(None)))
    measured = measured.reshape(len(q), -1, len(sensitivity.names))
    workspace = Workspace.of(sensitivity, pool.workspace, pool.measurable, pool.seen)
    known = np.diag(sensitivity.precision)
    if len(taken):
        known += information(sensitivity.measured(taken, taken_moves, taken_seen))
    weight = _weight(request.criterion, sensitivity, workspace)
    basis = Basis.of(information(measured) / len(measured), known, weight)
    blocks = measured @ basis.directions
    rank = ranking(blocks, basis)
    per_pose = blocks.shape[1]
    if seen is not None:  # at the pose at which most is measured
        per_pose = int(np.any(measured != 0.0, axis=2).sum(axis=1).max())
    fewest = max(1, -(-workspace.rank // per_pose) - len(taken))
    if request.count < fewest:
        numbers = per_pose * (request.count + len(taken))
        before = f" with the {len(taken)} measured already" if len(taken) else ""
        raise ModelError(
            f"{request.count} poses give {numbers} numbers{before}, and the model "
            f"'{sensitivity.kinematics.model.name}' has {workspace.rank} identifiable "
            f"parameters: at least {fewest} poses are needed, twice as many are better. Ask for more "
            "poses, or choose a smaller --model."
        )

    def forecast(indices: Indices) -> Forecast:
        """Forecast a fit of the poses taken and of some candidates."""
        joints, moves = visits(q[indices], sides)
        joints = np.concatenate([taken, joints])
        moves = np.concatenate([taken_moves, moves])
        seen_there = seen_at(indices)
        if seen_there is not None and taken_seen is not None:
            seen_there = np.concatenate([taken_seen, seen_there])
        return Forecast.of(sensitivity, workspace, joints, moves, seen_there)

    restarts = 1 if request.count > _MANY else RESTARTS
    chosen = choose(blocks, basis, request.count, request.seed, restarts, rank)
    planned = forecast(chosen)

    # Other numbers of poses show from where on more hardly help. Each design is the one before it (except the plan's)
    # with more poses, exchanged again among the candidates that matter most.
    rungs: list[int] = []
    if request.ladder:
        numbers_of_poses = {request.count, *(round(share * request.count) for share in _RUNGS)}
        most = min(len(q), MOST_POSES)
        rungs = sorted(number for number in numbers_of_poses if fewest <= number <= most)
    short = short_list(rank, max(_LADDER_POOL, *rungs, 0))
    few = blocks[short]
    design = np.zeros(0, dtype=np.int_)
    ladder: list[tuple[int, Forecast]] = []
    for number in rungs:
        if number == request.count:
            ladder.append((number, planned))
        else:
            design, _ = exchange(few, basis, design, number)
            ladder.append((number, forecast(short[design])))
        if progress is not None:
            progress(len(ladder), len(rungs))

    rng = np.random.default_rng([request.seed, 1])
    others = rng.permutation(np.setdiff1d(np.arange(len(q)), chosen))
    draws = [rng.choice(len(q), request.count, replace=False) for _ in range(_RANDOM)]
    at_random = sorted(map(forecast, draws), key=lambda drawn: drawn.rms)
    validation = others[: request.validation]
    return Choice(
        planned=read_only(q[chosen]),
        validation=read_only(q[validation]),
        forecast=planned,
        before=forecast(chosen[:0]) if len(taken) else None,
        at_random=at_random[_RANDOM // 2],
        ladder=tuple(ladder),
        workspace=workspace,
        seen=None if seen is None else seen[[*chosen, *validation]],
    )


def _weight(criterion: str, sensitivity: Sensitivity, workspace: Workspace) -> Array | None:
    """Return the matrix T (p, p) of a criterion tr(T C), C the covariance; None for ``D``, the determinant of C^-1.

    ``A``: 1 / step^2 on the diagonal, with the steps of the parameters' units, such as 1 mm. ``V``: the mean of J^T J
    over the positions of all targets and poses, J (3, p) their derivative.
    """
    if criterion == "D":
        return None
    if criterion == "A":
        return np.diag(1.0 / steps(sensitivity.units) ** 2)
    return workspace.mean_square

"""Poses to check at: those among many reachable ones that tell the causes apart best.

A set of poses is worth the mean probability that the true cause would get there, against the other causes and against
"nothing", over drawn displacements of every cause that show `_SHOWN` standard deviations at a pose. The set is the best
of some drawn at random, then improved pose by pose. Further poses, after a check that could not decide, are worth the
same over what it left possible: displacements are drawn from the posterior of the causes that it named, and one pose
after the other is added.

Poses are within the joint values that the result was fitted to, where its model holds, and free of collision if the
robot's shapes are known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from calib.basics.arguments import check_path, check_type, check_whole
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.jobs import one_blas_thread
from calib.basics.values import Value
from calib.data.cell import Cell
from calib.data.cell_chains import Sight
from calib.data.columns import DEFAULT_TARGET, SETS
from calib.data.inputs import CellInput, cell_of
from calib.errors import ModelError, UrdfError
from calib.fit.registration.table_rows import rows_and_setup
from calib.instruments.instrument import Condition, Sightline
from calib.numerics.moves import last_moves
from calib.result.calibration_file import ResultInput, result_of
from calib.result.chain_of_result import with_chain_of_result
from calib.robot.robot import Robot
from calib.verbs.check.causes import MOVING, Cause, causes_of, moving_causes
from calib.verbs.check.check import SURE, CheckResult
from calib.verbs.check.evidence import estimate, log_weights
from calib.verbs.check.innovations import Stop, StoredResult, stacked
from calib.verbs.plan.bodies import collision_model, free_lines_of_sight
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.plan_file import plan_rows
from calib.verbs.plan.pose_candidates import draw, draw_towards, planning_ranges
from calib.verbs.plan.sensitivity import Sensitivity, View

#: What a drawn displacement shows at a pose, in standard deviations of a number.
_SHOWN = 4.0

#: Draws of each cause's displacement.
_DRAWS = 16

#: Candidates, sets drawn at random, and candidates that are tried in place of each pose of the best.
_CANDIDATES = 200
_SETS = 60
_TRIED = 60

#: Further poses are enough if they decide with this probability.
_ENOUGH = 0.9

#: The most further poses that are sought.
MOST = 3


@dataclass(frozen=True, slots=True, eq=False)
class CheckPoses(Value):
    """Poses to check at."""

    #: Shape (k, m), joint values [rad] or [m], in the order to drive
    joints: Array
    #: Probability that the true cause would get on average, with displacements that show well; or of further poses
    #: that one cause is sure after 1, 2, ... of them
    probabilities: tuple[float, ...]
    #: Whether they are known to be free of collision of the robot's own shapes
    collisions_checked: bool
    #: The model of the robot with its instrument, by which they are written
    sensitivity: Sensitivity

    @property
    def needed(self) -> int | None:
        """Number of further poses that decide with 90 %; None: more than there are."""
        for count, probability in enumerate(self.probabilities, start=1):
            if probability >= _ENOUGH:
                return count
        return None

    def write(self, path: str | Path, *, overwrite: bool = False, first_row: int = 1) -> Path:
        """Write the poses as a table to be filled in, as ``calib plan`` writes it.

        Args:
            path: The file.
            overwrite: Whether an existing file is replaced.
            first_row: Number of the first row or image.

        Returns:
            The path of the file.

        Raises:
            ArgumentError: The path is of another type.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        rows = list(
            plan_rows(self.sensitivity.instrument, _Sheet(self.sensitivity, self.joints), first_row)
        )
        header = list(rows[0])
        table = [header, *([row.get(name, "") for name in header] for row in rows)]
        return write_atomically(path, csv_bytes(table), overwrite=overwrite)


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """Poses as a plan has them that are written to a table."""

    sensitivity: Sensitivity
    joints: Array
    #: Driven to straight
    via: None = None

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.sensitivity.kinematics.robot

    @property
    def moves(self) -> Array:
        """From each pose to the next."""
        return last_moves(self.joints)

    @property
    def sets(self) -> tuple[str, ...]:
        """The set of each pose; a check looks at all."""
        return (SETS[0],) * len(self.joints)

    @property
    def targets(self) -> tuple[str, ...]:
        """The target."""
        return self.sensitivity.setup.targets

    @property
    def expected(self) -> Array:
        """The place where the calibrated robot predicts it."""
        return self.sensitivity.expected(self.joints)

    @property
    def sights(self) -> tuple[Sight, ...]:
        """The frame and the target."""
        return self.sensitivity.sights

    @property
    def seen(self) -> Mask:
        """It is measured at every pose."""
        return np.ones((len(self.joints), len(self.sights)), dtype=bool)

    @property
    def views(self) -> tuple[View, ...]:
        """The only view."""
        return self.sensitivity.views

    @property
    def sightlines(self) -> tuple[Sightline, ...]:
        """The frame and the target, with the chain between."""
        return self.sensitivity.sightlines


class Candidates(NamedTuple):
    """Reachable poses, as stops."""

    #: Shape (n, m), [rad] or [m]
    joints: Array
    #: One for each
    stops: tuple[Stop, ...]
    #: Whether they are known to be free of collision of the robot's own shapes
    collisions_checked: bool
    #: The model of the robot with its instrument
    sensitivity: Sensitivity


@one_blas_thread()
def check_poses(
    calibration: ResultInput,
    count: int = 3,
    cell: CellInput = None,
    *,
    seed: int = 0,
) -> CheckPoses:
    """Choose poses at which to check a result: those that tell best what has moved.

    Args:
        calibration: The result, or the path of its file.
        count: Number of poses, 1 to 200.
        cell: Boxes, joint ranges, tracker; None: nothing is known of them.
        seed: Of the poses that are drawn.

    Returns:
        The poses, seen from the first frame at the first target.

    Raises:
        ArgumentError: An argument of another type.
        ModelError: More poses than candidates; a robot of several chains; or measurements whose poses cannot be chosen,
            such as a ball in a socket.
    """
    check_whole("count", count, 1)
    if count > _CANDIDATES:
        raise ModelError(
            f"{count} poses are to be chosen of {_CANDIDATES} candidates; ask for fewer. Three to five poses tell what "
            "has moved; calib plan chooses those of a calibration."
        )
    check_whole("seed", seed, 0)
    result = result_of(calibration)
    stored = StoredResult.of(result)
    candidates = candidates_of(stored, cell_of(cell), seed)
    moving = moving_causes(stored)
    value = _value_of_sets(stored, moving, candidates, count, seed)
    rng = np.random.default_rng(seed)
    n = len(candidates.stops)
    sets = [rng.choice(n, min(count, n), replace=False) for _ in range(_SETS)]
    values = [value([candidates.stops[i] for i in chosen]) for chosen in sets]
    best, highest = sets[int(np.argmax(values))], max(values)
    for place in range(len(best)):
        for i in rng.choice(n, min(_TRIED, n), replace=False).tolist():
            if i in best:
                continue
            other = best.copy()
            other[place] = i
            worth = value([candidates.stops[j] for j in other])
            if worth > highest:
                best, highest = other, worth
    joints = _in_order(candidates.joints[best])
    return CheckPoses(
        read_only(joints), (highest,), candidates.collisions_checked, candidates.sensitivity
    )


@one_blas_thread()
def further_poses(
    check: CheckResult,
    cell: CellInput = None,
    *,
    seed: int = 0,
    most: int = MOST,
    candidates: Candidates | None = None,
) -> CheckPoses:
    """Choose further poses that tell apart the causes that a check could not, and say how many are needed.

    Args:
        check: The check, of the outcome ``"undecided"``.
        cell: As of `check_poses`.
        seed: Of the poses that are drawn.
        most: The most poses that are chosen.
        candidates: Poses to choose from, as `candidates_of` draws them; None: they are drawn.

    Returns:
        The poses, as many as decide with 90 %, or the most; measure them in addition.

    Raises:
        ModelError: As of `check_poses`; or the check has decided.
    """
    check_type("check", check, CheckResult, "the result of calib.check")
    check_whole("seed", seed, 0)
    if check.outcome != "undecided":
        raise ModelError(f"The check has decided ('{check.outcome}'): no further poses are needed.")
    stored = check.stored
    freedom = stored.freedom
    if candidates is None:
        candidates = candidates_of(stored, cell_of(cell), seed)
    rng = np.random.default_rng(seed)
    moving = moving_causes(stored)

    # What the check left possible: a cause, and its displacement.
    c = check.stack.by_displacements.shape[1]
    drawn, named = [], []
    keys = [_key(cause) for cause in check.causes]
    of_named = {
        _key(finding): finding.probability for finding in check.named if finding.code != "other"
    }
    for key, probability in of_named.items():
        k = keys.index(key)
        cause = check.causes[k]
        number = max(round(8 * _DRAWS * probability), 4)
        x = np.zeros((number, c))
        if cause.code in MOVING:
            mean, covariance = estimate(check.directions[k], check.stack.y, freedom)
            x = rng.multivariate_normal(mean, covariance, number, method="eigh") @ cause.mixing.T
        drawn.append(x)
        named += [key] * number
    x = np.concatenate(drawn)
    before = len(check.stack.y)
    noise = rng.standard_normal((6 * most, len(x)))

    def worth(added: Sequence[Stop]) -> tuple[float, float]:
        """Return the mean probability of the true cause with further stops, and how often one cause is sure."""
        stack = stacked([*check.stack.stops, *added])
        causes, directions = causes_of(moving, stack)
        y = stack.by_displacements @ x.T
        y[:before] = check.stack.y[:, None]  # what was measured stays
        y[before:] += noise[: len(y) - before]
        weights = logsumexp(log_weights(directions, y, freedom), axis=1)
        probability = np.exp(weights - logsumexp(weights, axis=0))
        true = np.array([[_key(cause) for cause in causes].index(key) for key in named])
        of_true = probability[true, np.arange(len(true))]
        return float(of_true.mean()), float(np.mean(probability.max(axis=0) >= SURE))

    chosen: list[int] = []
    shares: list[float] = []
    while len(chosen) < most:
        tried = rng.choice(len(candidates.stops), min(_TRIED, len(candidates.stops)), replace=False)
        taken = [candidates.stops[i] for i in chosen]
        found = [
            (worth([*taken, candidates.stops[i]]), i) for i in tried.tolist() if i not in chosen
        ]
        (_, share), best = max(found)
        chosen.append(best)
        shares.append(share)
        if share >= _ENOUGH:
            break
    joints = _in_order(candidates.joints[chosen])
    return CheckPoses(
        read_only(joints), tuple(shares), candidates.collisions_checked, candidates.sensitivity
    )


def _key(cause: object) -> tuple[object, ...]:
    """Return what identifies a cause or a finding."""
    return tuple(getattr(cause, name) for name in ("code", "name", "rows"))


def _value_of_sets(
    stored: StoredResult,
    moving: Sequence[Cause],
    candidates: Candidates,
    count: int,
    seed: int,
) -> Callable[[Sequence[Stop]], float]:
    """Return the function that says what a set of ``count`` stops is worth."""
    rng = np.random.default_rng([seed, 1])
    freedom = stored.freedom
    drawn, true = [], []
    for cause in moving:
        shown = [np.sum((stop.by_displacements @ cause.mixing) ** 2) for stop in candidates.stops]
        if not np.mean(shown) > 0.0:
            continue
        size = _SHOWN / np.sqrt(np.mean(shown))
        x = size * rng.standard_normal((_DRAWS, cause.mixing.shape[1]))
        if cause.mixing.shape[1] == 1:
            x = size * np.sign(x)
        drawn.append(x @ cause.mixing.T)
        true += [_key(cause)] * _DRAWS
    x = np.concatenate(drawn)
    noise = rng.standard_normal((6 * count, len(x)))

    def value(stops: Sequence[Stop]) -> float:
        """Return the mean probability that the true cause gets."""
        stack = stacked(stops)
        causes, directions = causes_of(moving, stack)
        keys = [_key(cause) for cause in causes]
        y = stack.by_displacements @ x.T + noise[: len(stack.y)]
        weights = logsumexp(log_weights(directions, y, freedom), axis=1)
        # Equal odds for "nothing": a displacement has to be noticed too.
        nothing = np.full((1, weights.shape[1]), np.log(sum(each.prior for each in directions)))
        probability = np.exp(weights - logsumexp(np.vstack([weights, nothing]), axis=0))
        at = [keys.index(key) if key in keys else -1 for key in true]
        of_true = np.where(np.array(at) < 0, 0.0, probability[at, np.arange(len(at))])
        return float(of_true.mean())

    return value


def candidates_of(stored: StoredResult, cell: Cell, seed: int) -> Candidates:
    """Draw reachable poses at which the first target is measured from the first frame.

    Args:
        stored: The result.
        cell: Boxes, joint ranges, tracker.
        seed: Of the poses.

    Raises:
        ModelError: A robot of several chains, a kind whose poses cannot be chosen, or no pose can be measured.
    """
    result, setup = stored.result, stored.part.setup
    robot = stored.displaced.robot
    if robot.branches:
        raise ModelError(
            "Poses to check at are chosen for one chain, and this result has several: choose poses of your own, at "
            "which the arms differ as much as they can."
        )
    cell = result.complete_cell(with_chain_of_result(cell, result, "The calibration"))
    cameras = dict(list(cell.cameras.items())[:1])
    boards = dict(list(cell.boards.items())[:1])
    kind = next(
        kind
        for kind, group in zip(result.rows.kinds, result.rows.groups, strict=True)
        if group == setup.groups[0]
    )
    target = setup.targets[0]
    is_named = target != DEFAULT_TARGET and not boards
    known = replace(
        cell,
        kind=kind,
        cameras={"": next(iter(cameras.values()))} if cameras else {},
        boards={"": next(iter(boards.values()))} if boards else {},
        frames={},
        bases={},
        tips={},
        T_frame_base=setup.T_frame_base[0],
        target=None if is_named else setup.T_tip_target[0, :3, 3],
        targets={target: setup.T_tip_target[0, :3, 3]} if is_named else {},
        target_rotation=setup.T_tip_target[0, :3, :3] if setup.oriented else None,
        model="zeros",
        distances=(),
    )
    sensitivity = Sensitivity.of(robot, known)
    instrument, view = sensitivity.instrument, sensitivity.views[0]
    ranges = np.array(planning_ranges(robot, cell.ranges, 0.0))
    fitted = result.rows.ranges
    if np.isfinite(fitted).all() and fitted.shape == ranges.shape:
        inside = np.column_stack(
            [np.maximum(ranges[:, 0], fitted[:, 0]), np.minimum(ranges[:, 1], fitted[:, 1])]
        )
        ranges = np.where((inside[:, 0] < inside[:, 1])[:, None], inside, ranges)
    conditions = [*instrument.sees(sensitivity.sightlines)]
    checked = True
    try:
        body = collision_model(instrument, sensitivity, CollisionCheck())
        conditions += [
            *free_lines_of_sight(sensitivity, body, view),
            Condition("collision", body.free),
        ]
    except UrdfError:  # no shapes, or meshes that are not here
        checked = False
    if instrument.VIEWPOINT_NUMBERS:
        pool = draw_towards(
            instrument, sensitivity.sightlines[0], ranges, conditions, _CANDIDATES, seed
        )
    else:
        pool = draw(robot, ranges, conditions, _CANDIDATES, seed)

    names = [setup.targets[0]]
    stop = instrument.stop_rows(result.nominal, names, setup.groups[0])
    rows, _ = rows_and_setup(result.nominal, stop, replace(known, model="auto"))
    k, n = len(rows), len(pool.q)
    tiled = rows.select(np.tile(np.arange(k), n))
    q = np.repeat(pool.q, k, axis=0)
    load = None
    if stored.part is result.non_geometric:
        load = result.non_geometric.load(result.nominal, q, None)
    samples = replace(tiled.samples, q=q, moves=np.repeat(last_moves(pool.q), k, axis=0), load=load)
    numbers = np.repeat(np.arange(n), k)
    tiled = replace(tiled, samples=samples, poses=np.arange(len(q)), blocks=numbers)
    stops = stored.stops(tiled, (), [int(number) + 1 for number in numbers], ())
    return Candidates(pool.q, stops, checked, sensitivity)


def _in_order(joints: Array) -> Array:
    """Return a few poses in an order with short moves: each time the nearest one."""
    left = list(range(len(joints)))
    order = [left.pop(0)]
    while left:
        away = [float(np.abs(joints[i] - joints[order[-1]]).max()) for i in left]
        order.append(left.pop(int(np.argmin(away))))
    return np.asarray(joints[order])

"""evaluate: how far a robot is off, without changing it; pose accuracy and repeatability as ISO 9283 defines them.

A pose was commanded once or n times. With e_j what was measured in its repeat j, minus what the robot's model predicts
for the joint values of that row, in the axes of the base,

    AP = |mean e_j|                                 pose accuracy: from the commanded pose to the barycentre
    l_j = |e_j - mean e|,  RP = mean l + 3 S_l      pose repeatability
    AP_a, AP_b, AP_c = mean e_j about x, y, z       of orientations
    RP_a, RP_b, RP_c = 3 S_a, 3 S_b, 3 S_c

where S are the standard deviations over n - 1. These are the figures of a controller with this model. Rows that measure
one length have AP = |mean e_j| along it, as ISO 9283's distance accuracy, and RP = 3 S.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from calib.blas import one_blas_thread
from calib.data.cell import Cell
from calib.data.columns import DEFAULT_TARGET
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.errors import CalibError, MeasurementError, ModelError, choices
from calib.model.error_model import DIRECTIONS
from calib.model.kinematics import Samples
from calib.numerics.errors import Errors
from calib.registration.registration import nominal_setup, register_held_out
from calib.registration.setup import Setup
from calib.registration.table_rows import rows_and_setup
from calib.result.calibration import CalibrationValues
from calib.result.prediction import NonGeometric
from calib.robot.robot import Robot, read_only
from calib.units import Array, Mask

#: What of an earlier result can be taken for known.
PLACES = ("frame", "target")

#: A place found anew must make an rms above the last [m] this many times smaller, with this many numbers an unknown.
_BETTER, _NUMBERS, _SMALL = 3.0, 3, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Errors of a robot as it is."""

    robot: Robot  #: The robot
    measurements: Measurements  #: All rows
    setup: Setup  #: Frames and targets as given or registered
    registered: tuple[str, ...]  #: Some of ``"target"`` and ``"frame"``, found from these rows
    residual: Array  #: shape (N, D), measured minus predicted: lengths [m] first, then angles [rad]
    used: Mask  #: shape (N, D), which scalars were measured

    @property
    def errors(self) -> dict[str, Errors]:
        """``errors["estimation" | "validation" | "all"]``."""
        m, every = self.measurements, slice(None)
        sets = (("estimation", m.estimation), ("validation", m.validation), ("all", every))
        return {name: Errors.of(self.residual[mask], self.used[mask]) for name, mask in sets}


@one_blas_thread()
def evaluate(
    robot: Robot,
    measurements: Measurements,
    cell: Cell | None = None,
    *,
    known: Setup | None = None,
    which: tuple[str, ...] = PLACES,
    non_geometric: NonGeometric | None = None,
) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the
    estimation rows; to the others where none of them sees it.

    Args:
        robot: The robot, nominal or corrected.
        measurements: The rows.
        cell: Target and frame, where they are known.
        known: Frames and targets of an earlier result, which win over the cell's: `Calibration.setup`, or its
            ``nominal_setup`` for the nominal robot.
        which: Whether its ``"frame"``, its ``"target"`` or both are meant.
        non_geometric: The non-geometric model of a result, to predict with on the nominal robot. Its frames and
            targets are the known ones, and a payload of the cell wins over its own.

    Raises:
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
        ModelError: The table has a set-up that neither the earlier result nor the cell knows.
    """
    cell = cell or Cell()
    if non_geometric is not None:
        cell = replace(
            cell, payload=cell.payload or non_geometric.payload, gravity=non_geometric.gravity
        )
        non_geometric = replace(
            non_geometric, kinematics=replace(non_geometric.kinematics, robot=robot)
        )
        known = non_geometric.setup
    every, setup = rows_and_setup(robot, measurements, cell)
    setup = setup if known is None else _at_known(setup, known, which)
    q = every.joints
    poses = (
        robot.poses(q)
        if non_geometric is None
        else non_geometric.tips(Samples.at(q, every.samples.load))
    )
    chosen = registering(measurements)
    placed = nominal_setup(poses[chosen], setup, every.select(chosen))
    unseen = setup.with_given_fixed(every.samples.select(chosen))
    found = register_held_out(poses[~chosen], placed, unseen, every.select(~chosen))
    frames = zip(setup.unknown, setup.frame_given, strict=True)
    unknown = {
        "target": bool(np.any(setup.target_unknown & ~setup.target_given)),
        "frame": any(directions and not given for directions, given in frames),
    }
    return Evaluation(
        robot=robot,
        measurements=measurements,
        setup=found,
        registered=tuple(name for name, missing in unknown.items() if missing),
        residual=read_only(every.residual(found.target_poses(poses, every.samples))),
        used=every.used,
    )


def registering(m: Measurements) -> Mask:
    """The rows that something is registered to, shape (N,): the estimation rows, or all where there are none."""
    return m.estimation if np.any(m.estimation) else np.ones(len(m), dtype=bool)


def _at_known(setup: Setup, known: Setup, which: tuple[str, ...]) -> Setup:
    """A table's set-up with the frames and targets of an earlier result.

    The only one of a result stands for the only one of a table; but a target that is named otherwise is another.
    """

    def found(
        what: str, own: tuple[str, ...], names: tuple[str, ...], poses: Array, into: Array
    ) -> Mask:
        """Put known poses in place, by name or the only one for the only one; which were found."""
        another = what == "target" and own[0] != DEFAULT_TARGET
        alone = len(own) == len(names) == 1 and not another
        there = np.array([what in which and (alone or name in names) for name in own])
        for k in np.flatnonzero(there):
            into[k] = poses[0 if alone else names.index(own[k])]
        return there

    frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
    framed = found("frame", setup.groups, known.groups, known.T_frame_base, frames)
    aimed = found("target", setup.targets, known.targets, known.T_tip_target, targets)
    own = zip(setup.groups, framed, setup.unknown, strict=True)
    lost = [group for group, there, unknown in own if not there and not unknown]
    if lost and "frame" in which:
        raise ModelError(
            f"The result has the set-ups {choices(known.groups)}; the table's {choices(lost)} are none of them. Let "
            "the measurement frames be found (--frame estimate), or give them in a cell file."
        )
    # A position is not enough where orientations are to be met: then it is where the target is looked for.
    fixed = aimed if known.oriented or not setup.rotation else np.zeros_like(aimed)
    return replace(
        setup.with_fixed(framed, fixed).placed(frames, targets),
        frame_given=setup.frame_given | framed,
        target_given=np.where(aimed, fixed, setup.target_given),
    )


def moved(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    known: Setup,
    which: tuple[str, ...] = PLACES,
) -> Reason | None:
    """Which of frame and target explains the errors of fresh rows by far when found anew."""
    before = evaluate(robot, measurements, cell, known=known, which=which)
    rms, best = before.errors["all"].rms, None
    if not rms > _SMALL:
        return None
    least = rms / _BETTER
    anew = replace(cell, estimate_frame=True, frame_directions=DIRECTIONS)
    for why, place, open_cell in (
        (Why.FRAME_MOVED, "frame", anew),
        (Why.TARGET_MOVED, "target", replace(cell, estimate_target=True)),
    ):
        if place in before.registered:
            continue
        kept = tuple(one for one in which if one != place)
        try:
            after = evaluate(robot, measurements, open_cell, known=known, which=kept)
        except CalibError:
            continue  # too few rows to find it
        unknowns, error = after.setup.count, after.errors["all"].rms
        enough = unknowns and int(after.used.sum()) >= _NUMBERS * unknowns
        if enough and error <= least:
            least, best = error, Reason.of(why, given_m=rms, error_m=error)
    return best


# Accuracy and repeatability

Rows = Literal["all", "validation", "fresh"]

#: Fewer repeats than this have no RP: of two, both lie equally far from their mean, and S is 0 whatever the robot does.
FEWEST_REPEATS = 3

#: From this many poses on, rows are judged alone that the table itself does not set aside from the fitted ones.
FEWEST_APART = 5

#: Residuals that differ by less are those of one row [m]: far above rounding, far below what repeats differ by.
_SAME = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PoseAccuracy:
    """Accuracy and repeatability at one pose of one target in one set-up; NaN for what was not measured."""

    rows: tuple[int, ...]  #: Numbers of the rows in the table: the repeats of the pose
    kind: str  #: What they measure
    group: str  #: Their set-up
    target: str  #: Their target
    ap: float  #: Pose accuracy [m]
    ap_xyz: Array  #: shape (3,), its components along the base's axes [m]; NaN where one length was measured
    rp: float  #: Pose repeatability [m]; NaN below three repeats
    single: float  #: Largest error of a single repeat [m]
    ap_angle: float  #: Angle between the commanded and the mean attained orientation [rad]
    ap_abc: Array  #: shape (3,), its components about the base's axes [rad]
    rp_abc: Array  #: shape (3,), repeatability about them [rad]; NaN below three repeats
    single_angle: float  #: Largest angle of a single repeat [rad]

    @property
    def rp_angle(self) -> float:
        """The largest of the repeatabilities about axes [rad]."""
        return float(np.max(self.rp_abc))


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy of a robot over the poses that it is judged by."""

    poses: tuple[PoseAccuracy, ...]  #: The poses in the order of the table
    #: ``"all"``; where something was found from the others, ``"validation"``, the table's validation rows, or
    #: ``"fresh"``, others that nothing was found from
    rows: Rows
    #: Where some rows alone are judged, what the others were used for: ``"calibration"``, ``"target"``, ``"frame"``
    others: tuple[str, ...]
    measured: int  #: Number of rows that measure something
    fitted: int  #: Number of those that the calibration was fitted to
    seen: bool  #: Whether some of these are judged
    registered: tuple[str, ...]  #: Some of ``"target"`` and ``"frame"``, found from these rows
    unknowns: int  #: Number of unknowns of targets and frames that were not given
    numbers: int  #: Number of scalars that they were found from, repeats counted once

    @property
    def factor(self) -> float:
        """Random errors were this many times larger before something was registered to the same rows.

        With n numbers and u unknowns sqrt(n / (n - u)); infinite where no degree of freedom remains.
        """
        left = self.numbers - self.unknowns
        if not self.registered:
            return 1.0
        return float(np.sqrt(self.numbers / left)) if left > 0 else np.inf

    def of(self, name: str) -> Array:
        """``"ap"``, ``"rp"``, ``"single"`` [m], ``"ap_angle"``, ... [rad] of the poses that have it."""
        values = np.array([getattr(pose, name) for pose in self.poses])
        return np.asarray(values[np.isfinite(values)])

    def figures(self, *, angle: bool = False) -> dict[str, float]:
        """Largest and mean AP and RP, and the largest single error, [m] or [rad]; NaN where there are none."""
        ap, rp, one = (self.of(f"{name}{'_angle' * angle}") for name in ("ap", "rp", "single"))
        sizes = {"ap_max": ap, "ap_mean": ap, "rp_max": rp, "rp_mean": rp, "single_max": one}
        return {
            name: float(v.mean() if name.endswith("mean") else v.max()) if len(v) else np.nan
            for name, v in sizes.items()
        }

    @property
    def repeats(self) -> tuple[int, int]:
        """The smallest and the largest number of repeats of a pose."""
        counts = [len(pose.rows) for pose in self.poses]
        return min(counts), max(counts)


def accuracy(evaluation: Evaluation, *, seen: bool | Mask = False) -> Accuracy:
    """Pose accuracy and repeatability of an evaluation's robot.

    Where a target or a frame was registered to the estimation rows, the validation rows are judged alone, if there are
    any; where a calibration was fitted to some rows, the others, see `judged_rows`.
    ``seen`` says whether a calibration of this robot was fitted to the estimation rows, or to which rows, shape (N,).

    Raises:
        MeasurementError: No row measures anything.
    """
    m, setup, used = evaluation.measurements, evaluation.setup, evaluation.used
    # What is repeated is told by the joint values: frames, targets and loads of a cell have no part in it.
    rows = rows_and_setup(evaluation.robot, m, Cell())[0]
    told = np.any(used, axis=1)
    if not np.any(told):
        raise MeasurementError(f"{m.source or 'Measurements'}: no row measures anything.")
    base = registering(m)
    base = base | setup.with_given_fixed(rows.samples.select(base)).unknown_at(rows.samples)
    fitted = told & (seen if isinstance(seen, np.ndarray) else base & seen)
    judged = judged_rows(m, told, fitted, rows.poses, registered=bool(evaluation.registered))
    apart = not np.any(judged & base)
    others = ("calibration",) * bool(np.any(fitted & ~judged)) + evaluation.registered * apart
    _, first = np.unique(rows.poses[told & base], return_index=True)
    found = np.flatnonzero(told & base)[first]
    pairs = zip(setup.unknown, setup.frame_given, strict=True)
    targets = int(np.sum(setup.target_unknown & ~setup.target_given))

    # Three components are turned into the base's axes, R^T e; the frame's axes are those that R turns the base's into.
    residual = evaluation.residual.copy()
    R = setup.T_frame_base[rows.samples.frame, :3, :3]
    for part in (slice(0, 3), slice(3, 6))[: residual.shape[1] // 3]:
        whole = np.all(rows.used[:, part], axis=1)
        residual[whole, part] = np.einsum("nji,nj->ni", R[whole], residual[whole, part])
    chosen = np.flatnonzero(judged)
    order = chosen[np.argsort(rows.poses[chosen], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(rows.poses[order])) + 1)
    groups.sort(key=lambda own: int(own[0]))
    named: dict[Rows, Mask] = {"all": told, "validation": told & m.validation, "fresh": judged}
    return Accuracy(
        poses=tuple(_of_pose(evaluation, residual, own) for own in groups),
        rows=next(name for name, mask in named.items() if np.array_equal(judged, mask)),
        others=others,
        measured=int(np.sum(told)),
        fitted=int(np.sum(fitted)),
        seen=bool(np.any(fitted & judged)),
        registered=() if apart else evaluation.registered,
        unknowns=(6 if setup.rotation else 3) * targets
        + sum(len(directions) for directions, given in pairs if not given),
        numbers=int(np.sum(rows.used[found])),
    )


def _of_pose(evaluation: Evaluation, residual: Array, own: NDArray[np.intp]) -> PoseAccuracy:
    """One pose from its rows."""
    m, used = evaluation.measurements, evaluation.used[own[0]]
    e, w = residual[own][:, :3][:, used[:3]], residual[own][:, 3:]
    mean, nothing = e.mean(axis=0), np.full(3, np.nan)
    often, turned = len(own) >= FEWEST_REPEATS, bool(np.any(used[3:]))
    rp = np.nan
    if often:
        away = e[:, 0] if len(mean) == 1 else np.linalg.norm(e - mean, axis=1)
        rp = float((len(mean) > 1) * away.mean() + 3.0 * away.std(ddof=1))
    turn = w.mean(axis=0) if turned else nothing
    rp_abc = 3.0 * w.std(axis=0, ddof=1) if turned and often else nothing
    return PoseAccuracy(
        rows=tuple(int(m.rows[i]) for i in own),
        kind=m.kinds[own[0]],
        group=m.groups[own[0]],
        target=m.targets[own[0]],
        ap=float(np.linalg.norm(mean)),
        ap_xyz=read_only(mean if len(mean) == 3 else nothing),
        rp=rp,
        single=float(np.linalg.norm(e, axis=1).max()),
        ap_angle=float(np.linalg.norm(turn)),
        ap_abc=read_only(turn),
        rp_abc=read_only(rp_abc),
        single_angle=float(np.linalg.norm(w, axis=1).max()) if turned else np.nan,
    )


def judged_rows(
    m: Measurements, told: Mask, fitted: Mask, poses: NDArray[np.int_], *, registered: bool
) -> Mask:
    """Which rows a robot is judged by, shape (N,); the number of each row's pose is in ``poses``.

    Those that measure something and the calibration was not fitted to, if the table sets some of them aside or they are
    of five poses; and of these the validation rows, if there are any and something was registered to the others.
    Otherwise all.
    """
    fresh = told & ~fitted
    aside = fresh & m.validation & np.any(m.estimation)
    enough = np.any(aside) or len(np.unique(poses[fresh])) >= FEWEST_APART
    if np.any(fitted) and not enough:
        return told
    return np.asarray(aside if registered and np.any(aside) else fresh)


def fitted_rows(c: CalibrationValues, robot: Robot, measurements: Measurements, cell: Cell) -> Mask:
    """Which rows of a table a result was fitted to, shape (N,), in any file, in any order and under any number.

    A row is known again by its residuals with the nominal and with the corrected robot, which depend on every digit of
    its joint values and of what was measured. In the very file these are the estimation rows where none is known again.
    """
    fitted = np.zeros(len(measurements), dtype=bool)
    # A set-up that the result does not know has none of its rows.
    with contextlib.suppress(CalibError):
        nominal = evaluate(c.uncorrected(robot), measurements, cell, known=c.nominal_setup)
        calibrated = evaluate(c.corrected(robot), measurements, cell, known=c.setup)
        ours = (calibrated.used[:, :3], nominal.residual, calibrated.residual)
        theirs = (c.used[:, :3], c.residual_nominal, c.residual_calibrated)
        for k in range(1, 4):  # by the number of lengths that a row measures
            at = np.flatnonzero(ours[0].sum(axis=1) == k)
            of = np.flatnonzero(c.rows.estimation & (theirs[0].sum(axis=1) == k))
            if len(at) and len(of):
                own, stored = (
                    np.hstack([one[rows, :3][used[rows]].reshape(-1, k) for one in residuals])
                    for rows, (used, *residuals) in ((at, ours), (of, theirs))
                )
                near = KDTree(stored).query(own, p=np.inf, distance_upper_bound=_SAME)[0]
                fitted[at] = near <= _SAME
    same = bool(c.source.sha256) and c.source.sha256 == measurements.sha256
    return measurements.estimation if same and not np.any(fitted) else fitted

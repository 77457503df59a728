"""Pose accuracy and repeatability as ISO 9283 defines them, of the rows of an evaluation.

A pose was commanded once or n times. With e_j what was measured in its repeat j, minus what the robot's model predicts
for the joint values of that row, in the axes of the base,

    AP = |mean e_j|                                 pose accuracy: from the commanded pose to the barycentre
    l_j = |e_j - mean e|,  RP = mean l + 3 S_l      pose repeatability
    AP_a, AP_b, AP_c = mean e_j about x, y, z       of orientations
    RP_a, RP_b, RP_c = 3 S_a, 3 S_b, 3 S_c

where S are the standard deviations over n - 1. What a controller with this model would command to bring about these
joint values is what the model predicts: so the figures are those of a controller with this model. Repeats whose joint
values were read a little differently are compared each with its own prediction.

Rows that measure one length have AP = |mean e_j| along it, as ISO 9283's distance accuracy, and RP = 3 S.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.identify.acceptance_rows import estimated, fitted_of, judged_rows
from calib.identify.evaluation import Evaluation
from calib.identify.rows import Rows
from calib.identify.setup import Setup, rows_of
from calib.measure.cell import Cell
from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Fewer repeats than this have no RP: of two, both lie equally far from their mean, and S is 0 whatever the robot does.
FEWEST_REPEATS = 3


@dataclass(frozen=True, slots=True, eq=False)
class PoseAccuracy:
    """Accuracy and repeatability at one pose of one target in one set-up.

    Attributes:
        rows: Numbers of the rows in the table: the repeats of the pose.
        kind: What they measure.
        group: Their set-up.
        target: Their target.
        ap: Pose accuracy [m].
        ap_xyz: shape (3,), its components along the base's axes [m]; NaN where one length was measured.
        rp: Pose repeatability [m]; NaN below three repeats.
        single: Largest error of a single repeat [m].
        ap_angle: Angle between the commanded and the mean attained orientation [rad]; NaN where none was measured.
        ap_abc: shape (3,), its components about the base's axes [rad].
        rp_abc: shape (3,), repeatability about them [rad]; NaN below three repeats.
        single_angle: Largest angle of a single repeat [rad].
    """

    rows: tuple[int, ...]
    kind: str
    group: str
    target: str
    ap: float
    ap_xyz: Array
    rp: float
    single: float
    ap_angle: float
    ap_abc: Array
    rp_abc: Array
    single_angle: float


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """How repeats scatter about the mean of their pose: the robot and the instrument together.

    Attributes:
        std: Standard deviation of one component [m] or [rad]; NaN without repeats.
        freedom: Its degrees of freedom.
    """

    std: float
    freedom: int


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """What was registered to the rows that are judged, and how far random errors look too small for it.

    Attributes:
        what: ``"target"``, ``"frame"``; none where nothing was, or not to these rows.
        unknowns: Number of unknowns that were found.
        numbers: Number of scalars that they were found from, repeats counted once.
    """

    what: tuple[str, ...]
    unknowns: int
    numbers: int

    @property
    def factor(self) -> float:
        """Random errors were this many times larger: sqrt(n / (n - u)); infinite where nothing is left over."""
        if not self.what:
            return 1.0
        left = self.numbers - self.unknowns
        return float(np.sqrt(self.numbers / left)) if left > 0 else np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """Accuracy of a robot over the poses that it is judged by.

    Attributes:
        poses: The poses in the order of the table.
        rows: ``"all"``; where something was found from the others, ``"validation"``, the table's validation rows, or
            ``"fresh"``, others that nothing was found from.
        others: Where some rows alone are judged, what the others were used for: ``"calibration"``, ``"target"``,
            ``"frame"``.
        measured: Number of rows that measure something.
        fitted: Number of those that the calibration was fitted to.
        seen: Whether some of these are judged.
        registered: What was registered to them.
        scatter: Of lengths within repeats.
        scatter_angle: Of angles.
    """

    poses: tuple[PoseAccuracy, ...]
    rows: str
    others: tuple[str, ...]
    measured: int
    fitted: int
    seen: bool
    registered: Registered
    scatter: Scatter
    scatter_angle: Scatter

    @property
    def ap(self) -> Array:
        """AP of each pose, shape (P,), [m]."""
        return np.array([pose.ap for pose in self.poses])

    @property
    def rp(self) -> Array:
        """RP of the poses that were repeated often enough, [m]."""
        values = np.array([pose.rp for pose in self.poses])
        return _finite(values)

    @property
    def ap_angle(self) -> Array:
        """AP of the orientation of each pose that has one, [rad]."""
        values = np.array([pose.ap_angle for pose in self.poses])
        return _finite(values)

    @property
    def rp_angle(self) -> Array:
        """Largest of RP_a, RP_b and RP_c of the poses that were repeated often enough, [rad]."""
        values = np.array([np.max(pose.rp_abc) for pose in self.poses])
        return _finite(values)

    @property
    def single(self) -> Array:
        """Largest error of a single repeat of each pose, shape (P,), [m]."""
        return np.array([pose.single for pose in self.poses])

    @property
    def single_angle(self) -> Array:
        """The same of the orientations that there are, [rad]."""
        values = np.array([pose.single_angle for pose in self.poses])
        return _finite(values)

    @property
    def repeats(self) -> tuple[int, int]:
        """The smallest and the largest number of repeats of a pose."""
        counts = [len(pose.rows) for pose in self.poses]
        return min(counts), max(counts)


def accuracy(evaluation: Evaluation, *, seen: bool | Mask = False) -> Accuracy:
    """Pose accuracy and repeatability of an evaluation's robot.

    Where a target or a frame was registered to the estimation rows, the validation rows are judged alone, if there are
    any; where a calibration was fitted to some rows, the others, see `calib.identify.acceptance_rows.judged_rows`: of
    those nothing was taken away.

    Args:
        evaluation: The errors of a robot.
        seen: Whether a calibration of this robot was fitted to the estimation rows; or to which rows, shape (N,).

    Raises:
        MeasurementError: No row measures anything.
    """
    m = evaluation.measurements
    # What is repeated is told by the joint values: frames, targets and loads of a cell have no part in it.
    rows = rows_of(evaluation.robot, m, Cell())[0]
    told = np.any(evaluation.used, axis=1)
    if not np.any(told):
        raise MeasurementError(
            f"{m.source or 'Measurements'}: no row measures anything, so no accuracy can be told."
        )
    fitted = fitted_of(m, told, seen)
    judged = judged_rows(m, told, fitted, rows.poses, registered=bool(evaluation.registered))
    apart = not np.any(judged & estimated(m))
    what, others = ((), evaluation.registered) if apart else (evaluation.registered, ())
    if np.any(fitted & ~judged):
        others = ("calibration", *others)
    numbers = _numbers(rows, told & estimated(m))
    registered = Registered(what, _unknowns(evaluation.setup), numbers)
    residual = _in_base(evaluation.residual, rows, evaluation.setup)
    chosen, pose = np.flatnonzero(judged), rows.poses[judged]
    order = np.argsort(pose, kind="stable")
    cuts = np.flatnonzero(np.diff(pose[order])) + 1
    groups = [chosen[own] for own in np.split(order, cuts)]
    groups.sort(key=lambda own: int(own[0]))
    of_pose = partial(_of_pose, evaluation, residual)
    return Accuracy(
        poses=tuple(of_pose(own) for own in groups),
        rows=_called(judged, told, told & m.validation),
        others=others,
        measured=int(np.sum(told)),
        fitted=int(np.sum(fitted)),
        seen=bool(np.any(fitted & judged)),
        registered=registered,
        scatter=_scatter(groups, residual[:, :3], evaluation.used[:, :3]),
        scatter_angle=_scatter(groups, residual[:, 3:], evaluation.used[:, 3:]),
    )


def _called(judged: Mask, told: Mask, validation: Mask) -> str:
    """What the rows that are judged are called."""
    if np.array_equal(judged, told):
        return "all"
    return "validation" if np.array_equal(judged, validation) else "fresh"


def _finite(values: Array) -> Array:
    """Those that there are."""
    return np.asarray(values[np.isfinite(values)])


def _unknowns(setup: Setup) -> int:
    """How many unknowns of frames and targets were not given."""
    targets = setup.target_unknown & ~setup.target_given
    of_targets = (6 if setup.rotation else 3) * int(np.sum(targets))
    pairs = zip(setup.unknown, setup.frame_given, strict=True)
    return of_targets + sum(len(directions) for directions, given in pairs if not given)


def _numbers(rows: Rows, chosen: Mask) -> int:
    """Number of scalars of some rows, repeats of a pose counted once."""
    _, first = np.unique(rows.poses[chosen], return_index=True)
    return int(np.sum(rows.used[np.flatnonzero(chosen)[first]]))


def _in_base(residual: Array, rows: Rows, setup: Setup) -> Array:
    """Residuals with three components turned from their set-up's frame into the base's axes; others as they are."""
    result: Array = residual.copy()
    R = setup.T_frame_base[rows.samples.frame, :3, :3]
    for part in (slice(0, 3), slice(3, 6)):
        if residual.shape[1] < part.stop:
            break
        whole = np.all(rows.used[:, part], axis=1)
        # R^T e: the frame's axes are those that R turns the base's into.
        result[whole, part] = np.einsum("nji,nj->ni", R[whole], residual[whole, part])
    return result


def _of_pose(evaluation: Evaluation, residual: Array, own: NDArray[np.intp]) -> PoseAccuracy:
    """One pose from its rows."""
    m, used = evaluation.measurements, evaluation.used[own[0]]
    e, w = residual[own][:, :3][:, used[:3]], residual[own][:, 3:]
    mean, nothing = e.mean(axis=0), np.full(3, np.nan)
    often, turned = len(own) >= FEWEST_REPEATS, bool(np.any(used[3:]))
    rp = np.nan
    if often and len(mean) == 1:
        rp = 3.0 * float(e.std(ddof=1))
    elif often:
        away = np.linalg.norm(e - mean, axis=1)
        rp = float(away.mean() + 3.0 * away.std(ddof=1))
    turn = w.mean(axis=0) if turned else nothing
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
        rp_abc=read_only(3.0 * w.std(axis=0, ddof=1) if turned and often else nothing),
        single_angle=float(np.linalg.norm(w, axis=1).max()) if turned else np.nan,
    )


def _scatter(groups: list[NDArray[np.intp]], residual: Array, used: Mask) -> Scatter:
    """The scatter of one component within repeats, all poses together."""
    square, freedom = 0.0, 0
    for own in groups:
        if len(own) > 1 and np.any(used[own[0]]):
            e = residual[own][:, used[own[0]]]
            square += float(np.sum((e - e.mean(axis=0)) ** 2))
            freedom += (len(own) - 1) * e.shape[1]
    return Scatter(float(np.sqrt(square / freedom)) if freedom else np.nan, freedom)

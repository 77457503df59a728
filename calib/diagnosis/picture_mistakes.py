"""Mistakes of single pictures: turned, exchanged, or from a camera that was moved or refocused meanwhile.

The pictures of one camera agree with a robot whose errors are millimetres, or some of them do not. What most agree on
is found first. Each of several runs of pictures gives the poses X and Y of camera and board,

    T_camera_board(i) = X  T_base_tip(i)  Y,

and the one is taken that most pictures agree with. The others are then explained: by their images turned by half a
turn, by the joint values of another row, by another focal length, or by one other pose of the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.progress import trying
from calib.camera.optics import FOCAL
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.errors import MeasurementError
from calib.fit.registration.registration import register_all_rows
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.registration.views import views_as_poses
from calib.model.kinematics import Sightings
from calib.model.parameter_sets import DIRECTIONS
from calib.numerics.errors import rms
from calib.robot.robot import Robot

#: The fewest pictures of a camera that are examined: of fewer, a run and the others cannot be told apart.
_FEWEST = 8

#: Pictures of a run, as a share of all, and the fewest: two more than determine both poses.
_RUN = 0.2
_FEWEST_OF_RUN = 5

#: Runs that are tried, evenly over the pictures.
_RUNS = 16

#: So large a share of the pictures has to agree: of two halves of a table, one.
_AGREEING = 0.45

#: Rounds in which the pictures that agree are registered again.
_ROUNDS = 4

#: Length at which angles are counted: about that of a forearm, which turns by as much as it is displaced [m].
_ARM = 0.3

#: A picture disagrees if it is off by so many times the median of those that agree, but not if by less than the second
#: length [m], as one of a good arm may be.
_FAR = 5.0
_LEAST = 8e-3

#: Pictures that are off by more than this never agree: no uncalibrated arm is [m].
_MOST = 0.05

#: A mistake explains pictures if so large a share of those that disagree then agrees.
_EXPLAINED = 0.75

#: The fewest pictures that tell another pose of the camera: six numbers each, of which six are sought.
_FEWEST_MOVED = 3

#: Another focal length is named rather than another pose, which has five more numbers, if it leaves at most so many
#: times the error.
_AS_GOOD = 1.5

#: Shares of a move that are tried, and their step: of 60 deg it is 2 deg, within which the error has one minimum.
_SHARE_STEP = 0.03
_SHARES = tuple(np.arange(_SHARE_STEP, 0.6, _SHARE_STEP).tolist())

#: Late joint values are named if undoing them lowers the error to this share: one number for all joints and pictures.
_LATE = 0.5

#: The least error, to divide by [m].
_TINY = 1e-9

#: Joint values, (V, m), and a share, to joint values in which it is undone.
Undo: TypeAlias = Callable[[Array, float], Array]

#: Tolerance of a registration: three digits are enough to compare.
_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """A mistake of some pictures of one camera."""

    #: Its name and numbers
    reason: Reason
    #: Numbers of the table's rows that are in these pictures; empty if all rows have the mistake
    rows: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """The V views of one board by one camera, in the order of the table, and what most of them agree on."""

    #: The cell, for the size of images
    cell: Cell
    #: The N rows of the table
    rows: Rows
    #: (V,), the first row of each view, from 0
    first: Integers
    #: (V, 4, 4), pose of the tip of the nominal robot at each [m]
    T_base_tip: Array
    #: V poses of the board in the camera
    poses: Rows
    #: Camera and board as most views have them
    setup: Setup
    #: (V,), views that agree with it
    agree: Mask
    #: Limit of the error of a view that agrees [m]
    limit: float

    def errors(self, poses: Rows | None = None, tips: Array | None = None) -> Array:
        """Return how far views are off, (V,) [m], perhaps with other poses of the board or the tip, (V, 4, 4) [m]."""
        return _errors(
            self.setup,
            self.T_base_tip if tips is None else tips,
            self.poses if poses is None else poses,
        )

    def without_mirrored(self) -> _Views:
        """Return the views with those agreeing, too, whose images do: a board head on looks like its mirror image."""
        T_frame_target = self.setup.target_poses(self.T_base_tip, self.poses.samples)
        across = np.zeros(len(self.first))
        for k in range(len(self.first)):
            part = self.rows.select(self.rows_of(np.arange(len(self.first)) == k))
            seen = Sightings(np.repeat(T_frame_target[k][None], len(part), axis=0))
            lengths = part.lengths_per_unit(seen)[:, None] * part.residual(seen)
            across[k] = np.sqrt(np.mean(np.sum(lengths**2, axis=1)))
        limit = max(_FAR * float(np.median(across[self.agree])), _LEAST)
        return replace(self, agree=self.agree | (across < limit))

    def seen_anew(self, measured: Array | None = None, internals: Array | None = None) -> Rows:
        """Return the V poses of the board by other images, (N, K) [px], or other internals of the rows, (N, c)."""
        samples = self.rows.samples
        if internals is not None:
            samples = replace(samples, internals=read_only(internals))
        given = self.rows.measured if measured is None else measured
        rows = replace(self.rows, measured=given, samples=samples)
        numbers = self.rows_of(np.ones(len(self.first), dtype=bool))
        poses, first = views_as_poses(rows.select(numbers))
        # A view that no longer determines a pose keeps it.
        place = {int(row): k for k, row in enumerate(np.flatnonzero(numbers)[first])}
        found = np.array([place.get(int(row), -1) for row in self.first])
        values = np.where((found < 0)[:, None], self.poses.measured, poses.measured[found])
        return replace(self.poses, measured=values)

    def rows_of(self, views: Mask) -> Mask:
        """Return the rows of the table, (N,), that are in some of the views, (V,)."""
        labels = _labels(self.rows)
        wanted = np.zeros(len(labels), dtype=bool)
        for row in self.first[views].tolist():
            wanted |= np.all(labels == labels[row], axis=1)
        return np.asarray(wanted & self.rows.has_views)


def mistakes_of_pictures(robot: Robot, cell: Cell, table: Measurements) -> tuple[Finding, ...]:
    """Find the pictures that disagree with the others of their camera, where a mistake explains that.

    Args:
        robot: The nominal robot.
        cell: Cameras and boards as given.
        table: N rows, in the order in which they were measured; those that are not in images are not looked at.

    Returns:
        At most one finding a camera and board: turned or exchanged pictures, or those before or after the camera was
        moved or refocused, whichever are fewer.

    Raises:
        MeasurementError: What is known of a camera is not enough or contradicts its rows.
    """
    if not np.any(table.is_image):
        return ()
    rows, setup = rows_and_setup(robot, table, cell)
    try:
        poses, first = views_as_poses(rows)
    except MeasurementError:  # the fit says so
        return ()
    is_view = rows.has_views[first]
    poses, first = poses.select(is_view), first[is_view]
    T_base_tip = robot.poses(rows.joints[first], poses.samples.chain)
    result = []
    pairs = np.unique(np.column_stack([poses.samples.frame, poses.samples.target]), axis=0)
    for f, t in pairs.tolist():
        chosen = (poses.samples.frame == f) & (poses.samples.target == t)
        if np.sum(chosen) < _FEWEST:
            continue
        part, tips = poses.select(chosen), T_base_tip[chosen]
        common = _common_setup(setup, tips, part)
        if common is not None and np.all(common[1]):
            continue
        q = rows.joints[first[chosen]]
        if common is None:
            shift = _shifted(setup, tips, part, np.array(table.rows)[first[chosen]])
            of_all = shift or _late(robot, setup, q, part)
        else:
            of_all = _late(robot, setup, q, part)
        if of_all is not None:
            result.append(Finding(of_all, ()))
        if of_all is not None or common is None:
            continue
        views = _Views(cell, rows, first[chosen], tips, part, *common).without_mirrored()
        if np.all(views.agree):
            continue
        names = np.array([table.images[row] or str(table.rows[row]) for row in views.first])
        station = setup.groups[f] if len(setup.groups) > 1 else ""
        trying(Why.PICTURES_EXCHANGED.value)
        for reason, concerned in _explanations(views, names, table.rows, station):
            numbers: tuple[int, ...] = ()
            if concerned is not None:
                numbers = tuple(np.array(table.rows)[views.rows_of(concerned)].tolist())
            result.append(Finding(reason, numbers))
    return tuple(result)


def _labels(rows: Rows) -> Integers:
    """Return the numbers of pose, camera and board of each row, (N, 3): equal in the rows of one view."""
    return np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])


def _errors(setup: Setup, T_base_tip: Array, poses: Rows) -> Array:
    """Return how far the V poses of a board are off, (V,) [m]: their distance, and their angle at the length `_ARM`."""
    residual = poses.residual(setup.target_poses(T_base_tip, poses.samples))
    distances = np.linalg.norm(residual[:, :3], axis=1)
    return np.asarray(np.hypot(distances, _ARM * np.linalg.norm(residual[:, 3:6], axis=1)))


def _common_setup(setup: Setup, T_base_tip: Array, poses: Rows) -> tuple[Setup, Mask, float] | None:
    """Find the poses of camera and board that most of V views agree on, which views these are, and their limit [m].

    None if too few agree.
    """
    count = len(poses)
    size = max(_FEWEST_OF_RUN, round(_RUN * count))
    starts = np.unique(np.linspace(0, count - size, _RUNS).astype(int))
    runs = [np.arange(start, start + size) for start in starts.tolist()]
    rank = int(np.ceil(_AGREEING * count)) - 1
    best, least = None, np.inf
    for run in (np.arange(count), *runs):
        placed = register_all_rows(T_base_tip[run], setup, poses.select(run), tolerance=_TOLERANCE)
        score = float(np.sort(_errors(placed, T_base_tip, poses))[rank])
        if score < least:
            best, least = placed, score
    if best is None:
        return None
    for _ in range(_ROUNDS):
        errors = _errors(best, T_base_tip, poses)
        limit = float(np.clip(_FAR * np.median(np.sort(errors)[: rank + 1]), _LEAST, _MOST))
        agree = errors < limit
        if np.sum(agree) <= rank:
            return None
        best = register_all_rows(
            T_base_tip[agree], setup, poses.select(agree), tolerance=_TOLERANCE
        )
    agree = _errors(best, T_base_tip, poses) < limit
    return (best, agree, limit) if np.sum(agree) > rank else None


def _shifted(setup: Setup, T_base_tip: Array, poses: Rows, numbers: Integers) -> Reason | None:
    """Say if V pictures agree once those from some one on have the joint values of the next row, or the one before.

    ``numbers``, (V,), are those of the first rows of the views in the table.
    """
    trying(Why.ROWS_SHIFTED.value)
    place = np.arange(len(poses))
    for step in (1, -1):
        shifted = place[(place + step >= 0) & (place + step < len(poses))]
        common = _common_setup(setup, T_base_tip[shifted + step], poses.select(shifted))
        if common is None:
            continue
        placed, agree, limit = common
        as_given = _errors(placed, T_base_tip, poses) < limit
        first = int(shifted[agree][0])
        # Single pictures may agree by chance, or not at all.
        before, after = place < first, np.isin(place, shifted) & (place >= first)
        explained = np.concatenate([as_given[before], agree[shifted >= first]])
        if np.mean(explained) < _EXPLAINED or np.sum(after) < _FEWEST_OF_RUN:
            continue
        given = register_all_rows(T_base_tip, setup, poses, tolerance=_TOLERANCE)
        sizes = {
            "given_m": rms(_errors(given, T_base_tip, poses)),
            "error_m": rms(
                _errors(placed, T_base_tip[shifted + step], poses.select(shifted))[agree]
            ),
        }
        if first <= shifted[0]:
            return Reason.of(Why.ROWS_SHIFTED, **sizes, later=step < 0)
        return Reason.of(Why.ROWS_MOVED, **sizes, row=int(numbers[first]), up=step > 0)
    return None


def _late(robot: Robot, setup: Setup, q: Array, poses: Rows) -> Reason | None:
    """Say if V pictures agree far better with joint values, (V, m), of another time: by one share of the joints' moves.

    The share is sought for joint values that are late or early on the way to the next row, and for joints that had not
    arrived.
    """

    def error(share: float, undo: Undo) -> float:
        """Return the rms error of the views with the share of the moves undone [m]."""
        tips = robot.poses(undo(q, share), poses.samples.chain)
        placed = register_all_rows(tips, setup, poses, tolerance=_TOLERANCE)
        return rms(_errors(placed, tips, poses))

    trying(Why.JOINTS_LATE.value)
    as_given = error(0.0, _not_yet_arrived)
    tried = []
    for undo, sign in ((_old_values, 1.0), (_early_values, -1.0), (_not_yet_arrived, 1.0)):
        coarse = min(_SHARES, key=lambda share: error(share, undo))
        fine = np.linspace(coarse - _SHARE_STEP, coarse + _SHARE_STEP, 9)[1:-1].tolist()
        best = min((coarse, *fine), key=lambda share: error(share, undo))
        tried.append((error(best, undo), sign * best))
    least, share = min(tried)
    if least > _LATE * as_given:
        return None
    falls = 1.0 - least / as_given
    return Reason.of(
        Why.JOINTS_LATE, of_step=share, over_arm=as_given / max(least, _TINY), falls=falls
    )


def _old_values(q: Array, share: float) -> Array:
    """Return joint values that were read a share of each move too early: q + s m, with the moves m of the result."""
    result = q.copy()
    for i in range(1, len(q)):
        result[i] = (q[i] - share * result[i - 1]) / (1.0 - share)
    return np.asarray(result)


def _early_values(q: Array, share: float) -> Array:
    """Return joint values that were read a share of the next move too late."""
    return _old_values(q[::-1], share)[::-1]


def _not_yet_arrived(q: Array, share: float) -> Array:
    """Return where joints were that missed a share of each move to the values that were commanded."""
    return np.asarray(q - share * np.diff(q, axis=0, prepend=q[:1]))


def _explanations(
    views: _Views, names: Array, table_rows: tuple[int, ...], station: str
) -> Iterator[tuple[Reason, Mask | None]]:
    """Yield at most one mistake that explains the views that disagree, and which views, (V,), it concerns; None: all.

    ``names``, (V,), are those of the pictures, ``table_rows`` the numbers of all rows, and ``station`` is that of the
    camera.
    """
    off = ~views.agree
    values = {"camera": station, "off": int(np.sum(off)), "of": len(off)}
    of_turned = views.errors(views.seen_anew(_turned_images(views)))
    if _explains(views, off, of_turned):
        yield Reason.of(Why.PICTURES_TURNED, **values, named=names[off].tolist()), off
        return
    others, explained = _rows_instead(views, off)
    if np.mean(explained) >= _EXPLAINED:
        steps = (others - np.flatnonzero(off))[explained]
        if np.sum(off) > 2 and np.all(steps == steps[0]) and abs(steps[0]) == 1:
            place = np.flatnonzero(off)[0]
            row = int(table_rows[views.first[place]])
            errors = views.errors()
            sizes = {"given_m": rms(errors), "error_m": rms(errors[views.agree])}
            yield Reason.of(Why.ROWS_MOVED, **sizes, row=row, up=bool(steps[0] > 0)), None
            return
        if set(others[explained].tolist()) <= set(np.flatnonzero(off).tolist()):
            yield Reason.of(Why.PICTURES_EXCHANGED, **values, named=names[off].tolist()), off
            return

    from_view = _from_some_view_on(off)
    share, of_focus = 0.0, np.full(len(off), np.inf)
    if from_view is not None:
        share, of_focus = _refocused(views, off)
    displacement, of_moved = _moved_camera(views, off)
    is_simpler = np.median(of_focus[off]) <= _AS_GOOD * np.median(of_moved[off])
    if from_view is not None and _explains(views, off, of_focus) and is_simpler:
        named = {"first": str(names[from_view]), "named": names[off].tolist()}
        yield Reason.of(Why.CAMERA_REFOCUSED, **values, **named, share=share), off
        return
    if np.sum(off) >= _FEWEST_MOVED and _explains(views, off, of_moved):
        first = "" if from_view is None else str(names[from_view])
        angle = np.arccos(np.clip((np.trace(displacement[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
        moved = {"moved_m": float(np.linalg.norm(displacement[:3, 3])), "moved_rad": float(angle)}
        reason = Reason.of(
            Why.CAMERA_MOVED, **values, first=first, named=names[off].tolist(), **moved
        )
        yield reason, off


def _explains(views: _Views, off: Mask, errors: Array) -> bool:
    """Return whether most of the views that were off, (V,), agree by these errors, (V,) [m]."""
    return bool(np.mean(errors[off] < views.limit) >= _EXPLAINED)


def _from_some_view_on(off: Mask) -> int | None:
    """Return the first view after which all are off, (V,), or before which: from 0; None if others are, too."""
    count = int(np.sum(off))
    if np.all(off[-count:]):
        return len(off) - count
    if np.all(off[:count]):
        return count
    return None


def _turned_images(views: _Views) -> Array:
    """Return the images of all N rows, (N, K) [px], turned by half a turn about the middle of the picture."""
    groups = views.setup.groups
    measured = views.rows.measured.copy()
    for f in np.unique(views.rows.samples.frame[views.first]).tolist():
        camera = views.cell.cameras.get(groups[f], views.cell.cameras.get(""))
        if camera is not None:
            of_camera = views.rows.samples.frame == f
            size = np.array([camera.width, camera.height]) - 1.0
            measured[of_camera, :2] = size - measured[of_camera, :2]
    return np.asarray(measured)


def _rows_instead(views: _Views, off: Mask) -> tuple[Integers, Mask]:
    """Return for each of k views that are off the one whose joint values explain it best, and whether these do, (k,).

    Those of its own are not tried.
    """
    numbers = np.flatnonzero(off)
    errors = np.full((len(numbers), len(off)), np.inf)
    for other in range(len(off)):
        tips = np.repeat(views.T_base_tip[other][None], len(off), axis=0)
        errors[:, other] = np.where(numbers == other, np.inf, views.errors(tips=tips)[numbers])
    nearest = np.argmin(errors, axis=1)
    return nearest, errors[np.arange(len(numbers)), nearest] < views.limit


def _refocused(views: _Views, off: Mask) -> tuple[float, Array]:
    """Return the change of the focal length, as a share, that explains views that are off, and the errors, (V,) [m]."""
    predicted = views.setup.target_poses(views.T_base_tip, views.poses.samples)[:, :3, 3]
    ratio = np.linalg.norm(predicted, axis=1) / np.linalg.norm(views.poses.measured[:, :3], axis=1)
    factor = float(np.median(ratio[off]))
    internals = views.rows.samples.internals
    assert internals is not None
    changed = internals.copy()
    changed[:, FOCAL] *= factor
    return factor - 1.0, views.errors(views.seen_anew(internals=changed))


def _moved_camera(views: _Views, off: Mask) -> tuple[Array, Array]:
    """Return the displacement, (4, 4) [m], of a camera that explains views that are off, and the errors, (V,) [m]."""
    targets = np.ones_like(views.setup.target_unknown)
    f = int(views.poses.samples.frame[0])
    unseen = np.arange(len(views.setup.groups)) != f
    free = replace(
        views.setup.with_fixed(unseen, targets),
        unknown=tuple(DIRECTIONS if k == f else () for k in range(len(unseen))),
    )
    placed = register_all_rows(
        views.T_base_tip[off], free, views.poses.select(off), tolerance=_TOLERANCE
    )
    displacement = placed.T_frame_base[f] @ np.linalg.inv(views.setup.T_frame_base[f])
    return displacement, _errors(placed, views.T_base_tip, views.poses)

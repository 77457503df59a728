"""evaluate: how far a robot is off, without changing it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.data.cell import Cell
from calib.data.kinds import DIRECTIONS
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError, choices
from calib.estimate.registration import nominal_setup
from calib.estimate.setup import Setup, rows_of
from calib.estimate.statistics import Errors
from calib.model.kinematics import Samples
from calib.result.calibration import Calibration
from calib.result.prediction import Larger
from calib.result.support import better_setup
from calib.result.verdict import Reason
from calib.robot.kernel import one_blas_thread
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Place = Literal["frame", "target"]

#: What of an earlier result can be taken for known.
PLACES: tuple[Place, ...] = ("frame", "target")

#: A place found anew must make an rms above the last [m] this many times smaller, with this many numbers an unknown.
_BETTER, _NUMBERS, _SMALL = 3.0, 3, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Errors of a robot as it is."""

    robot: Robot  #: The robot
    measurements: Measurements  #: All rows
    setup: Setup  #: Frames and targets as given or registered
    #: What was registered to the rows: some of ``"target"`` and ``"frame"``
    registered: tuple[str, ...]
    #: shape (N, D), measured minus predicted: lengths [m] in the first columns, angles [rad] in three more
    residual: Array
    used: Mask  #: shape (N, D), which scalars were measured

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """The (first) target in the tip, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

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
) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the
    estimation rows (to all rows where there are none).

    Args:
        robot: The robot, nominal or corrected.
        measurements: The rows.
        cell: Target and frame, where they are known.
        known: Frames and targets of an earlier result, which win over the cell's: `Calibration.setup`, or its
            ``nominal_setup`` for the nominal robot.
        which: Whether its ``"frame"``, its ``"target"`` or both are meant.

    Raises:
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
        ModelError: The table has a set-up that neither the earlier result nor the cell knows.
    """
    return _evaluated(robot, measurements, cell or Cell(), known, which)


def evaluate_larger(
    c: Calibration,
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    which: tuple[str, ...] = PLACES,
) -> Evaluation | None:
    """Compare the larger model of a result with measurements, see `evaluate`; None where it has none.

    The cell's payload wins over the result's.
    """
    if c.larger is None:
        return None
    nominal = c.uncorrected(robot)
    cell = replace(cell, payload=cell.payload or c.larger.payload, gravity=c.larger.gravity)
    larger = replace(c.larger, kinematics=replace(c.larger.kinematics, robot=nominal))
    return _evaluated(nominal, measurements, cell, larger.setup, which, larger)


def _evaluated(
    robot: Robot,
    measurements: Measurements,
    cell: Cell,
    known: Setup | None,
    which: tuple[str, ...],
    larger: Larger | None = None,
) -> Evaluation:
    """The errors of a robot, or of a larger model."""
    every, setup = rows_of(robot, measurements, cell)
    setup = setup if known is None else _at_known(setup, known, which)
    q = every.joints
    poses = robot.poses(q) if larger is None else larger.tips(Samples.at(q, every.samples.load))
    chosen = registering(measurements)
    placed = nominal_setup(poses[chosen], setup, every.select(chosen))
    frames = zip(setup.unknown, setup.frame_given, strict=True)
    unknown = {
        "target": bool(np.any(setup.target_unknown & ~setup.target_given)),
        "frame": any(directions and not given for directions, given in frames),
    }
    return Evaluation(
        robot=robot,
        measurements=measurements,
        setup=placed,
        registered=tuple(name for name, missing in unknown.items() if missing),
        residual=read_only(every.residual(placed.seen(poses, every.samples))),
        used=every.used,
    )


def registering(m: Measurements) -> Mask:
    """The rows that something is registered to, shape (N,): the estimation rows, or all where there are none."""
    return m.estimation if np.any(m.estimation) else np.ones(len(m), dtype=bool)


def _at_known(setup: Setup, known: Setup, which: tuple[str, ...]) -> Setup:
    """A table's set-up with the frames and targets of an earlier result.

    The only one of a result stands for the only one of a table, whatever their names are.
    """

    def found(
        what: str, own: tuple[str, ...], names: tuple[str, ...], poses: Array, into: Array
    ) -> Mask:
        """Put known poses in place, by name or the only one for the only one; which were found."""
        alone = len(own) == len(names) == 1
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
        setup.as_known(framed, fixed).placed(frames, targets),
        frame_given=setup.frame_given | framed,
        target_given=np.where(aimed, fixed, setup.target_given),
    )


def hint(evaluation: Evaluation, cell: Cell) -> Reason | None:
    """A set-up that explains the rows far better than the evaluation's cell."""
    every, setup = rows_of(evaluation.robot, evaluation.measurements, cell)
    rows = every.select(registering(evaluation.measurements))
    return better_setup(evaluation.robot, cell, setup, rows)


class Moved(NamedTuple):
    """The place whose registration explains the errors of fresh rows, and their rms with the old and the new [m]."""

    place: Place
    before: float
    after: float


def moved(robot: Robot, measurements: Measurements, cell: Cell, known: Setup) -> Moved | None:
    """Which of frame and target explains the errors of fresh rows by far when found anew."""
    before = evaluate(robot, measurements, cell, known=known)
    rms, found = before.errors["all"].rms, []
    if before.registered or not rms > _SMALL:
        return None
    anew: dict[Place, Cell] = {
        "frame": replace(cell, estimate_frame=True, frame_directions=DIRECTIONS),
        "target": replace(cell, estimate_target=True),
    }
    for what, open_cell in anew.items():
        kept = tuple(one for one in PLACES if one != what)
        try:
            after = evaluate(robot, measurements, open_cell, known=known, which=kept)
        except CalibError:
            continue  # too few rows to find it
        unknowns = after.setup.count
        if unknowns and int(after.used.sum()) >= _NUMBERS * unknowns:
            found.append(Moved(what, rms, after.errors["all"].rms))
    best = min(found, key=lambda one: one.after, default=None)
    return best if best and _BETTER * best.after <= rms else None

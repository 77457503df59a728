"""evaluate: how far a robot is off, without changing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.identify.fitting import nominal_setup, seen_from
from calib.identify.rows import Rows
from calib.identify.setup import Setup
from calib.identify.setup_check import better_setup
from calib.identify.statistics import Errors
from calib.identify.table_rows import rows_of
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only
from calib.model.threads import one_blas_thread

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Frames and targets of an earlier result, which win over what a cell says of them.

    The only one of a result stands for the only one of a table, whatever their names are. None of a kind: the cell's.

    Attributes:
        frames: T_frame_base of each set-up by name, shape (4, 4), [m].
        targets: T_tip_target of each target by name, shape (4, 4), [m].
        rotation: Whether the targets' orientations are known, and not their positions alone.
    """

    frames: Mapping[str, Array]
    targets: Mapping[str, Array]
    rotation: bool = False

    def placed(self, setup: Setup) -> Setup:
        """A table's set-up with what is known here.

        Raises:
            ModelError: The table has a set-up that is not known here, and the cell does not say where it stands.
        """
        frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
        framed, aimed = np.zeros(len(frames), dtype=bool), np.zeros(len(targets), dtype=bool)
        for f, group in enumerate(setup.groups):
            found = _named(group, self.frames, alone=len(frames) == 1)
            if found is not None:
                frames[f], framed[f] = found, True
        for t, name in enumerate(setup.targets):
            found = _named(name, self.targets, alone=len(targets) == 1)
            if found is not None:
                targets[t], aimed[t] = found, True
        lost = [
            group
            for group, known, directions in zip(setup.groups, framed, setup.unknown, strict=True)
            if self.frames and not known and not directions
        ]
        if lost:
            message = (
                f"The result has the set-ups {choices(self.frames)}; the table's {choices(lost)} are none of them. Let "
                "the measurement frames be found (--frame estimate), or give them in a cell file."
            )
            raise ModelError(message)
        # A position is not enough where orientations are to be met: then it is where the target is looked for.
        known = aimed if self.rotation or not setup.rotation else np.zeros_like(aimed)
        placed = setup.as_known(framed, known).placed(frames, targets)
        return replace(
            placed,
            frame_given=setup.frame_given | framed,
            target_given=np.where(aimed, known, setup.target_given),
        )


def _named(name: str, known: Mapping[str, Array], *, alone: bool) -> Array | None:
    """A pose by name; the only one for the only one."""
    return next(iter(known.values())) if alone and len(known) == 1 else known.get(name)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Errors of a robot as it is.

    Attributes:
        robot: The robot.
        measurements: All rows.
        setup: Frames and targets as given or registered.
        registered: What was registered to the rows: some of ``"target"`` and ``"frame"``.
        residual: shape (N, D), measured minus predicted: lengths [m] in the first columns, angles [rad] in three more.
        used: shape (N, D), which scalars were measured.
    """

    robot: Robot
    measurements: Measurements
    setup: Setup
    registered: tuple[str, ...]
    residual: Array
    used: NDArray[np.bool_]

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
        m = self.measurements
        return {
            "estimation": Errors.of(self.residual[m.estimation], self.used[m.estimation]),
            "validation": Errors.of(self.residual[m.validation], self.used[m.validation]),
            "all": Errors.of(self.residual, self.used),
        }


@one_blas_thread()
def evaluate(
    robot: Robot,
    measurements: Measurements,
    cell: Cell | None = None,
    *,
    known: Known | None = None,
) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the
    estimation rows (to all rows where there are none), so that the errors say what the robot is worth and not where
    the tracker stands.

    Args:
        robot: The robot, nominal or corrected.
        measurements: The rows.
        cell: Target and frame, where they are known.
        known: Frames and targets of an earlier result, which win over the cell's.

    Raises:
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
        ModelError: The table has a set-up that neither the earlier result nor the cell knows.
    """
    cell = Cell() if cell is None else cell
    every, setup = rows_of(robot, measurements, cell)
    setup = setup if known is None else known.placed(setup)
    chosen = measurements.estimation
    T_base_tip = robot.poses(every.joints)
    chosen = chosen if np.any(chosen) else np.ones(len(every), dtype=bool)
    placed = nominal_setup(T_base_tip[chosen], setup, every.select(chosen))
    return evaluation_at(robot, measurements, every, setup, placed, T_base_tip)


def evaluation_at(
    robot: Robot,
    measurements: Measurements,
    every: Rows,
    asked: Setup,
    placed: Setup,
    T_base_tip: Array,
) -> Evaluation:
    """The errors of given poses of the tip.

    Args:
        robot: The robot.
        measurements: All rows.
        every: The same as the fit takes them.
        asked: Frames and targets as given.
        placed: The same, with what was not given where it was registered.
        T_base_tip: shape (N, 4, 4), pose of the tip in each row [m].
    """
    frame_is_open = any(
        directions and not given
        for directions, given in zip(asked.unknown, asked.frame_given, strict=True)
    )
    unknown = (
        ("target", bool(np.any(asked.target_unknown & ~asked.target_given))),
        ("frame", frame_is_open),
    )
    return Evaluation(
        robot=robot,
        measurements=measurements,
        setup=placed,
        registered=tuple(name for name, missing in unknown if missing),
        residual=read_only(every.residual(seen_from(placed, T_base_tip, every))),
        used=every.used,
    )


def hint(evaluation: Evaluation, cell: Cell) -> str:
    """A sentence that names a set-up which explains the rows far better, or nothing.

    Args:
        evaluation: Of a robot.
        cell: The cell that it was evaluated with.
    """
    m = evaluation.measurements
    every, setup = rows_of(evaluation.robot, m, cell)
    rows = every.select(m.estimation) if np.any(m.estimation) else every
    return better_setup(evaluation.robot, cell, setup, rows)

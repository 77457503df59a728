"""What the rows are that a robot is evaluated on: those that a result was fitted to, or no measurements at all."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from calib.errors import CalibError, MeasurementError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.identify.accuracy import Accuracy
    from calib.identify.evaluation import Evaluation
    from calib.identify.result import Calibration
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot

#: A column that every table of commands has, and how exactly the poses to send are those of the nominal robot [m].
_COMMANDS, _EXACT = "correction position", 1e-6


@dataclass(frozen=True)
class Fitted:
    """What a result was fitted to.

    Attributes:
        result: The result; None where there is none.
    """

    result: Calibration | None

    def among(self, robot: Robot, measurements: Measurements, cell: Cell) -> NDArray[np.bool_]:
        """Which rows it was fitted to, shape (N,): by its own frames and targets, whatever is judged.

        In the very file these are the estimation rows where none is known again.

        Args:
            robot: The robot.
            measurements: The rows.
            cell: The set-up.
        """
        import numpy as np

        from calib.identify.acceptance_rows import FittedRows
        from calib.identify.evaluation import evaluate

        found, c = np.zeros(len(measurements), dtype=bool), self.result
        if c is None:
            return found
        both = ((c.uncorrected(robot), c.nominal_setup), (c.corrected(robot), c.setup))
        # A set-up that the result does not know has none of its rows.
        with contextlib.suppress(CalibError):
            found = FittedRows.of(c).among(
                *(evaluate(one, measurements, cell, known=known) for one, known in both)
            )
        same = bool(c.source.sha256) and c.source.sha256 == measurements.sha256
        return measurements.estimation if same and not np.any(found) else found

    def outside(self, evaluation: Evaluation, judged: Accuracy) -> str:
        """A sentence that names the judged rows with joint values that the fit did not see, or nothing.

        Args:
            evaluation: Of the robot that is judged.
            judged: Its accuracy.
        """
        import numpy as np

        from calib.identify.coverage import outside, outside_sentence

        if self.result is None:
            return ""
        robot, m = evaluation.robot, evaluation.measurements
        ranges = dict(zip(self.result.nominal.joint_names, self.result.ranges, strict=True))
        # A joint that turns without end has no range to be outside of.
        known = [
            k
            for k, joint in enumerate(robot.inputs)
            if joint.type != "continuous" and np.isfinite(ranges.get(joint.name, np.nan)).all()
        ]
        names = [robot.joint_names[k] for k in known]
        ends = np.array([ranges[name] for name in names]).reshape(-1, 2).T
        types = [robot.inputs[k].type for k in known]
        chosen = np.isin(m.rows, [row for pose in judged.poses for row in pose.rows[:1]])
        q = m.joints_for(robot.joint_names)[chosen][:, known]
        said = outside_sentence(outside(ends, q, names, types), np.array(m.rows)[chosen])
        return f"The calibration did not see such joint values: {said}." if said else ""


def check_measured(nominal: Robot, measurements: Measurements) -> None:
    """Refuse a table of commands whose poses to send would be taken for measured ones.

    They are what the nominal robot predicts, and any tolerance would seem to be kept.

    Args:
        nominal: The nominal robot.
        measurements: What was read from the table.

    Raises:
        MeasurementError: The points are those of the nominal robot, with a tool and in a frame of any kind.
    """
    from calib.identify.evaluation import evaluate
    from calib.measure.cell import Cell
    from calib.units import split_header

    m = measurements
    if _COMMANDS not in {split_header(label)[0] for label in m.ignored}:
        return
    for cell in (Cell(), Cell(estimate_frame=True)):
        try:
            found = evaluate(nominal, m, cell)
        except CalibError:
            return  # too few rows to tell
        if found.used.sum() > found.setup.count and found.errors["all"].max < _EXACT:
            message = (
                f"{m.source}: these are commands that 'calib compensate' wrote, and x, y, z are the poses to send, "
                "which the nominal robot predicts; nothing was measured. Put what was measured in their place, or give "
                "it as a list of its own with --points."
            )
            raise MeasurementError(message)

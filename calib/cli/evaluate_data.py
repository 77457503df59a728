"""What the rows are that a robot is evaluated on: those that a result was fitted to, or no measurements at all."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from calib.errors import CalibError, FileError, MeasurementError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.identify.acceptance_rows import FittedRows
    from calib.identify.accuracy import Accuracy
    from calib.identify.evaluation import Evaluation
    from calib.identify.stored import StoredResult
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot

#: A column that every table of commands has, and how exactly the poses to send are those of the nominal robot [m].
_COMMANDS, _EXACT = "correction position", 1e-6


@dataclass(frozen=True)
class Fitted:
    """What a result was fitted to.

    Attributes:
        rows: The rows that are known again.
        sha256: Of the table; empty where it was no file.
        ranges: The smallest and the largest value of each joint [rad] or [m].
    """

    rows: FittedRows
    sha256: str
    ranges: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, result: Mapping[str, Any] | None, name: str) -> Fitted:
        """From the tables of a result; nothing is known without one.

        Args:
            result: The tables.
            name: Name of its file.

        Raises:
            FileError: Something is missing or of another kind.
        """
        from calib.identify.acceptance_rows import FittedRows

        if result is None:
            return cls(FittedRows({}), "", {})
        try:
            return cls(
                FittedRows.of(result["rows"]),
                str(result["inputs"]["measurements"]["sha256"]),
                {
                    str(one["joint"]): (float(one["low"]), float(one["high"]))
                    for one in result["robot"].get("ranges", ())
                    if one["low"] is not None and one["high"] is not None
                },
            )
        except (KeyError, TypeError, ValueError) as error:
            from calib.model.json_file import damage

            message = (
                f"{name}: what the result was fitted to is missing or damaged ({damage(error)}). Write it again with "
                "'calib fit --json'."
            )
            raise FileError(message) from error

    def among(
        self, robot: Robot, measurements: Measurements, cell: Cell, stored: StoredResult | None
    ) -> NDArray[np.bool_]:
        """Which rows it was fitted to, shape (N,): by its own frames and targets, whatever is judged.

        In the very file these are the estimation rows where none is known again.

        Args:
            robot: The robot.
            measurements: The rows.
            cell: The set-up.
            stored: The result.
        """
        import numpy as np

        from calib.identify.evaluation import evaluate

        found = np.zeros(len(measurements), dtype=bool)
        if stored is not None and stored.nominal_known is not None:
            both = (
                (stored.nominal(robot), stored.nominal_known),
                (stored.corrected(robot), stored.known),
            )
            # A set-up that the result does not know has none of its rows.
            with contextlib.suppress(CalibError):
                found = self.rows.among(
                    *(evaluate(one, measurements, cell, known=known) for one, known in both)
                )
        same = bool(self.sha256) and self.sha256 == measurements.sha256
        return measurements.estimation if same and not np.any(found) else found

    def outside(self, evaluation: Evaluation, judged: Accuracy) -> str:
        """A sentence that names the judged rows with joint values that the fit did not see, or nothing.

        Args:
            evaluation: Of the robot that is judged.
            judged: Its accuracy.
        """
        import numpy as np

        from calib.identify.coverage import outside, outside_sentence

        robot, m = evaluation.robot, evaluation.measurements
        # A joint that turns without end has no range to be outside of.
        known = [
            k
            for k, joint in enumerate(robot.inputs)
            if joint.type != "continuous" and joint.name in self.ranges
        ]
        names = [robot.joint_names[k] for k in known]
        ends = np.array([self.ranges[name] for name in names]).reshape(-1, 2).T
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

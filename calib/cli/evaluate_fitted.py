"""What a result was fitted to, as far as it matters for the rows that it is evaluated on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from calib.errors import FileError

if TYPE_CHECKING:
    from calib.identify.accuracy import Accuracy
    from calib.identify.evaluation import Evaluation
    from calib.measure.measurements import Measurements


@dataclass(frozen=True)
class Fitted:
    """What a result was fitted to.

    Attributes:
        sha256: Of the table; empty where it was no file.
        ranges: The smallest and the largest value of each joint [rad] or [m].
    """

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
        if result is None:
            return cls("", {})
        try:
            return cls(
                str(result["inputs"]["measurements"]["sha256"]),
                {
                    str(one["joint"]): (float(one["low"]), float(one["high"]))
                    for one in result["robot"].get("ranges", ())
                    if one["low"] is not None and one["high"] is not None
                },
            )
        except (KeyError, TypeError, ValueError) as error:
            message = (
                f"{name}: what the result was fitted to is missing or damaged ({error!r}). Write it again with "
                "'calib fit --json'."
            )
            raise FileError(message) from error

    def same(self, measurements: Measurements) -> bool:
        """Whether it was fitted to this very file."""
        return bool(self.sha256) and self.sha256 == measurements.sha256

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

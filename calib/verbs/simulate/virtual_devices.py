"""A virtual instrument and a virtual robot for sessions: ``calib measure --reader virtual:3`` needs no hardware.

The instrument has the robot and the cell of the session, with errors drawn by a seed, and measures where the session
proposes. The joint values that are noted are the proposed ones, as if they were typed.
"""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

import numpy as np

from calib.basics.arrays import Array
from calib.basics.units import split_header
from calib.errors import DeviceError
from calib.verbs.measure.devices.reading import Context, Reading
from calib.verbs.simulate.operator import NO_MISTAKES, USUAL_MISTAKES, Operator
from calib.verbs.simulate.scenario_words import read_scenario

if TYPE_CHECKING:
    from calib.data.measurements import Measurements

#: What stands after the reader's name: a seed, and whether the operator makes mistakes.
_ARGUMENT = re.compile(r"(\d{1,9})?(,mistakes)?")


class VirtualReader:
    """A virtual operator at the session's own robot and cell, who measures each pose that is proposed once."""

    def __init__(self, argument: str, context: Context) -> None:
        """Draw the cell by the seed of an argument such as ``"3"`` or ``"3,mistakes"``."""
        words = _ARGUMENT.fullmatch(argument.replace(" ", ""))
        if words is None:
            raise DeviceError(
                f"The reader 'virtual' was given '{argument}'; it takes a seed, 'virtual:3', or 'virtual:3,mistakes' "
                "for an operator who makes some."
            )
        if context.robot is None or context.cell is None:
            raise DeviceError(
                "The reader 'virtual' measures the robot of a session, and is not opened by one."
            )
        seed = int(words[1] or 0)
        virtual = read_scenario(context.robot, context.cell).draw(seed)
        self._operator = Operator.of(virtual, seed, USUAL_MISTAKES if words[2] else NO_MISTAKES)
        self._before: Array | None = None
        self._proposed: Array | None = None

    def propose(self, joints: Array) -> None:
        """Take the pose to measure next, shape (m,), [rad] or [m]; the same one again is measured with care."""
        self._proposed = np.array(joints, dtype=np.float64)

    def read(self, timeout: float | None = None) -> Reading | None:
        """Return the reading of the pose that was proposed last, once; None if there is none within the time [s].

        Raises:
            DeviceError: No pose was proposed, and there is no limit of time.
            CalibError: The camera does not see the board at that pose.
        """
        proposed, self._proposed = self._proposed, None
        if proposed is None:
            if timeout is None:
                raise DeviceError("The virtual operator waits for a pose; none was proposed.")
            time.sleep(timeout)
            return None
        again = self._before is not None and bool(np.array_equal(self._before, proposed))
        self._before = proposed
        measurement = self._operator.measure(proposed, again=again)
        return Reading(_cells(measurement.readings), source=f"reading {measurement.number}")

    def close(self) -> None:
        """Nothing is open."""


class VirtualController:
    """A robot that stands where it is proposed."""

    def __init__(self, argument: str, _: Context) -> None:
        """Refuse an argument: the robot is that of the session."""
        if argument:
            raise DeviceError(
                f"The controller 'virtual' takes nothing after its name, not '{argument}'."
            )
        self._joints: Array | None = None

    def propose(self, joints: Array) -> None:
        """Drive to a pose, shape (m,), [rad] or [m]."""
        self._joints = np.array(joints, dtype=np.float64)

    def joints(self) -> Array:
        """Return where the robot stands, shape (m,), [rad] or [m]; DeviceError if no pose was proposed yet."""
        if self._joints is None:
            raise DeviceError("The virtual robot waits for a pose; none was proposed yet.")
        return self._joints

    def close(self) -> None:
        """Nothing is open."""


def _cells(table: Measurements) -> tuple[dict[str, str | float], ...]:
    """Return the rows of a table as cells by header, without those of the joints and of the row's number."""
    left_out = {"row", "set"}
    columns = {
        header: cells
        for header, cells in table.columns().items()
        if header not in left_out and split_header(header)[0] not in table.joint_names
    }
    rows = []
    for k in range(len(table)):
        cells = {header: values[k] for header, values in columns.items()}
        rows.append({h: c for h, c in cells.items() if isinstance(c, (str, float)) and c != ""})
    return tuple(rows)

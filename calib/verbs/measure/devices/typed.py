"""A controller without a connection: the operator drives the robot, and types joint values if they are others."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.units import find_unit, split_header
from calib.errors import DeviceError
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.devices.rows import bare_row


class TypedController:
    """Says the joint values of the proposed pose, until others are typed."""

    def __init__(self, argument: str, context: Context) -> None:
        if argument:
            raise DeviceError(
                f"The controller 'typed' takes nothing after its name, not '{argument}'."
            )
        slides = [context.joint_types.get(name) == "prismatic" for name in context.joint_names]
        #: Headers of what is typed, in the units of teach pendants: ``"elbow_joint [deg]"``.
        self.headers = tuple(
            f"{name} [{'mm' if is_length else 'deg'}]"
            for name, is_length in zip(context.joint_names, slides, strict=True)
        )
        self._joints: Array | None = None
        #: True if the joint values were typed since the last pose was proposed.
        self.is_typed = False

    def propose(self, joints: Array) -> None:
        """Take the joint values of the pose that the operator drives to, shape (m,), [rad] or [m]."""
        self._joints = read_only(np.asarray(joints, dtype=np.float64))
        self.is_typed = False

    def enter(self, text: str) -> None:
        """Take joint values as typed, in the units of `headers` and in their order, with decimal points or commas.

        Args:
            text: Such as ``"10,5 -90 0 45 90 0"``.

        Raises:
            MeasurementError: These are not as many numbers as the robot has joints.
        """
        row = bare_row(text, 1, "what was typed", self.headers)
        units = [split_header(header)[1] or "" for header in self.headers]
        to_si = np.array([find_unit(unit).to_si for unit in units])
        values = np.array([float(row.cells[header]) for header in self.headers])
        self._joints = read_only(values * to_si)
        self.is_typed = True

    def joints(self) -> Array:
        """Return the joint values that were proposed or typed last, shape (m,), [rad] or [m].

        Raises:
            DeviceError: There are none yet.
        """
        if self._joints is None:
            raise DeviceError("No pose was proposed, and no joint values were typed yet.")
        return self._joints

    def close(self) -> None:
        """Nothing is open."""

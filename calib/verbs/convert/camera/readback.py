"""A frame fixed to a link of a URDF, read back by Pinocchio and by yourdfpy before the file is written."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.errors import UrdfError
from calib.robot.full_model import full_model, link_frame
from calib.robot.readback import TOLERANCE, yourdfpy_model
from calib.robot.urdf import Urdf


def check_fixed_frame(urdf: Urdf, link: str, frame: str, T_link_frame: Array) -> None:
    """Compare the pose of a link in another one, as two readers of the URDF have it, with what it should be.

    Args:
        urdf: The URDF that is to be written.
        link: The link in which the pose is given.
        frame: The link whose pose is given, fixed to it.
        T_link_frame: The pose, shape (4, 4) [m].

    Raises:
        UrdfError: A reader has it elsewhere by more than `calib.robot.readback.TOLERANCE`, or cannot read the URDF.
    """
    written = Urdf.from_bytes(urdf.data, urdf.source)
    _compare("Pinocchio", _by_pinocchio(written, link, frame), frame, T_link_frame)
    _compare("yourdfpy", yourdfpy_model(written).get_transform(frame, link), frame, T_link_frame)


def _by_pinocchio(urdf: Urdf, link: str, frame: str) -> Array:
    """Return the pose of a link in another one by Pinocchio, shape (4, 4) [m]."""
    model = full_model(urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    T_root_link, T_root_frame = (data.oMf[link_frame(model, name)] for name in (link, frame))
    return np.asarray((T_root_link.inverse() * T_root_frame).homogeneous)


def _compare(reader: str, T_read: Array, frame: str, T_expected: Array) -> None:
    """Refuse a pose (4, 4) [m] of a frame, by a reader of the URDF, that is not the one expected."""
    off = np.abs(T_read - T_expected)
    if not off.max() <= TOLERANCE:
        raise UrdfError(
            f"The URDF, read back by {reader}, has '{frame}' {off[:3, 3].max():.2e} m and {off[:3, :3].max():.2e} rad "
            f"away from its estimated pose; {TOLERANCE:g} is allowed. It is not written. Please report this with the "
            "URDF."
        )

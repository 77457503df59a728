"""Measurement frames that were not found: where one is sought, far-off rows may be due to the place where it is put."""

from __future__ import annotations

from calib.diagnosis.reasons import Reason, Why
from calib.fit.registration.frame_search import frames_to_search, is_plausible
from calib.fit.registration.registration import nominal_setup
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.robot.robot import Robot


def frame_not_found(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Name a frame that registration sought and did not find.

    A frame that stands right leaves the errors of an uncalibrated arm. Where the best place leaves far larger ones, it
    is a local minimum, or the robot or the table is wrong: the rows cannot tell which.

    Args:
        robot: The nominal robot.
        setup: Frames and targets as given, with what is estimated of them.
        rows: N rows that are fitted.

    Returns:
        The first such frame by the name of its station; None if there is none, or none was sought.

    Raises:
        MeasurementError: Fewer numbers than unknowns.
    """
    sought = frames_to_search(setup, rows)
    if not sought:
        return None
    T_base_tip = robot.poses(rows.joints)
    placed = nominal_setup(T_base_tip, setup.with_estimated_not_given(), rows)
    for f in sought:
        of_frame = rows.with_partners(rows.samples.frame == f)
        if not is_plausible(placed, T_base_tip[of_frame], rows.select(of_frame)):
            station = setup.groups[f] if len(setup.groups) > 1 else ""
            return Reason.of(Why.FRAME_NOT_FOUND, station=station)
    return None

"""Whether fresh rows look as if tracker or target were no longer where a result has them."""

from __future__ import annotations

from dataclasses import replace

from calib.errors import CalibError
from calib.identify.evaluation import Known, evaluate
from calib.measure.cell import DIRECTIONS, Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

#: What is found anew must make the rms this many times smaller, and leave this many numbers for each unknown.
_BETTER, _NUMBERS = 3.0, 3

#: Errors below this need no explanation [m].
_SMALL = 1e-4


def moved(robot: Robot, measurements: Measurements, cell: Cell, known: Known) -> str:
    """A sentence that says which of frame and target explains the errors by far when found anew, or nothing.

    Args:
        robot: The calibrated robot.
        measurements: Fresh rows.
        cell: The set-up.
        known: Frames and targets of the result.
    """
    before = evaluate(robot, measurements, cell, known=known)
    rms = before.errors["all"].rms
    if before.registered or not rms > _SMALL:
        return ""
    anew = {
        "frame": (
            replace(cell, estimate_frame=True, frame_directions=DIRECTIONS),
            replace(known, frames={}),
        ),
        "target": (replace(cell, estimate_target=True), replace(known, targets={})),
    }
    found = {}
    for what, (open_cell, open_known) in anew.items():
        try:
            after = evaluate(robot, measurements, open_cell, known=open_known)
        except CalibError:
            continue  # too few rows to find it
        unknowns = after.setup.count
        if unknowns and int(after.used.sum()) >= _NUMBERS * unknowns:
            found[what] = after.errors["all"].rms
    best = min(found, key=lambda what: found[what], default="")
    if not best or _BETTER * found[best] > rms:
        return ""
    advice = {
        "frame": "measurement frame is found anew: did the tracker, or the robot's foot, move since the calibration? "
        "Then add --frame estimate.",
        "target": "target is found anew: was it mounted anew since the calibration? Then give its place with --target.",
    }[best]
    return (
        f"The rms is {1e3 * rms:.3g} mm with frame and target of the result, and only {1e3 * found[best]:.3g} mm if "
        f"the {advice}"
    )

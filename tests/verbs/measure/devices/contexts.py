"""What sessions of tests tell their readers and controllers."""

from __future__ import annotations

from calib.verbs.measure.devices.reading import Context

#: Joints of a UR.
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

#: A UR and a tracker whose lines say their units in a header.
UR = Context(JOINTS, dict.fromkeys(JOINTS, "revolute"))

#: Headers of three coordinates.
XYZ = ("x [mm]", "y [mm]", "z [mm]")

#: A UR and a tracker whose lines are three numbers.
BARE = Context(JOINTS, dict.fromkeys(JOINTS, "revolute"), columns=XYZ)

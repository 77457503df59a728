from __future__ import annotations

import numpy as np
import pytest

from calib.errors import ArgumentError, MeasurementError
from calib.verbs.measure.devices.reading import Context, Reading
from tests.verbs.measure.devices.contexts import JOINTS, UR

POINT = {"x [mm]": 512.25, "y [mm]": -30.5, "z [mm]": 1200.125}


def test_a_row_with_the_robot_s_joints_is_a_measurement():
    q = np.linspace(-1.0, 1.0, 6)
    measured = Reading.of(POINT).measurements(UR, q)
    assert measured.joint_names == JOINTS
    np.testing.assert_array_equal(measured.joints, [q])
    np.testing.assert_allclose(measured.points, [[0.51225, -0.0305, 1.200125]], rtol=1e-15)
    assert measured.kinds == ("point",)


def test_joints_of_the_reading_itself_are_read_with_their_units():
    row = POINT | {f"{name} [deg]": 10.0 * i for i, name in enumerate(JOINTS)}
    measured = Reading.of(row).measurements(UR)
    np.testing.assert_allclose(measured.joints, [np.radians([0, 10, 20, 30, 40, 50])])
    # Those of a controller count more.
    q = np.full(6, 0.5)
    np.testing.assert_array_equal(Reading.of(row).measurements(UR, q).joints, [q])
    with pytest.raises(MeasurementError, match="wrist_3_joint"):
        Reading.of({k: v for k, v in row.items() if "wrist_3" not in k}).measurements(UR)


def test_a_row_for_each_target_and_a_joint_that_slides():
    context = Context(("rail", "elbow"), {"rail": "prismatic", "elbow": "revolute"})
    assert context.joint_headers == ("rail [m]", "elbow [rad]")
    reading = Reading.of(POINT | {"target": "T1"}, POINT | {"target": "T2", "x [mm]": "100,5"})
    measured = reading.measurements(context, np.array([1.5, -0.25]))
    assert measured.targets == ("T1", "T2")
    assert measured.prismatic == ("rail",)
    np.testing.assert_array_equal(measured.joints, [[1.5, -0.25]] * 2)


def test_columns_can_be_renamed_and_poses_are_read():
    row = {"X [mm]": 100.0, "Y [mm]": 200.0, "Height [mm]": 300.0, "rx [deg]": 90.0}
    row |= {"ry [deg]": 0.0, "rz [deg]": 0.0}
    measured = Reading.of(row).measurements(UR, np.zeros(6), {"Height": "z"})
    assert measured.kinds == ("pose",)
    np.testing.assert_allclose(measured.points, [[0.1, 0.2, 0.3]])


def test_what_is_no_row_is_refused():
    with pytest.raises(ArgumentError, match="mappings from headers"):
        Reading.of((1.0, 2.0, 3.0))  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="no rows"):
        Reading().measurements(UR)
    without_units = Reading.of({"x": 1.0, "y": 2.0, "z": 3.0}, source="a.txt, line 4")
    with pytest.raises(MeasurementError, match=r"a\.txt, line 4, column 'x': .* no unit"):
        without_units.measurements(UR, np.zeros(6))


def test_a_reading_cannot_be_changed_from_outside():
    row = dict(POINT)
    reading = Reading.of(row)
    row["x [mm]"] = 0.0
    assert reading.rows[0]["x [mm]"] == 512.25

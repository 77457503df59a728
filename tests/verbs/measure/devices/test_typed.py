from __future__ import annotations

import numpy as np
import pytest

from calib.errors import DeviceError, MeasurementError
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.devices.typed import TypedController
from tests.verbs.measure.devices.contexts import UR


def test_the_joints_are_those_proposed_until_others_are_typed():
    controller = TypedController("", UR)
    with pytest.raises(DeviceError, match="No pose was proposed"):
        controller.joints()
    proposed = np.arange(6.0)
    controller.propose(proposed)
    proposed[0] = 9.0
    np.testing.assert_array_equal(controller.joints(), np.arange(6.0))
    controller.enter("10,5 -90 0 45 90 0")
    expected = np.radians([10.5, -90.0, 0.0, 45.0, 90.0, 0.0])
    np.testing.assert_allclose(controller.joints(), expected, rtol=1e-15)
    for text in ("10 20 30", "1 2 3 4 5 up", ""):
        with pytest.raises(MeasurementError, match="columns"):
            controller.enter(text)
    np.testing.assert_allclose(controller.joints(), expected, rtol=1e-15)
    controller.close()


def test_a_joint_that_slides_is_typed_in_millimetres():
    context = Context(("rail", "elbow"), {"rail": "prismatic", "elbow": "revolute"})
    controller = TypedController("", context)
    assert controller.headers == ("rail [mm]", "elbow [deg]")
    controller.enter("1500; 90")
    np.testing.assert_allclose(controller.joints(), [1.5, np.pi / 2])
    with pytest.raises(DeviceError, match="takes nothing after its name"):
        TypedController("deg", context)

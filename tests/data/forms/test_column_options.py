"""What is said of a table's columns besides their headers."""

import numpy as np
import pytest

from calib.data.forms.column_options import ColumnOptions, column_options
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from tests.data.tables import refused


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"brand": "cuka"}, "'cuka'.*--columns.*'kuka'"),
        ({"orientation": "abc"}, "'abc'.*--orientation.*'abb'"),
        ({"joint_unit": "grad"}, "--joint-unit.*'grad'.*'deg'.*'mm'"),
        ({"joint_unit": "deg rad"}, "--joint-unit.*'deg rad'"),
        ({"joint_unit": "N"}, "--joint-unit.*'N'"),
    ],
)
def test_words_that_are_refused(given, says):
    with pytest.raises(MeasurementError, match=says):
        ColumnOptions(**given)


def test_arguments_of_another_type_are_refused():
    for given in ({"names": ["a"]}, {"brand": 3}, {"joint_unit": ["deg"]}):
        with pytest.raises(CalibError):
            ColumnOptions(**given)


def test_a_mapping_is_all_that_is_said():
    assert column_options({"J1": "a"}) == ColumnOptions({"J1": "a"})
    assert column_options(None) == ColumnOptions()


def test_one_unit_for_all_joints_that_name_none(table):
    path = table("a,b [mrad],rail,x [mm],y [mm],z [mm]", "10,20,1500,300,400,500")
    types = {"a": "revolute", "b": "revolute", "rail": "prismatic"}
    for unit in ("deg mm", "mm deg"):
        m = Measurements.read(path, [*types], types, ColumnOptions(joint_unit=unit))
        np.testing.assert_allclose(m.joints, [[np.radians(10), 0.02, 1.5]], rtol=1e-15)
    only_angle = ColumnOptions(joint_unit="deg")
    says = ["column 'rail'", "--joint-unit mm"]
    refused(path, says, joint_names=[*types], joint_types=types, columns=only_angle)
    refused(path, ["column 'a'", "--joint-unit deg"], joint_names=[*types], joint_types=types)

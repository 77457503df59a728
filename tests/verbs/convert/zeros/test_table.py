"""The table of zeros reads back as it was written, also with names that need quotes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import FileError
from calib.verbs.convert.source import Source
from calib.verbs.convert.zeros.rms_errors import RmsErrors
from calib.verbs.convert.zeros.rounding import RoundedZeros, stored_number
from calib.verbs.convert.zeros.table import TABLE_ENDINGS, read_table, table_bytes
from tests.verbs.convert.zeros.arms import ur3_result


def rounded_and_errors() -> tuple[RoundedZeros, RmsErrors]:
    result = ur3_result()
    source = Source("result", result.robot, result.nominal, calibration=result)
    rounded = RoundedZeros.of(source, stored_number("zeros", 4096))
    return rounded, RmsErrors.of(result, rounded)


@pytest.mark.parametrize("ending", TABLE_ENDINGS)
@pytest.mark.parametrize("name", ["arm,left\"'", "#axis", "Ä"])
def test_names(ending: str, name: str):
    rounded, rms_errors = rounded_and_errors()
    zeros = replace(rounded.zeros, joints=(name, *rounded.zeros.joints[1:]))
    data = table_bytes(ur3_result().robot, replace(rounded, zeros=zeros), rms_errors, ending)
    assert read_table(data, ending)[name] == pytest.approx(0.3453)


@pytest.mark.parametrize("name", ["a\nb", "# axis"])
def test_a_name_that_a_table_cannot_hold_is_refused(name: str):
    rounded, rms_errors = rounded_and_errors()
    zeros = replace(rounded.zeros, joints=(name, *rounded.zeros.joints[1:]))
    with pytest.raises(FileError, match="rename"):
        table_bytes(ur3_result().robot, replace(rounded, zeros=zeros), rms_errors, ".csv")


def test_json_has_null_for_what_is_not_determined():
    rounded, rms_errors = rounded_and_errors()
    content = json.loads(table_bytes(ur3_result().robot, rounded, rms_errors, ".json"))
    last = content["joints"][-1]
    assert (last["determined"], last["change"], last["delta_rad"], last["std_rad"]) == (
        False,
        None,
        None,
        None,
    )
    std = [row["std_rad"] for row in content["joints"][:-1]]
    assert np.array(std) == pytest.approx(rounded.zeros.std[:-1])
    assert content["rms"]["nominal"]["m"] == rms_errors.nominal["m"]

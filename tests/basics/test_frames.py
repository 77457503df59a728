"""Frames of pandas and polars, and dicts of columns, are read as the table file that they were read from."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pandas as pd
import polars as pl
import pytest

import calib
from calib.basics.frames import frame_of, is_frame, table_of_frame
from calib.data.measurements import Measurements
from calib.errors import ArgumentError, CalibError, MeasurementError
from calib.example import paper_measurements
from tests.data.tables import assert_same

TABLE = paper_measurements()
COLUMNS = {
    "row": [4, 5, 7],
    "set": ["estimate", "estimate", "validate"],
    "joint_1 [deg]": [1.5, -20.0, 30.0],
    "lift [mm]": [100, 200, 300],
    "x [mm]": [300.25, np.nan, 1e3 / 7],
    "y [mm]": [0.0, np.nan, -1.0],
    "z [mm]": [50.0, np.nan, 60.5],
    "group": ["", "", "b"],
}


class Arrow:
    """The two attributes of a table of pyarrow that are used."""

    column_names = tuple(COLUMNS)
    columns = tuple(np.array(values, dtype=object) for values in COLUMNS.values())


@pytest.mark.parametrize(
    "frame",
    [
        COLUMNS,
        {name: np.array(values) for name, values in COLUMNS.items()},
        {name: tuple(values) for name, values in COLUMNS.items()},
        pd.DataFrame(COLUMNS),
        pd.DataFrame(COLUMNS).convert_dtypes(),
        pd.DataFrame(COLUMNS).astype({"row": float, "group": "category"}),
        pd.DataFrame(COLUMNS).astype(object),
        pd.DataFrame(COLUMNS, index=[3, 1, 2]),
        pl.DataFrame(COLUMNS),
        pl.DataFrame(COLUMNS).fill_nan(None),
        Arrow(),
    ],
)
def test_columns_of_any_library_are_one_table(frame):
    assert is_frame(frame)
    m = Measurements.of(frame, ["joint_1", "lift"], {"lift": "prismatic"})
    assert m.rows == (4, 7)
    assert m.unmeasured == (5,)
    assert (m.sets, m.groups) == (("estimate", "validate"), ("", "b"))
    np.testing.assert_array_equal(m.joints[:, 1], [0.1, 0.3])
    np.testing.assert_allclose(m.points[:, 0], [0.30025, 1 / 7], rtol=1e-15)
    assert m.source == type(frame).__name__


@pytest.mark.parametrize("read", [pd.read_csv, pl.read_csv])
def test_a_file_that_a_library_reads_is_the_file(read):
    frame = read(TABLE)
    m = Measurements.read(TABLE)
    assert_same(Measurements.of(frame), m, rtol=0)
    renamed = {"shoulder_pan_joint": "a [deg]", "x": "w"}
    with pytest.raises(
        MeasurementError, match=r"DataFrame: measured points need a column 'x \[mm\]'"
    ):
        Measurements.of(frame, columns=renamed)
    del renamed["x"]
    assert Measurements.of(frame, columns=renamed).joint_names[0] == "a"


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_measurements_go_out_and_in_again(library):
    for m in (Measurements.read(TABLE), Measurements.of(COLUMNS, ["joint_1", "lift"])):
        frame = m.to_frame(library)
        assert type(frame).__module__.startswith(library)
        assert_same(Measurements.of(frame, m.joint_names), m)
    first = Measurements.read(TABLE).to_frame(library)["x [mm]"]
    assert first[0] == -149.02


def test_a_pose_keeps_its_orientation_and_words(calibrations):
    m = calibrations.made("poses").fit.measurements
    for library in ("pandas", "polars"):
        assert_same(Measurements.of(m.to_frame(library), m.joint_names), m, rtol=1e-13, atol=1e-14)


def test_a_fault_is_named_by_row_and_column():
    with pytest.raises(
        MeasurementError, match=r"^dict, row 5, column 'y \[mm\]': the cell is empty"
    ):
        Measurements.of(COLUMNS | {"x [mm]": [1.0, 2.0, 3.0]})
    with pytest.raises(
        MeasurementError, match=r"^dict, column 'joint_1' .*no unit.*'joint_1 \[deg\]'"
    ):
        Measurements.of({"joint_1": [1.0], "x [mm]": [1]}, ["joint_1"])
    with pytest.raises(MeasurementError, match="'a' has 2 rows, 'b' has 1"):
        Measurements.of({"a": [1, 2], "b": [1]})
    with pytest.raises(MeasurementError, match="no columns"):
        Measurements.of(pd.DataFrame())
    twice = pd.concat([pd.DataFrame(COLUMNS)] * 2, axis=1)
    with pytest.raises(
        MeasurementError, match=r"two columns are called 'row': number 1 .* and number 9"
    ):
        Measurements.of(twice)
    for frame in (5, None, [COLUMNS], {"a": 5}, {"a": "12"}):
        with pytest.raises(ArgumentError):
            Measurements.of(frame)  # type: ignore[arg-type]


def test_texts_with_decimal_commas_are_numbers():
    frame = {"a [deg]": ["1,5"], "x [mm]": ["200"], "y [mm]": ["-3,25"], "z [mm]": ["1e2"]}
    m = Measurements.of(frame)
    np.testing.assert_allclose(m.points[0], [0.2, -0.00325, 0.1], rtol=1e-15)


def test_equal_frames_have_one_hash():
    hashes = {
        table_of_frame(f).sha256 for f in (COLUMNS, pd.DataFrame(COLUMNS), pl.DataFrame(COLUMNS))
    }
    assert len(hashes) == 1
    assert hashes != {table_of_frame(COLUMNS | {"row": [4, 5, 8]}).sha256}


def test_a_library_that_is_not_there_or_not_known(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(CalibError, match="choose one of 'pandas', 'polars'"):
        frame_of({}, "dask")  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "pandas", None)  # which Python takes as not installed
    measured = Measurements.of({"a [deg]": [1], "x [mm]": [100], "y [mm]": [1], "z [mm]": [1]})
    with pytest.raises(CalibError, match=r"pip install 'robot-calib\[pandas\]'"):
        measured.to_frame()


@pytest.mark.slow
def test_no_library_of_frames_is_imported_for_a_fit():
    code = (
        "import sys, calib, calib.example as e\n"
        "calib.calibrate(str(e.paper_urdf()), e.paper_measurements(), base='base', tip='tool0', model='zeros', "
        "validate=False)\n"
        "print([name for name in ('pandas', 'polars', 'pyarrow') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True
    )
    assert done.stdout == "[]\n"
    assert calib.Measurements is Measurements

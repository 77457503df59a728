"""Rows that are read many at once are those that are read one by one, to the last bit."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import MeasurementError
from calib.measure import table as table_module
from calib.measure.measurements import Measurements
from calib.measure.regular_rows import RegularRows

FIELDS = ("joints", "points", "rotations", "distances", "sigma", "sigma_angle", "torques")
WORDS = (
    "sets",
    "targets",
    "groups",
    "rows",
    "kinds",
    "pairs",
    "unmeasured",
    "joint_names",
    "sha256",
)

NUMBERS = st.one_of(
    st.floats(-90, 90).map(repr),
    st.sampled_from(
        [
            "1",
            " 2 ",
            "-0",
            "+3.5",
            "1e1",
            "1_0",
            "nan",
            "",
            "-",
            "1,5",
            "\u0663",
            "0x1",
            "1e400",
            '"4"',
            "12345678e-7",
        ]
    ),
)
WORD = st.sampled_from(
    ["estimate", "validate", " estimate", '"validate"', "", "#", "a/b", '"x\n y"']
)


def outcome(path, **arguments):
    """What is read, as plain values, or the text of the refusal."""
    try:
        m = Measurements.read(path, **arguments)
    except MeasurementError as error:
        return str(error)
    arrays = [None if getattr(m, n) is None else getattr(m, n).tobytes() for n in FIELDS]
    return [*arrays, *(getattr(m, name) for name in WORDS)]


def one_by_one(path, **arguments):
    """The same, with no block of rows taken as regular."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RegularRows, "read", lambda *_: None)
        return outcome(path, **arguments)


@settings(max_examples=150)
@given(
    header=st.sampled_from(
        [
            "row,set,a [deg],x [mm],y [mm],z [mm]",
            "group,set,a [deg],x [mm],y [mm],z [mm]",
            "target,set,a [deg],x [mm],y [mm],z [mm],",
        ]
    ),
    rows=st.lists(
        st.tuples(
            st.integers(0, 20).map(str) | WORD,
            WORD | st.just("estimate"),
            st.lists(NUMBERS | st.floats(-90, 90).map(repr), min_size=4, max_size=4),
            st.sampled_from(["", "", "", "\n", "\n# remark", "\n,,", ","]),
        ),
        min_size=1,
        max_size=6,
    ),
    sign=st.sampled_from([",", ";", "\t"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    piece=st.sampled_from([1, 30, 300_000]),
)
def test_many_at_once_and_one_by_one(tmp_path_factory, header, rows, sign, end, piece):
    lines = [header, *(",".join([first, word, *cells]) + tail for first, word, cells, tail in rows)]
    path = tmp_path_factory.mktemp("rows") / "data.csv"
    path.write_bytes("\n".join(lines).replace(",", sign).replace("\n", end).encode())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_module, "_PIECE", piece)
        assert outcome(path) == one_by_one(path)


def lines_of(count, sign=","):
    """A table of six joints and a point, with words."""
    rng = np.random.default_rng(3)
    yield sign.join(
        [
            "row",
            "set",
            *(f"j{i} [deg]" for i in range(6)),
            "x [mm]",
            "y [mm]",
            "z [mm]",
            "target",
            "p",
            "q",
        ]
    )
    for i, values in enumerate(rng.uniform(-170, 170, (count, 9)).tolist()):
        numbers = [f"{v:.4f}".replace(".", "," if sign == ";" else ".") for v in values]
        yield sign.join(
            [str(i + 1), ("estimate", "validate")[i % 2], *numbers, "ball", f"day {i % 3}", "am"]
        )


@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_a_large_table_is_the_same_and_its_words_are_shared(tmp_path, sign):
    path = tmp_path / "data.csv"
    path.write_text("\n".join(lines_of(9000, sign)) + "\n")
    groups = {"columns": {"p": "group", "q": "group"}}
    assert outcome(path, **groups) == one_by_one(path, **groups)
    m = Measurements.read(path, **groups)
    assert len(m) == 9000
    for words in (m.sets, m.targets, m.groups, m.kinds):
        assert len({id(word) for word in words}) < 30  # some for each piece of the text


def test_a_fault_far_down_is_named_by_line_and_column(tmp_path):
    lines = list(lines_of(9000))
    lines[8000] = lines[8000].replace("ball", "", 1)
    path = tmp_path / "data.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(
        MeasurementError, match=r"line 8001 \(row 8000\), column 'target': the cell is"
    ):
        Measurements.read(path)
    lines[7000] = "7,estimate" + lines[7000].removeprefix("7000,validate")
    path.write_text("\n".join(lines))
    with pytest.raises(
        MeasurementError, match="line 7001, column 'row': the row number 7 is also that of line 8"
    ):
        Measurements.read(path)
    lines[6000] = '6000,"estimate' + lines[6000].removeprefix("6000,estimate")
    path.write_text("\n".join(lines))
    with pytest.raises(
        MeasurementError,
        match=r"data.csv, line \d+: a cell is longer than .* quote \(\"\) there does not close",
    ):
        Measurements.read(path)


def test_a_sign_of_thousands_far_down_is_named_with_the_first_line_of_the_other(tmp_path):
    lines = list(lines_of(9000, ";"))
    lines[1] = lines[1].replace(",", ";").replace("1;estimate", "# 1;estimate")
    lines[8000] = lines[8000].replace(",", ".", 1)
    path = tmp_path / "data.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(
        MeasurementError, match="a decimal point in line 8001 and a decimal comma in line 3"
    ):
        Measurements.read(path)


def test_reading_takes_a_few_microseconds_a_row(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("\n".join(lines_of(20_000)))
    fastest = min(_seconds(path) for _ in range(3))
    assert fastest < 20_000 * 10e-6  # 3e-6 measured


def _seconds(path):
    """How long reading takes [s]."""
    start = time.process_time()
    Measurements.read(path)
    return time.process_time() - start

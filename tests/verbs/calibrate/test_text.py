from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.basics.channels import channels_of
from calib.data.cell import Cell
from calib.data.kinds import get
from calib.numerics.errors import Errors
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.show.errors import error_table, error_title
from calib.verbs.calibrate.text import EXPECTED, facts


@pytest.fixture(scope="module")
def text(default_result: Calibration) -> str:
    return default_result.summary()


def numbers_of(text: str, label: str) -> list[float]:
    """The numbers behind a label at the beginning of a line."""
    (line,) = [line for line in text.splitlines() if line.startswith(label + " ")]
    return [float(word) for word in re.findall(r"(?<!\S)[+-]?\d+\.?\d*(?!\S)", line[len(label) :])]


def test_the_sections_in_their_order(text: str):
    starts = [
        f"calib {calib.__version__}: robot 'ur3', base to tool0, 6 joints; 30 rows for estimation and 5 for validation",
        "\nVerdict: use\n",
        "\nPosition error [mm] ",
        "\nOutliers (no weight in the fit): row 11 (",
        "\nTarget: (",
        "\nNoise: ",
        "\nPrior standard deviations: ",
        "\nRank: 21 of 27 parameters, condition number ",
        "\nUnidentifiable combinations (resolved by the priors only):\n",
        "\nParameter ",
        "\n* known in combination with others only; see above\n",
        "\nSolver 'lm': converged after ",
    ]
    places = [text.index(start) for start in starts]
    assert places == sorted(places)


def test_the_text_is_plain(text: str):
    assert max(map(len, text.splitlines())) <= 100
    assert text.isprintable() or set(text) - set(filter(str.isprintable, text)) == {"\n"}
    assert all(line == line.rstrip() for line in text.splitlines())
    assert "nan" not in text
    assert "-0.000" not in text.replace("+-", "")


def test_the_errors_are_those_of_the_result(text: str, default_result: Calibration):
    for who, sets in default_result.errors.items():
        for name, errors in sets.items():
            shown = numbers_of(text, f"{name} rows, {who}")
            wanted = [errors["m"].max, errors["m"].mean, errors["m"].rms, *errors["m"].span_axis]
            assert shown[0] == errors["m"].n
            np.testing.assert_allclose(shown[1:], 1e3 * np.array(wanted), atol=5.001e-4)
    assert default_result.cross_validation is not None
    assert default_result.trust.nominal_cross_validation is not None
    for who, validated in (
        ("nominal", default_result.trust.nominal_cross_validation),
        ("calibrated", default_result.cross_validation),
    ):
        shown = numbers_of(text, f"held-out rows*, {who}")
        assert shown[3] == pytest.approx(1e3 * validated.errors["m"].rms, abs=5e-4)
    kept = 30 - len(default_result.rows.outliers)
    assert len(re.findall(rf"^  the same without outliers +{kept} ", text, flags=re.MULTILINE)) == 2
    assert "\n* leave-one-out: each row predicted from the others alone\n" in text


def test_the_parameters_are_those_of_the_result(text: str, default_result: Calibration):
    for p in default_result.parameters:
        scale, unit = (1e3, "mm") if p.unit == "m" else (np.degrees(1.0), "deg")
        (line,) = [line for line in text.splitlines() if line.startswith(p.name + " ")]
        assert (" *" in line) == (not p.identifiable)
        assert f" {unit}" in line
        shown = numbers_of(text, p.name)
        assert p.nominal is not None
        half = 0.5 * (p.high - p.low)
        wanted = scale * np.array([p.nominal, p.value, p.delta, half])
        np.testing.assert_allclose(shown, wanted, atol=5.001e-4)


@pytest.mark.parametrize(
    ("kinds", "title"),
    [
        (["point", "fixed"], "Position error"),
        (["distance", "plane"], "Length error"),
        (["pose", "pair"], "Position or length error"),
        ([], "Position error"),
    ],
)
def test_an_error_of_a_length_is_none_of_a_position(kinds: list[str], title: str):
    units = [get(kind).units for kind in kinds]
    vector_units = [get(kind).vector_units for kind in kinds]
    channels = channels_of(units, vector_units, np.arange(len(kinds)))
    assert error_title("m", channels) == title
    assert error_title("rad", channels) == "Orientation error"


def test_what_too_few_rows_do_not_tell_is_not_expected(ur3, table):
    """Rows of one pose: the sizes of the errors are found from nothing."""
    one = calibrate(ur3, table.select(np.arange(35) < 1), model="zeros", validate=False)
    assert facts(one)[EXPECTED].startswith("not known")
    # Nor by a fit whose joint values mean something else.
    q = table.joints + np.radians(90.0) * (np.arange(6) == 2)
    turned = calibrate(ur3, replace(table, joints=q), cell=Cell())
    assert turned.verdict.reasons[0].code == "joint_zero"
    assert facts(turned)[EXPECTED].startswith("not known")
    some = calibrate(ur3, table.select(np.arange(35) < 20), model="zeros", validate=False)
    assert " mm over the joint limits" in facts(some)[EXPECTED]


def test_errors_have_a_span_where_positions_were_measured():
    rng = np.random.default_rng(1)
    positions, lengths = (Errors.of(1e-3 * rng.normal(size=(5, n))) for n in (3, 1))
    for errors, columns in ((positions, 7), (lengths, 4)):
        head, row = error_table("Error", "m", [("rows", errors)])
        assert ("span" in head) is (columns == 7)
        assert len(row.split()) == 1 + columns
    both = error_table("Error", "m", [("a", lengths), "text", ("b", positions)])
    assert "span" in both[0]
    assert both[1].split()[-3:] == ["-"] * 3

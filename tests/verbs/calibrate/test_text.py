"""The summary of a calibration has its sections in order, with the result's numbers; noise and outliers in words."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.data.cell import Cell
from calib.fit.registration.rows import USUAL_POSE_NOISE
from calib.fit.selection.row_weights import Robustness
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.errors import Errors
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.parts import Outlier
from calib.verbs.calibrate.text import (
    EXPECTED,
    POSE_NOISE,
    facts,
    noise_text,
    outliers_text,
    pose_noise_text,
    robustness_text,
)
from tests.parts import with_part
from tests.two_handed import fitted


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


def test_the_noise_has_its_degrees_of_freedom_where_they_are_enough(default_result):
    told = noise_text(default_result)
    assert f"{default_result.noise.freedom:.0f} d.o.f." in told
    few = noise_text(with_part(default_result, "noise", freedom=5.9))
    assert "d.o.f." not in few


def test_the_noise_of_poses_is_told_in_common_units(default_result):
    noise = PoseNoise(
        scale=0.37, position=1.25e-4, orientation=np.deg2rad(0.02), joint=np.deg2rad(0.013)
    )
    numbers = [float(word) for word in re.findall(r"\d+\.\d+", pose_noise_text(noise))]
    assert numbers == pytest.approx([0.37, 0.013, 0.125, 0.02])
    assert "at each joint" not in pose_noise_text(replace(noise, joint=0.0))
    assert "assumed" in pose_noise_text(USUAL_POSE_NOISE)
    assert "assumed" not in pose_noise_text(noise)
    assert POSE_NOISE not in facts(default_result)
    assert facts(with_part(default_result, "noise", pose_noise=noise))[
        POSE_NOISE
    ] == pose_noise_text(noise)


def test_outliers_are_listed_by_row(default_result):
    far = [Outlier(k, {"m": 1e-3 * k}, 4.0 + k) for k in range(1, 15)]
    told = outliers_text(default_result, far).split("; ")
    assert told[1] == "row 2 (2.00 mm, 6.0 sigma)"
    assert told[12] == "and 2 more"


def test_outliers_of_images_are_listed_by_image(default_result):
    count = len(default_result.rows)
    images = tuple(f"{k // 3}.png" for k in range(count))
    named = replace(default_result, rows=replace(default_result.rows, images=images))
    numbers = default_result.rows.numbers
    far = [Outlier(numbers[k], {"px": 0.1 * k}, 4.0 + k) for k in (3, 5, 7)]
    told = outliers_text(named, far).split("; ")
    assert told == [
        "1.png, 2 corners (up to 0.50 px, 9.0 sigma)",
        "2.png, 1 corner (up to 0.70 px, 11.0 sigma)",
    ]


def test_full_weights_beside_lowered_ones():
    lowered, full = (Errors.of(np.full((4, 1), error)) for error in (1e-4, 3e-4))
    robustness = Robustness(True, 2e-4, 5e-4, lowered, full)
    text = robustness_text(robustness)
    assert text.startswith("With full weight these rows would change the prediction by 0.200 mm")
    assert "0.500 mm at most" in text
    assert "from about 0.100 to 0.300 mm rms" in text
    other = robustness_text(replace(robustness, lowered=False))
    assert other.startswith("With lowered weight")
    assert "from about 0.300 to 0.100 mm rms" in other


def test_without_held_out_rows_no_error_is_said():
    nothing = Errors.of(np.zeros((0, 3)))
    assert robustness_text(Robustness(True, 2e-4, 5e-4, nothing, nothing)).endswith("at most.")


def test_outliers_of_several_hands_name_the_hand():
    c = fitted()
    number, target = c.rows.numbers[1], c.rows.targets[1]
    assert target == "b"
    assert (
        outliers_text(c, [Outlier(number, {"m": 1e-3}, 5.0)])
        == f"row {number} ('b', 1.00 mm, 5.0 sigma)"
    )

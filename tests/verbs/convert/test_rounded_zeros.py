"""Rounded zeros: at most half a step away, of the right sign, in the joint's unit; and the errors with them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.errors import CalibError, ModelError, VerdictError
from calib.result.calibration import Calibration
from calib.result.joint_zeros import ESTIMATION, VALIDATION
from calib.robot.robot import Robot
from calib.verbs.convert.convert import FORMATS, convert
from calib.verbs.convert.format import Source
from calib.verbs.convert.rounded_zeros import (
    RmsErrors,
    RoundedZeros,
    check_improvement,
)
from calib.verbs.convert.text import text
from tests.places import ROOT
from tests.verbs.convert.zero_arms import STORED, servo_arm, servo_result, ur3_result, written

#: (type, xyz, rpy, axis)
SLIDING = [
    ("prismatic", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0, 0, 1)),
    ("revolute", (0.2, 0.0, 0.0), (0.0, 0.0, 0.0), (0, 1, 0)),
]


def source(robot: Robot, delta: list[float]) -> Source:
    """A result whose zeros are these."""
    m = len(delta)
    zeros = replace(
        servo_result().zeros,
        joints=robot.joint_names,
        delta=np.array(delta),
        std=np.full(m, 1e-4),
        determined=np.array([True] * (m - 1) + [False]),
    )
    return Source("result", robot, robot, calibration=replace(servo_result(), zeros=zeros))


@pytest.mark.parametrize(
    ("name", "ticks", "step"),
    [
        ("zeros", 4096, np.radians(1e-4)),
        ("dynamixel-hardware", 4096, 1e-6),
        ("ros2-transmission", 4096, 1e-6),
        ("lerobot", 4096, 2 * np.pi / 4096),
        ("lerobot-dynamixel", 1000, 2 * np.pi / 1000),
    ],
)
def test_rounding_moves_a_zero_by_half_a_step_at_most(name: str, ticks: int, step: float):
    delta = np.random.default_rng(2).uniform(-0.1, 0.1, 5).tolist()
    rounded = RoundedZeros.of(source(servo_arm(), delta), STORED[name].with_ticks(ticks))
    assert np.abs(rounded.rounding).max() <= step / 2 * (1 + 1e-9)
    assert rounded.change == pytest.approx(np.array(delta) + rounded.rounding, abs=1e-15)
    steps = rounded.change / step
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.array_equal(np.sign(rounded.numbers), STORED[name].sign * np.sign(delta))


def test_a_sliding_joint_is_in_mm(serial_urdf):
    robot = Robot.from_urdf(serial_urdf(SLIDING), "l0", "tip")
    rounded = RoundedZeros.of(source(robot, [0.0123456, 0.02]), STORED["zeros"].with_ticks(4096))
    assert rounded.by_joint() == {"j1": 12.346}  # the second is not determined
    assert [unit.name for unit in rounded.units] == ["mm", "deg"]
    assert rounded.undetermined == ("j2",)
    assert rounded.change[0] == pytest.approx(0.012346)
    in_metres = RoundedZeros.of(
        source(robot, [0.0123456, 0.02]), STORED["dynamixel-hardware"].with_ticks(1)
    )
    assert in_metres.by_joint() == {"j1": -0.012346}
    with pytest.raises(ModelError, match="'j1' slides"):
        RoundedZeros.of(source(robot, [0.0, 0.0]), STORED["lerobot"].with_ticks(4096))


def test_what_has_no_zeros():
    with pytest.raises(CalibError, match="result"):
        RoundedZeros.of(Source("robot", servo_arm(), None), STORED["zeros"].with_ticks(4096))
    with pytest.raises(CalibError, match="--ticks -1"):
        STORED["lerobot"].with_ticks(-1)


# Errors


def rms_errors_of(result, name: str = "zeros", ticks: int = 4096) -> RmsErrors:
    source = Source("result", result.robot, result.nominal, calibration=result)
    return RmsErrors.of(result, RoundedZeros.of(source, STORED[name].with_ticks(ticks)))


def test_the_errors_are_those_of_the_result():
    result = ur3_result()
    rms_errors = rms_errors_of(result)
    held_out = result.cross_validation.errors_without_outliers["m"].rms
    nominal = result.trust.nominal_cross_validation.errors_without_outliers["m"].rms
    assert (rms_errors.calibrated["m"], rms_errors.nominal["m"]) == (held_out, nominal)
    assert rms_errors.zeros["m"] == result.zeros.errors["m"].rms()
    assert rms_errors.non_geometric is None
    assert not rms_errors.is_no_better
    for rows, name in ((VALIDATION, "validation"), (ESTIMATION, "estimation")):
        other = rms_errors_of(replace(result, zeros=replace(result.zeros, rows=rows)))
        assert other.nominal["m"] == result.errors["nominal"][name]["m"].rms
        assert other.calibrated["m"] == result.errors["calibrated"][name]["m"].rms


def test_coarser_steps_cost_more():
    fine, ticks, coarse = (
        rms_errors_of(ur3_result(), name, n).rounded["m"]
        for name, n in (("zeros", 4096), ("lerobot", 4096), ("lerobot", 64))
    )
    assert fine == pytest.approx(rms_errors_of(ur3_result()).zeros["m"], rel=1e-4)
    assert 1.0 < ticks / fine < 1.1 < coarse / fine  # steps of 5.6 deg leave the zeros as they are


def test_what_is_no_better_is_refused():
    path = Path("z.csv")
    rms_errors = rms_errors_of(ur3_result())
    worse = replace(rms_errors, rounded={"m": rms_errors.nominal["m"]})
    check_improvement(rms_errors, path, accept=False)
    check_improvement(worse, path, accept=True)
    with pytest.raises(VerdictError, match=r"z\.csv.*held-out.*2\.350 mm"):
        check_improvement(worse, path, accept=False)
    not_judged = replace(worse, nominal={"m": np.nan})  # the verdict speaks of that
    check_improvement(not_judged, path, accept=False)
    nothing = replace(worse, nominal={}, zeros={}, rounded={}, calibrated={})
    assert not nothing.is_no_better


DOCS = ROOT / "docs"


def test_the_page_shows_what_is_printed_of_the_demo(default_result: Calibration, tmp_path: Path):
    done = convert(default_result, tmp_path / "zeros.csv", to="zeros")
    printed = text(done, "demo/calibration.json")
    page = (DOCS / "zeros.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    assert shown.strip() in printed
    assert "must go up by its zero" in " ".join(printed.split())
    assert "Over the joint limits" not in printed  # that is the whole calibration


@pytest.mark.parametrize(
    ("to", "cell"),
    [
        ("zeros", "1.692"),
        ("dynamixel-hardware", "1.692"),
        ("ros2-transmission", "1.692"),
        ("lerobot", "1.696"),
        ("lerobot-dynamixel", "1.696"),
    ],
)
def test_the_page_has_the_error_of_each_format(default_result, tmp_path: Path, to: str, cell: str):
    ending = {"zeros": ".csv", "lerobot": ".json", "lerobot-dynamixel": ".json"}.get(to, ".yaml")
    printed = text(convert(default_result, tmp_path / f"z{ending}", to=to), "demo.json")
    assert re.search(rf"rounded as written +{cell}$", printed, re.MULTILINE)
    page = (DOCS / "zeros.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\|.*\| `{to}` \(.*$", page, re.MULTILINE)
    assert row.endswith(f"| {cell} |")


def test_the_table_has_the_numbers_that_are_stored(tmp_path: Path):
    done = convert(servo_result(), tmp_path / "z.json", to="lerobot")
    describe = FORMATS["lerobot"].describe
    assert describe is not None
    _, table, errors = describe(done)
    assert re.findall(r"^elbow_flex +-1\.\d{4} +0\.\d{4} deg +\+18 ticks$", table, re.MULTILINE)
    assert "change of homing_offset" in table
    assert "whole calibration" in errors
    assert max(map(len, [*table.splitlines(), *errors.splitlines()])) <= 100
    assert FORMATS["dh"].describe is None
    assert written(tmp_path / "zeros.csv", "zeros").exists()

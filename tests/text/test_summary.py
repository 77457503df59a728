from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.calibration import Calibration, calibrate
from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.estimate.statistics import Errors
from calib.example import PAPER_TARGET_AS_PRINTED, paper_urdf
from calib.result.prediction import Outlier
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import Urdf
from calib.text.lines import three, wrap
from calib.text.summary import (
    error_head,
    error_row,
    error_rows,
    error_title,
    frame_sentences,
    left_out_text,
    measured_lengths,
    shown_parameters,
    solver_text,
    target_sentences,
    weights_text,
)


@pytest.fixture(scope="module")
def text(default_result: Calibration) -> str:
    return default_result.summary()


def numbers_of(text: str, label: str) -> list[float]:
    """The numbers behind a label at the beginning of a line."""
    (line,) = [line for line in text.splitlines() if line.startswith(label + " ")]
    return [float(word) for word in re.findall(r"(?<!\S)[+-]?\d+\.?\d*(?!\S)", line[len(label) :])]


def test_the_sections_in_their_order(text: str):
    starts = [
        f"calib {calib.__version__}: robot 'ur3', base to tool0, 6 joints; 30 rows to estimate and 5 to validate",
        "\nVerdict: use\n",
        "\nPosition error [mm] ",
        "\nValidation rows ",
        "\nOutliers (they have no weight in the fit): row 11 (",
        "\nTarget: (",
        "\nNoise: ",
        "\nSize of the robot's errors: ",
        "\nRank: 21 of 27 parameters, condition number ",
        "\nThese changes move nothing that was measured, so the priors share them out:\n",
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
            wanted = [errors.max, errors.mean, errors.rms, *errors.span_axis]
            assert shown[0] == errors.n
            np.testing.assert_allclose(shown[1:], 1e3 * np.array(wanted), atol=5.001e-4)
    assert default_result.cross_validation is not None
    assert default_result.nominal_cross_validation is not None
    for who, validated in (
        ("nominal", default_result.nominal_cross_validation),
        ("calibrated", default_result.cross_validation),
    ):
        shown = numbers_of(text, f"left-out rows*, {who}")
        assert shown[3] == pytest.approx(1e3 * validated.errors.rms, abs=5e-4)
    kept = 30 - len(default_result.outliers)
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


def test_validation_rows_by_axis(text: str, default_result: Calibration):
    shown = [numbers_of(text, f"  row {row} [mm]") for row in range(31, 36)]
    before, after = default_result.residual_nominal[30:], default_result.residual_calibrated[30:]
    wanted = [
        [*b, np.linalg.norm(b), *a, np.linalg.norm(a)] for b, a in zip(before, after, strict=True)
    ]
    np.testing.assert_allclose(shown, 1e3 * np.array(wanted), atol=5.001e-4)
    many = replace(default_result.rows, sets=("estimate",) * 20 + ("validate",) * 15)
    assert "  row 31 [mm]" not in replace(default_result, rows=many).summary()


def test_target_found_given_moved_and_kept(ur3: Robot, table: Measurements):
    def said(cell: Cell) -> str:
        whole = " ".join(calibrate(ur3, table, cell=cell, validate=False).summary().split())
        end = re.search(r"Measurement frame: |Models tried |Noise: ", whole)
        assert end is not None
        return whole[whole.index("Target: ") : end.start()].strip()

    assert said(Cell(model="dh")).startswith("Target: found at (-70.")
    printed = read_only(PAPER_TARGET_AS_PRINTED)
    moved = said(Cell(target=printed, model="dh"))
    assert " mm from the position given. That is further than mounting" in moved
    assert moved.endswith("check the sign and the order of the numbers given.")
    kept = said(Cell(target=printed, estimate_target=False, model="frames", estimate_frame=True))
    assert kept == "Target: (69.970, -70.200, 22.520) mm in tool0, as given."


def test_a_result_without_validation_and_priors(ur3: Robot, table: Measurements):
    bare = calibrate(
        ur3,
        table.select(table.estimation),
        cell=Cell(priors=Priors("off"), model="zeros"),
        validate=False,
    )
    text = bare.summary()
    assert "\nVerdict: none, because nothing was cross-validated.\n" in text
    assert "validation rows" not in text
    assert "left-out" not in text
    assert "Size of the robot's errors" not in text
    assert re.search(r"\ntarget_x +- +-?\d", text)


def test_priors_as_given(ur3: Robot, table: Measurements):
    text = calibrate(ur3, table, cell=Cell(priors=Priors("given")), validate=False).summary()
    said = "Size of the robot's errors: length 3 mm, angle 15 mrad, zero 15 mrad (as given)."
    assert said in text


def test_outliers_are_listed_up_to_a_dozen(default_result: Calibration):
    one = default_result.outliers[0]
    many = tuple(replace(one, row=row) for row in range(11, 26))
    text = replace(default_result, outliers=many, suspects=(one,)).summary()
    assert "row 22 (" in text
    assert "row 23 (" not in text
    assert "and 3 more" in text
    assert "Outliers (they keep their weight in this fit): row 11 (" in text
    assert f"Validation rows that the calibrated robot does not explain: row {one.row} (" in text
    assert max(map(len, text.splitlines())) <= 100
    assert "\nOutliers: none.\n" in replace(default_result, outliers=()).summary()


@pytest.mark.parametrize("model", ["dh", "placement"])
def test_long_names_stay_within_100_columns(table: Measurements, model: str):
    long = "the_joint_of_the_left_arm_of_the_second_robot_of_the_cell_number_"
    data = paper_urdf().read_bytes()
    for i, name in enumerate(table.joint_names):
        data = data.replace(f'"{name}"'.encode(), f'"{long}{i}"'.encode())
    data = data.replace(b'"tool0"', f'"{"flange-" * 20}"'.encode())
    data = data.replace(b'"base"', f'"{"foot-" * 20}"'.encode())
    robot = Robot.from_urdf(Urdf.from_bytes(data, "r.urdf"), "foot-" * 20, "flange-" * 20)
    named = replace(table, joint_names=robot.joint_names, source="table-of-" * 15 + ".csv")
    result = calibrate(robot, named, cell=Cell(model=model, estimate_frame=True), validate=False)
    text = result.summary()
    assert max(map(len, text.splitlines())) <= 100
    if model == "placement":
        at = text.splitlines().index(f"{long}2.rx")
        assert len(numbers_of("x" + text.splitlines()[at + 1], "x")) == 4


def test_a_table_in_memory_has_no_name(ur3: Robot, table: Measurements):
    text = calibrate(ur3, replace(table, source=""), validate=False, model="zeros").summary()
    assert "to validate from memory" in " ".join(text.split())


def test_the_error_table_keeps_its_columns_for_large_errors():
    large = Errors.of(np.array([[12.0, -34.0, 56.0], [-69.0, 40.0, 1.0]]))
    row = error_row("estimation rows, calibrated", large)
    assert len(row) == len(error_head()) <= 100
    larger = error_row("estimation rows, calibrated", Errors.of(100.0 * np.eye(3)))
    for line in (row, larger):
        assert len(line.split()) == 10
    assert float(row.split()[-1]) == 55000.0
    assert float(larger.split()[-1]) == 100000.0


def test_without_cross_validation_nothing_is_said_of_left_out_rows(calibrated):
    _, c = calibrated("points")
    bare = replace(c, cross_validation=None, nominal_cross_validation=None, larger=None)
    assert left_out_text(bare) == ""
    assert not [label for label, _ in error_rows(bare) if "left-out" in label]


def test_whether_outliers_have_a_weight(calibrated):
    _, c = calibrated("points")
    row = c.measurements.rows[0]
    flagged = replace(c, outliers=(Outlier(row, 1e-3, 9.0),))
    weights = c.weights.copy()
    for weight, said in (
        (0.0, "they have no weight in the fit"),
        (1.0, "they keep their weight in this fit"),
    ):
        weights[0] = weight
        assert weights_text(replace(flagged, weights=weights)) == said


def test_frames_and_orientations_of_targets_are_no_listed_parameters(calibrated):
    _, c = calibrated("poses")
    names = [p.name for p in shown_parameters(c)]
    assert "target_x" in names
    assert not [name for name in names if name.startswith(("frame_", "target_r"))]


def test_the_solver_without_its_time(calibrated):
    _, c = calibrated("points")
    assert solver_text(c) == (
        f"Solver 'lm': converged after {c.solution.iterations} iterations, {c.solution.evaluations} evaluations"
    )
    assert solver_text(replace(c, seconds=np.nan)) == solver_text(c)


@pytest.mark.parametrize(
    ("numbers", "of", "title"),
    [
        ([3, 3], "coordinate", "Position error"),
        ([1, 0], "length", "Length error"),
        ([3, 1], "coordinate or length", "Position or length error"),
        ([0], "coordinate", "Position error"),
    ],
)
def test_an_error_of_a_length_is_none_of_a_position(numbers: list[int], of: str, title: str):
    used = np.arange(3) < np.array(numbers)[:, None]
    assert measured_lengths(used) == of
    assert error_title(used) == title


def one_line(text: str) -> str:
    return " ".join(text.split())


def targets(c: Calibration) -> str:
    return "\n".join(target_sentences(c))


def frames(c: Calibration) -> str:
    return "\n".join(frame_sentences(c))


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]


def test_targets_by_name_where_there_are_several(calibrated):
    _, c = calibrated("targets")
    lines = targets(c).splitlines()
    assert lines[0].startswith("Target 't0': found at (")
    for name, T in zip(c.setup.targets, c.setup.T_tip_target, strict=True):
        (line,) = [line for line in lines if f"'{name}'" in line]
        np.testing.assert_allclose(numbers(line)[:3], 1e3 * T[:3, 3], atol=5.1e-4)
    assert targets(calibrated("points")[1]).startswith("Target: found at (")


def test_orientations_and_how_sure_they_are(calibrated):
    _, c = calibrated("poses")
    said = one_line(targets(c))
    assert re.search(
        r"mm, rpy \(.*\) deg in tool0, 95 % ± \(.*\) mm and \(.*\) deg about its axes", said
    )
    sure = numbers(said.split("mm and (")[1])
    wanted = [c.parameter(f"target_r{a}") for a in "xyz"]
    np.testing.assert_allclose(sure, [np.degrees(p.high - p.low) / 2 for p in wanted], rtol=6e-3)
    assert "target_rx" not in c.summary().split("Parameter ")[1]


def test_every_set_up_by_name(calibrated):
    _, c = calibrated("set-ups")
    said = one_line(frames(c))
    for group, T in zip(c.setup.groups, c.setup.T_frame_base, strict=True):
        x, y, z = (three(1e3 * v) for v in T[:3, 3])
        assert f"Measurement frame '{group}': base found at ({x}, {y}, {z}) mm, rpy (" in said
    assert frames(calibrated("known set-ups")[1]) == ""
    assert frames(calibrated("pairs")[1]) == ""


@pytest.mark.parametrize(("name", "word"), [("sockets", "Socket"), ("distances", "Anchor")])
def test_sockets_and_anchors_are_points_of_the_base(calibrated, name, word):
    _, c = calibrated(name)
    for line, group, T in zip(
        frames(c).splitlines(), c.setup.groups, c.setup.T_frame_base, strict=True
    ):
        assert line.startswith(f"{word} '{group}': found at (")
        np.testing.assert_allclose(numbers(line), -1e3 * T[:3, :3].T @ T[:3, 3], atol=5.1e-4)


def test_planes_by_normal_and_distance(calibrated):
    scene, c = calibrated("planes")
    for line, T in zip(frames(c).splitlines(), scene.kinematics.T_frame_base, strict=True):
        normal, along = np.array(numbers(line)[:3]), numbers(line)[3]
        side = np.sign(normal @ T[2, :3])  # a plane has two
        np.testing.assert_allclose(side * normal, T[2, :3], atol=5e-3)
        assert side * along == pytest.approx(-1e3 * T[2, 3], abs=3.0)


def test_each_kind_has_its_own_words_in_a_table_of_all(calibrated):
    _, c = calibrated("mixed")
    starts = [line.split(":")[0] for line in frames(c).splitlines() if line[0] != " "]
    assert starts == ["Measurement frame '0'", "Socket '1'", "Plane '2'", "Anchor '3'"]


def test_a_partly_known_frame_says_which_directions(calibrated):
    _, c = calibrated("gain")
    cell = replace(
        c.cell, T_frame_base=c.T_frame_base, frame_directions=("x", "rz"), model="frames"
    )
    found = calibrate(c.nominal, c.measurements, cell=cell, validate=False)
    said = one_line(frames(found))
    assert said.endswith("for x, rz along and about the axes of base.")
    assert len(numbers(said.split("95 % ± ")[1])) == 2


def test_many_are_counted_not_listed(calibrated):
    scene, c = calibrated("sockets")
    m = c.measurements
    groups = tuple(f"{g}{k % 4}" for k, g in enumerate(m.groups))
    many = calibrate(
        scene.robot, replace(m, groups=groups), cell=replace(c.cell, distances=()), validate=False
    )
    assert frames(many).count("Socket") == 6
    assert frames(many).endswith("... and 6 more set-ups")
    table = calibrated("points")[1].measurements
    names = tuple(f"ball{k % 8}" for k in range(len(table)))
    several = calibrate(scene.robot, replace(table, targets=names), model="frames", validate=False)
    assert targets(several).endswith("... and 2 more targets")


def test_numbers_and_lines():
    assert (three(-0.0001), three(0.00049, "+"), three(-1.2345)) == ("0.000", "+0.000", "-1.234")
    text = wrap("word-with-hyphens " * 20, "  ")
    assert max(map(len, text.splitlines())) <= 100
    assert all(line.startswith("  ") for line in text.splitlines())
    assert "hyphens" in text.splitlines()[0].split()[-1]

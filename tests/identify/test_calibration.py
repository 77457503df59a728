"""The whole calibration on the paper's data: the figures that README and docs state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data import PAPER_TARGET_AS_PRINTED
from calib.errors import MeasurementError, ModelError, UrdfError
from calib.identify.calibration import calibrate
from calib.identify.evaluation import evaluate
from calib.identify.statistics import Errors
from calib.measure.cell import Cell, Priors
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

# The paper's Table 3: nominal positions of rows 31 to 35 before calibration [mm].
TABLE_3 = np.array(
    [
        [-245.58, -168.74, 620.94],
        [-279.00, 80.04, 625.37],
        [-201.52, -70.26, 485.03],
        [386.55, -43.26, 441.54],
        [155.60, 203.71, 563.50],
    ]
)
# Its Table 4: errors of these rows before calibration, measured minus nominal [mm].
TABLE_4 = np.array([2.9677, 1.2754, 1.5221, 3.5091, 3.5645])


@pytest.fixture(scope="module")
def by_the_paper(ur3, table, paper_cell):
    return calibrate(ur3, table, cell=paper_cell, solver="paper", validate=False)


def millimetres(errors: Errors) -> tuple[float, float, float]:
    return 1e3 * errors.max, 1e3 * errors.mean, 1e3 * errors.rms


def test_nominal_positions_agree_with_the_papers_table_3(default_result, table):
    nominal = 1e3 * (table.points - default_result.residual_nominal)[table.validation]
    assert np.abs(nominal - TABLE_3).max() < 0.19


def test_nominal_errors_agree_with_table_4_and_are_known_to_the_micrometre(default_result, table):
    norms = 1e3 * np.linalg.norm(default_result.residual_nominal[table.validation], axis=1)
    assert np.abs(norms - TABLE_4).max() < 0.19
    found = millimetres(default_result.errors["nominal"]["validation"])
    assert found == pytest.approx((3.606, 2.543, 2.733), abs=1e-3)


def test_the_papers_algorithm_does_better_than_the_paper_says(by_the_paper):
    largest, _, rms = millimetres(by_the_paper.errors["calibrated"]["validation"])
    assert rms <= 0.75
    assert rms == pytest.approx(0.700, abs=2e-3)
    assert largest == pytest.approx(1.034, abs=5e-3)
    assert by_the_paper.solution.status == "converged"
    assert len(by_the_paper.solution.history) >= 50
    assert by_the_paper.solution.history[0].mu == 0.01


def test_default_on_validation_rows(default_result):
    _, mean, rms = millimetres(default_result.errors["calibrated"]["validation"])
    assert rms <= 0.25
    assert rms == pytest.approx(0.248, abs=1e-3)
    assert mean == pytest.approx(0.233, abs=1e-3)


def test_default_leave_one_out_without_row_11(default_result, table):
    residual = default_result.cross_validation.residual
    numbers = np.array(table.rows)[table.estimation]
    errors = Errors.of(residual[numbers != 11])
    assert default_result.cross_validation.method == "leave-one-out"
    assert 1e3 * errors.rms <= 0.27
    assert 1e3 * errors.rms == pytest.approx(0.2375, abs=2e-3)


def test_row_11_is_an_outlier_and_no_validation_row_is(default_result):
    rows = {o.row: o for o in default_result.outliers}
    assert 11 in rows
    assert set(rows) <= {11, 14}
    assert rows[11].residual == pytest.approx(1.98e-3, abs=0.02e-3)
    assert rows[11].score > 10
    assert default_result.suspects == ()


def test_rank_and_the_named_combinations(default_result):
    o = default_result.observability
    assert (o.rank, o.columns) == (21, 27)
    together = [set(u.names) for u in o.unidentifiable]
    for expected in ({"d2", "d4"}, {"d3", "d4"}, {"a6", "target_x"}, {"d6", "target_z"}):
        assert expected in together
    assert len(together) == 6
    marked = {p.name for p in default_result.parameters if not p.identifiable}
    assert {"d2", "d3", "d4", "a6", "alpha6", "d6", "theta6"} <= marked
    assert "a2" not in marked


@pytest.mark.parametrize("target", [PAPER_TARGET_AS_PRINTED, None])
def test_a_wrong_or_missing_target_converges_to_the_same_result(ur3, table, default_result, target):
    cell = Cell(target=None if target is None else np.array(target), model="paper")
    result = calibrate(ur3, table, cell=cell, validate=False)
    np.testing.assert_allclose(result.target, default_result.target, atol=1e-8)
    np.testing.assert_allclose(result.robot.placements, default_result.robot.placements, atol=1e-8)
    if target is not None:
        assert "it moved 198.3 mm from the position given" in result.summary()


def test_scipy_solves_the_same_problem(ur3, table, paper_cell, default_result):
    result = calibrate(ur3, table, cell=paper_cell, solver="scipy", validate=False)
    np.testing.assert_allclose(result.x, default_result.x, atol=1e-7)
    np.testing.assert_allclose(result.covariance, default_result.covariance, atol=1e-10)


def test_the_verdict_is_to_use_it(default_result):
    assert default_result.verdict.use == "use"


def test_with_an_unknown_frame_the_validation_rows_are_still_met(ur3, table):
    result = calibrate(ur3, table, cell=Cell(estimate_frame=True), validate=False)
    assert 1e3 * result.errors["calibrated"]["validation"].rms < 0.29


def test_predict_is_what_the_residuals_are_made_of(default_result, table):
    predicted = default_result.predict(table.joints_for(default_result.robot.joint_names))
    np.testing.assert_allclose(
        table.points - predicted, default_result.residual_calibrated, atol=1e-12
    )


def test_evaluate_on_the_written_urdf_agrees_with_fit(default_result, table, tmp_path):
    path = default_result.write_urdf(tmp_path / "corrected.urdf")
    robot = Robot.load(path, base="base", tip="tool0")
    result = evaluate(robot, table, Cell(target=default_result.target, estimate_target=False))
    np.testing.assert_allclose(result.residual, default_result.residual_calibrated, atol=1e-9)
    assert result.registered == ()


def test_evaluate_registers_what_is_not_given(ur3, table, default_result):
    result = evaluate(ur3, table)
    assert result.registered == ("target",)
    assert np.linalg.norm(result.target - default_result.target) < 5e-3
    framed = evaluate(ur3, table, Cell(estimate_frame=True))
    assert framed.registered == ("target", "frame")
    assert framed.errors["estimation"].rms < result.errors["estimation"].rms


def test_the_urdf_changes_in_origins_of_the_chain_only(default_result, ur3, tmp_path):
    path = default_result.write_urdf(tmp_path / "corrected.urdf")
    before, after = ur3.urdf.data.decode().splitlines(), path.read_text().splitlines()
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert (
        len(changed) == 6
    )  # nothing is left for the tip: a6 and alpha6 cannot be told from the target
    assert all("<origin" in a and "<origin" in b for a, b in changed)


def test_a_target_link_stands_where_the_target_is(default_result, tmp_path):
    path = default_result.write_urdf(tmp_path / "corrected.urdf", target_link=True)
    with_link = Robot.load(path, base="base", tip="calib_target")
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    np.testing.assert_allclose(with_link.poses(q)[:, :3, 3], default_result.predict(q), atol=1e-9)


def test_a_urdf_that_disagrees_with_memory_is_not_written(default_result, tmp_path):
    x = default_result.x.copy()
    x[0] += 1e-8
    tampered = replace(default_result, x=x)
    with pytest.raises(UrdfError, match=r"read back by Pinocchio.*not written"):
        tampered.write_urdf(tmp_path / "corrected.urdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("model", ["dh", "hayati", "placement", "zeros"])
def test_every_set_writes_a_urdf_that_reads_back(ur3, table, model, tmp_path):
    result = calibrate(ur3, table, cell=Cell(model=model), validate=False)
    assert result.write_urdf(tmp_path / "corrected.urdf").is_file()
    assert (
        result.errors["calibrated"]["estimation"].rms < result.errors["nominal"]["estimation"].rms
    )


def test_frames_alone_leave_the_robot_as_it_is(ur3, table, tmp_path):
    result = calibrate(ur3, table, model="frames", validate=False)
    assert result.robot.urdf.data == ur3.urdf.data
    assert result.write_urdf(tmp_path / "same.urdf").read_bytes() == ur3.urdf.data


def test_frozen_parameters_stay(ur3, table, paper_cell):
    result = calibrate(ur3, table, cell=replace(paper_cell, frozen=("d2", "a6")), validate=False)
    assert len(result.parameters) == 25
    with pytest.raises(ModelError, match="no parameter 'd2'"):
        result.parameter("d2")


def test_a_known_target_stays(ur3, table):
    given = np.array([-0.07, 0.07, 0.021])
    result = calibrate(ur3, table, cell=Cell(target=given, estimate_target=False), validate=False)
    np.testing.assert_array_equal(result.target, given)
    assert len(result.parameters) == 24


def test_progress_is_told_after_each_fit(ur3, table, paper_cell):
    few = table.select(np.arange(35) < 12)
    seen = []
    calibrate(ur3, few, cell=paper_cell, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i + 1, 12) for i in range(12)]


def test_few_rows_are_to_be_used_with_care(ur3, table, paper_cell):
    result = calibrate(ur3, table.select(np.arange(35) < 12), cell=paper_cell)
    assert result.verdict.use != "use"
    assert any("are few" in reason for reason in result.verdict.reasons)


def test_data_that_do_not_fit_are_not_to_be_used(ur3, table):
    shuffled = replace(table, joints=np.roll(table.joints, 1, axis=0))
    result = calibrate(ur3, shuffled)
    assert result.verdict.use == "do not use"


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        (
            {"solver": "newton"},
            ModelError,
            "no solver 'newton'. Choose one of 'lm', 'paper', 'scipy'",
        ),
        ({"model": "dhh"}, ModelError, "no parameter set 'dhh'"),
        ({"cell": Cell(frozen=("d7",))}, ModelError, "no parameter 'd7'"),
        (
            {"cell": Cell(model="paper", estimate_frame=True)},
            ModelError,
            "'paper' knows the measurement frame",
        ),
        (
            {"cell": Cell(target=np.zeros(3), estimate_target=False, model="frames")},
            ModelError,
            "nothing to estimate",
        ),
    ],
)
def test_what_cannot_be_done_is_refused(ur3, table, options, error, text):
    with pytest.raises(error, match=text):
        calibrate(ur3, table, **options)


def test_fewer_numbers_than_parameters_need_priors(ur3, table):
    few = table.select(np.arange(35) < 8)
    with pytest.raises(
        MeasurementError, match="8 rows give 24 numbers for 27 parameters, and priors are off"
    ):
        calibrate(ur3, few, cell=Cell(priors=Priors("off")))


@pytest.mark.parametrize("what", ["targets", "groups"])
def test_several_targets_or_set_ups_are_not_fitted_as_one(ur3, table, what):
    names = ("A",) * 20 + ("B",) * 15
    with pytest.raises(
        ModelError, match=f"2 {what}: 'A', 'B'.*split the table by its column '{what[:-1]}'"
    ):
        calibrate(ur3, replace(table, **{what: names}))


def test_measurements_from_memory_do(ur3, table):
    data = Measurements(joint_names=ur3.joint_names, joints=table.joints, points=table.points)
    result = calibrate(ur3, data, validate=False)
    assert result.errors["calibrated"]["estimation"].n == 35
    assert result.verdict is None

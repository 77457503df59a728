"""evaluate: every kind of measurement, with what is known and what is registered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.errors import ArgumentError, CalibError, ModelError
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.evaluate.acceptance import assess
from calib.verbs.evaluate.accuracy import accuracy
from calib.verbs.evaluate.evaluation import ImageFigures, _not_given, evaluate, moved_place
from calib.verbs.simulate.disturbances import FrameStep, StandingTargets
from calib.verbs.simulate.scenario import Scenario, simulate
from tests import images
from tests.fits import FREE, TARGETS, TRACKERS


def part(setup: Setup, frames: list[int] | None = None, targets: list[int] | None = None) -> Setup:
    """What is known of some of the frames and targets; None: of all."""
    f = list(range(len(setup.groups))) if frames is None else frames
    t = list(range(len(setup.targets))) if targets is None else targets
    return replace(
        setup,
        groups=tuple(setup.groups[k] for k in f),
        T_frame_base=setup.T_frame_base[f],
        targets=tuple(setup.targets[k] for k in t),
        T_tip_target=setup.T_tip_target[t],
    )


def test_the_nominal_errors_are_those_of_the_fit(case):
    """What a fit says of the nominal robot is what evaluate says of it, for every kind."""
    _, c = case
    found = evaluate(c.nominal, c.fit.measurements, c.fit.cell)
    np.testing.assert_allclose(found.residual, c.rows.residual_nominal, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.used, c.rows.channels.used)
    for name in ("estimation", "validation"):
        assert found.errors[name]["m"].n == c.errors["nominal"][name]["m"].n
    assert found.errors["all"]["m"].n == sum(
        found.errors[k]["m"].n for k in ("estimation", "validation")
    )
    assert "target" in found.registered
    scene = not {"point", "pose", "pair"} & set(c.fit.measurements.kinds)
    assert ("frame" in found.registered) == (c.fit.cell.estimate_frame or scene)


def test_a_result_gives_its_chain_origins_frames_and_targets(case):
    """Nominal or corrected, the robot has the errors that the fit says of the calibrated one, for every kind."""
    _, c = case
    cell = replace(c.fit.cell, target=None, targets={}, T_frame_base=None, frames={})
    m = c.fit.measurements
    for robot in (c.nominal, c.robot):
        found = evaluate(robot, m, cell, calibration=c)
        np.testing.assert_allclose(found.residual, c.rows.residual_calibrated, rtol=0, atol=1e-8)
        assert found.registered == ()
    # U of each kind's errors, of pairs and end stops alone none, is of their size.
    for unit in found.channels.present:
        U, errors = found.expanded(unit), found.channels.norms(found.residual, unit)
        known = np.isfinite(U) & np.isfinite(errors)
        alone = [kind in ("pair", "stop") for kind in m.kinds]
        np.testing.assert_array_equal(known, np.isfinite(errors) & ~np.array(alone))
        if np.any(known):
            assert np.mean(found.within(unit)[known]) > 0.85
    if c.non_geometric is not None:
        found = evaluate(c.robot, m, cell, calibration=c, non_geometric=c.non_geometric)
        np.testing.assert_allclose(found.residual, c.non_geometric.residual, rtol=0, atol=1e-8)


def test_a_result_may_be_its_file_and_the_robot_a_path(calibrated, tmp_path):
    _, c = calibrated("points")
    c.nominal.urdf.write(tmp_path / "robot.urdf")
    c.write_json(tmp_path / "result.json")
    frame = c.fit.measurements.to_frame()
    found = evaluate(tmp_path / "robot.urdf", frame, calibration=tmp_path / "result.json")
    np.testing.assert_allclose(found.residual, c.rows.residual_calibrated, atol=1e-9)
    assert (found.robot.base, found.robot.tip) == (c.nominal.base, c.nominal.tip)
    table = found.to_frame()
    rms = np.sqrt(np.mean(table["error [mm]"] ** 2))
    assert rms == pytest.approx(1e3 * found.errors["all"]["m"].rms, rel=1e-12)
    # U is in it, since a calibration predicts the rows.
    np.testing.assert_allclose(table["U [mm]"], 1e3 * found.expanded("m"))
    np.testing.assert_array_equal(table["within U of position"], found.within("m"))
    assert not any("U" in name for name in evaluate(c.nominal, frame).to_frame().columns)
    with pytest.raises(ArgumentError, match="Give one of them"):
        evaluate(c.nominal, frame, calibration=c, known=c.setup)
    with pytest.raises(ArgumentError):
        evaluate(c.nominal, frame, calibration=5)
    with pytest.raises(CalibError, match="elsewhere"):
        evaluate(c.nominal, frame, Cell(base="elsewhere"), calibration=c)


def test_what_is_known_wins_over_the_cell(calibrated):
    _, c = calibrated("points")
    cell = Cell(target=np.array([0.5, 0.5, 0.5]), estimate_target=False)
    found = evaluate(c.robot, c.fit.measurements, cell, known=c.setup)
    np.testing.assert_allclose(found.residual, c.rows.residual_calibrated, atol=1e-9)
    off = evaluate(c.robot, c.fit.measurements, cell)
    assert off.errors["all"]["m"].rms > 0.3
    only_frames = evaluate(c.robot, c.fit.measurements, cell, known=c.setup, which=("frame",))
    assert only_frames.errors["all"]["m"].rms > 0.3


def test_targets_that_a_result_lacks_are_registered(calibrated):
    _, c = calibrated("targets")
    known = part(c.setup, targets=[1])
    found = evaluate(c.robot, c.fit.measurements, known=known)
    assert found.registered == ("target",)
    np.testing.assert_array_equal(found.setup.T_tip_target[1], c.setup.T_tip_target[1])
    assert np.linalg.norm(found.setup.T_tip_target[0, :3, 3] - c.target) < 1e-4


def test_set_ups_that_nothing_is_known_of_are_refused(calibrated):
    _, c = calibrated("known set-ups")
    known = replace(c.setup, groups=("0", "2"))
    with pytest.raises(
        ModelError, match=r"has the stations '0', '2'; the table's '1' are not among"
    ):
        evaluate(c.robot, c.fit.measurements, known=known)


def test_a_new_socket_is_found(calibrated):
    """What a socket is for: nobody needs to know where it is."""
    _, c = calibrated("sockets")
    known = part(c.setup, frames=[0, 1])
    found = evaluate(c.robot, c.fit.measurements, known=known)
    assert found.registered == ("frame",)
    assert (
        found.errors["all"]["m"].rms < 1.05 * c.errors["calibrated"]["estimation"]["m"].rms + 1e-5
    )


@pytest.mark.parametrize("model", ["dh", "dh+gain"])
def test_another_target_seen_from_another_place_is_registered_when_asked(make_scene, model):
    """Of a target of another name and a frame found anew all robots are right without noise; the frame is hinted at."""
    bent = {"model": model, "other": {"gain": 1e-3} if "+" in model else None}
    scene = make_scene(61, frames=TRACKERS, targets=TARGETS, length=3e-4, angle=3e-3, **bent)
    c = calibrate(scene.robot, scene.points(60), cell=FREE, model=model, validate=False)
    fresh = scene.points(20, 1, 1)
    anew = assess(c.robot, fresh, FREE, c, which=("target",))
    assert {one.registered for one in anew.evaluations.values()} == {("target", "frame")}
    best = anew.evaluations["non_geometric" if c.non_geometric else "calibration"]
    assert best.errors["all"]["m"].rms < 1e-9
    assert anew.evaluations["nominal"].errors["all"]["m"].rms > 1e-3
    assert anew.hint is None
    known = replace(fresh, groups=("0",) * 20)
    off = assess(c.robot, known, FREE, c, which=("frame", "target"))
    assert off.evaluations["calibration"].registered == ("target",)
    assert off.evaluations["calibration"].errors["all"]["m"].rms > 0.1
    assert off.hint is not None
    assert off.hint.code == "frame_moved"


def test_rows_that_found_a_set_up_do_not_judge_it_free_of_charge(calibrated):
    """A socket that validation rows alone touch is registered to them, which their random errors pay for."""
    _, c = calibrated("sockets")
    sets = tuple("validate" if g == "2" else "estimate" for g in c.fit.measurements.groups)
    found = evaluate(c.robot, replace(c.fit.measurements, sets=sets), c.fit.cell)
    one = accuracy(found)
    assert found.errors["validation"]["m"].rms < 2 * c.errors["calibrated"]["estimation"]["m"].rms
    assert (one.registered, one.rows) == (("target", "frame"), "validation")
    assert one.factor > 1.0


def test_rows_that_joints_reached_from_other_sides_are_hinted_at(calibrated):
    """Only if they all came from one side at the calibration."""
    _, c = calibrated("points")
    assert c.verdict is not None
    one_sided = replace(
        c.verdict, reasons=(*c.verdict.reasons, Reason.of(Why.ONE_SIDED, rising=["a"], falling=[]))
    )
    from_one = replace(c, geometry=replace(c.geometry, verdict=one_sided))
    table = c.fit.measurements
    rising = replace(table, moves=np.full(table.joints.shape, 0.1))
    hint = assess(c.nominal, table, Cell(), from_one).hint
    assert hint is not None
    assert hint.why is Why.OTHER_SIDES
    assert assess(c.nominal, rising, Cell(), from_one).hint is None
    falling = replace(table, moves=-rising.moves)
    assert assess(c.nominal, falling, Cell(), from_one).hint == Reason.of(Why.OTHER_SIDES)
    assert assess(c.nominal, table, Cell(), c).hint is None


def test_the_usual_mistakes_are_looked_for_in_points_only(calibrated):
    _, c = calibrated("planes")
    assert assess(c.nominal, c.fit.measurements, Cell()).hint is None


@pytest.mark.parametrize(
    ("unknown", "given", "registered"),
    [(True, False, True), (True, True, False), (False, True, False), (False, False, False)],
)
def test_what_is_unknown_and_not_given_is_registered(
    calibrated, unknown: bool, given: bool, registered: bool
):
    _, c = calibrated("targets")
    # Of two targets the second, and of a frame one direction.
    known = replace(
        c.setup,
        target_unknown=np.array([False, False]),
        target_given=np.array([True, True]),
        unknown=((),),
        frame_given=np.array([True]),
    )
    assert _not_given(known) == ()
    target = replace(
        known, target_unknown=np.array([False, unknown]), target_given=np.array([True, given])
    )
    assert _not_given(target) == (("target",) if registered else ())
    frame = replace(known, unknown=(("x",) if unknown else (),), frame_given=np.array([given]))
    assert _not_given(frame) == (("frame",) if registered else ())


TARGET = np.array([0.05, 0.06, 0.07])


def fresh(
    robot: Robot, target: np.ndarray, shift: np.ndarray, count: int = 12
) -> tuple[Measurements, Setup]:
    """Points with 0.05 mm of noise, of a target and in a frame that may not be those of a result; and the result's."""
    q = random_joint_values(robot, count, 1)
    poses = robot.poses(q)
    noise = np.random.default_rng(1).normal(0.0, 5e-5, (count, 3))
    points = poses[:, :3, :3] @ target + poses[:, :3, 3] + shift + noise
    table = Measurements(robot.joint_names, q, points)
    known = evaluate(robot, table, Cell(target=TARGET, estimate_target=False)).setup
    return table, known


@pytest.mark.parametrize(
    ("target", "shift", "place", "rms"),
    [
        ([0.0, 0.0, 0.0], [2e-3, 0.0, 1e-3], "frame", 0.0779e-3),
        ([2e-3, 0.0, 0.0], [0.0, 0.0, 0.0], "target", 0.0782e-3),
    ],
)
def test_what_moved_since_the_calibration_is_named(
    ur3: Robot, target: list[float], shift: list[float], place: str, rms: float
):
    m, known = fresh(ur3, TARGET + target, np.array(shift))
    found = moved_place(ur3, m, Cell(), known)
    assert found is not None
    assert (found.code, found.values["error_m"]) == (f"{place}_moved", pytest.approx(rms, rel=1e-3))
    assert found.values["given_m"] > 1e-3


@pytest.mark.parametrize(
    ("shift", "count", "noise"), [(0.0, 12, 0.0), (2e-3, 2, 0.0), (2e-3, 4, 0.0), (0.0, 12, 1e-3)]
)
def test_nothing_moved_where_nothing_is_known(ur3: Robot, shift: float, count: int, noise: float):
    """Nothing to explain; too few rows to find a frame, or to trust it; and errors of the robot."""
    m, known = fresh(ur3, TARGET, np.array([shift, 0.0, 0.0]), count)
    off = noise * np.random.default_rng(4).normal(size=(count, 3))
    table = Measurements(m.joint_names, m.joints, m.points + off)
    assert moved_place(ur3, table, Cell(), known) is None


def test_two_images_of_one_pose_are_two():
    q = images.poses(3)[[0, 0, 1]]
    m = images.table(q)
    rows, _ = rows_and_setup(images.arm(), m, images.cell())
    residual = np.tile([3.0, 4.0], (len(m), 1))
    figures = ImageFigures.of(residual, np.full(len(m), 1e-3), rows, m.images)
    assert (figures.images, figures.corners) == (3, 3 * len(images.BOARD.corners))
    assert (figures.mean, figures.bias) == (pytest.approx(5.0), (3.0, 4.0))
    assert figures.largest_at_board == pytest.approx(5e-3)
    unnamed = ImageFigures.of(residual, np.full(len(m), 1e-3), rows, ("",) * len(m))
    assert unnamed.images == 2


def test_what_references_show_is_taken_out(ur3):
    scenario = Scenario(
        ur3,
        sizes=None,
        target_error=0.0,
        step=FrameStep(12, np.array([0.0, 1e-3, 0.0])),
        standing=StandingTargets(3, 5),
    )
    measured = simulate(scenario, 20, 0, seed=1).measurements
    cell = Cell(target=np.array([0.05, 0.05, 0.05]), estimate_target=False)
    found = evaluate(ur3, measured, cell)
    (step,) = found.drift.found
    np.testing.assert_allclose(step.by, [0.0, 1e-3, 0.0], atol=1e-4)
    taken_out = measured.points - found.measurements.points
    np.testing.assert_allclose(taken_out[-1], step.by, atol=1e-12)
    assert not taken_out[:9].any()
    assert np.abs(found.residual[15:]).max() < 3e-4
    assert evaluate(ur3, replace(measured, references=None), cell).drift is None

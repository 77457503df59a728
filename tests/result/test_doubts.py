"""Doubts about a result besides its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Verdict, Why
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.numerics.repeats import Repeats
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.doubts import (
    _agreeing_repeats,
    negative_compliances,
    noise_doubts,
)
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.judged import arm, judged, reasons, table_of
from tests.parts import with_part


def test_good_data_give_no_reason_for_care(make_scene):
    result = judged(make_scene, 61, cell=Cell(model="dh", instrument="tracker"))
    assert result.verdict.use == "use"
    assert list(reasons(result)) == [Why.GAIN]


def test_a_target_that_is_not_where_it_was_given(make_scene):
    """Said first; within the reach of a drawing's error it is nothing to say."""
    scene = arm(make_scene, 61)
    place = scene.kinematics.T_tip_target[0, :3, 3]
    wrong = judged(make_scene, 61, cell=Cell(model="dh", target=place + np.array([0.2, -0.2, 0.0])))
    assert (wrong.verdict.use, wrong.verdict.reasons[0].why) == ("use with care", Why.TARGET_FAR)
    assert wrong.verdict.reasons[0].values["far_m"] == pytest.approx(0.2 * np.sqrt(2.0), abs=2e-3)
    near = judged(make_scene, 61, cell=Cell(model="dh", target=place + np.array([3e-3, 0.0, 0.0])))
    assert Why.TARGET_FAR not in reasons(near)


def test_points_of_another_variant_of_the_arm(make_scene):
    """A UR3's points with the URDF of a UR3e, whose d4 is 18.7 mm longer: rows agree, and the verdict asks."""
    scene = arm(make_scene, 61)
    table = table_of(scene, random_joint_values(scene.robot, 40, 1), np.random.default_rng(1))
    other = Robot.load("ur3e", base="base", tip="tool0")
    result = calibrate(other, table, model="dh", cell=Cell(estimate_frame=True))
    first = result.verdict.reasons[0]
    assert (result.verdict.use, first.why) == ("use with care", Why.OTHER_VARIANT)
    assert first.values["moved_m"] == pytest.approx(18.7e-3, abs=2e-3)
    assert first.values["arm"] == "UR3"


def test_a_base_that_does_not_stand_where_the_known_frame_puts_it(make_scene):
    """A base 6 mm off becomes arm geometry, and unseen rows agree."""
    moved = judged(
        make_scene,
        61,
        lambda m: replace(m, points=m.points + np.array([6e-3, 0.0, 0.0])),
        model="placement",
    )
    first = moved.verdict.reasons[0]
    assert (moved.verdict.use, first.why) == ("use with care", Why.BASE_MOVED)
    assert first.values["moved_m"] == pytest.approx(6e-3, abs=5e-4)
    assert moved.cross_validation.errors["m"].rms < 2e-4
    free = Cell(model="dh", estimate_frame=True)
    assert Why.BASE_MOVED not in reasons(judged(make_scene, 61, cell=free))


def test_a_certified_scale_hides_nothing(make_scene):
    def stretched(m):
        return replace(m, points=1.01 * m.points)

    wrong = judged(make_scene, 61, stretched)
    hidden = reasons(wrong)[Why.SCALE_HIDDEN]
    assert wrong.verdict.use != "use"
    assert hidden["scale"] == pytest.approx(0.01, rel=0.3)
    assert wrong.geometry.scale_everywhere == pytest.approx(hidden["effect_m"], rel=0.05)
    assert wrong.new_point[1] > 0.9 * hidden["effect_m"]
    certified = Cell(model="dh", scale_certified=True)
    sure = judged(make_scene, 61, stretched, cell=certified)
    assert Why.SCALE_HIDDEN not in reasons(sure)
    assert sure.geometry.scale_everywhere == 0.0


def test_a_named_instrument_has_its_scale(make_scene):
    """The better the scale is known, the less of it is expected; a stated uncertainty wins."""
    sizes = []
    for changes in (
        {},
        {"instrument": "print"},
        {"instrument": "tracker"},
        {"instrument": "print", "stated_scale_sigma": 1e-6},
    ):
        result = judged(make_scene, 61, cell=Cell(model="dh", **changes))
        sizes.append(result.geometry.scale_everywhere)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[2] < 3e-5 < sizes[1]


def test_a_corner_of_the_workspace(make_scene):
    scene = arm(make_scene, 62)
    rng = np.random.default_rng(2)
    q = np.array([0.3, -1.2, 1.4, -0.8, 0.6, 0.2]) + 0.25 * rng.uniform(-1, 1, (70, 6))
    result = calibrate(scene.robot, table_of(scene, q, rng), model="dh")
    assert reasons(result)[Why.CORNER]["spread"] < 1 / 3


def test_a_joint_that_stood_still_is_no_corner_of_the_others(make_scene):
    """It is named once; all others moved all over their ranges."""
    scene = arm(make_scene, 62)
    q = random_joint_values(scene.robot, 60, 3)
    q[:, 3] = 0.3
    found = reasons(
        calibrate(scene.robot, table_of(scene, q, np.random.default_rng(2)), model="dh")
    )
    assert found[Why.JOINTS_STILL]["joints"] == scene.robot.joint_names[3]
    assert Why.CORNER not in found


def test_sockets_without_a_known_distance_tell_no_length(calibrated):
    scene, good = calibrated("sockets")
    assert Why.NO_LENGTH not in reasons(good)
    unknown = calibrate(
        scene.robot, good.fit.measurements, cell=replace(good.fit.cell, distances=())
    )
    assert Why.NO_LENGTH in reasons(unknown)
    assert unknown.verdict.use == "use"


def test_a_model_that_lacks_what_placements_have(make_scene):
    result = judged(make_scene, 67, model="zeros", given={"model": "placement"})
    told = reasons(result)[Why.MODEL_LACKS]
    assert (told["model"], told["less_m"] < 0.6 * told["noise_m"]) == ("zeros", True)


@pytest.mark.parametrize("scale", [0.01, -0.01])
def test_a_scale_of_the_instrument(make_scene, scale):
    """A board printed 1 % too large: the fit makes every link longer, and unseen rows agree."""
    result = judged(make_scene, 70, lambda m: replace(m, points=(1.0 + scale) * m.points))
    told = reasons(result)[Why.LENGTHS_SCALED]
    assert told["scale"] == pytest.approx(scale, abs=3.0 * told["std"])
    assert result.verdict.use == "use with care"


def test_a_joint_that_moves_against_its_load_where_gravity_is_turned(make_scene):
    scene = arm(make_scene, 71, model="dh+compliance", other={"compliance": 2e-4})
    scene.x[scene.kinematics.model.family("compliance")] = 1e-4
    m = table_of(scene, random_joint_values(scene.robot, 70, 11), np.random.default_rng(11))
    up, down = (Cell(model="dh+compliance", gravity=(0.0, 0.0, g)) for g in (9.81, -9.81))
    wrong, right = (calibrate(scene.robot, m, cell=cell) for cell in (up, down))

    def codes(verdict: Verdict) -> set[str]:
        return {reason.code for reason in verdict.reasons}

    assert "compliance_negative" in codes(wrong.non_geometric.verdict)
    assert "compliance_negative" not in codes(right.non_geometric.verdict)
    # The URDF holds no compliance.
    assert "compliance_negative" not in codes(wrong.verdict)


@pytest.mark.parametrize(
    ("noise", "stated", "codes"),
    [(3e-3, None, []), (3e-2, None, []), (3e-3, 3e-3, []), (3e-3, 4e-4, [Why.NOISE_ABOVE_SIGMA])],
)
def test_the_noise_of_angles_is_held_against_the_stated_one_alone(make_scene, noise, stated, codes):
    scene = arm(make_scene, 63, noise=3e-5, noise_angle=noise)
    cell = Cell(model="dh", sigma={} if stated is None else {"rad": stated})
    result = calibrate(scene.robot, scene.poses(40), cell=cell, validate=False)
    geometry = result.fit.geometry
    found = list(noise_doubts(result, geometry, ()))
    assert [reason.why for reason in found] == codes
    for reason in found:
        # Estimated from 120 angles: within four standard deviations.
        assert reason.values["after_rad"] == pytest.approx(3e-3, rel=0.3)
        assert reason.values["before_rad"] == stated
        assert reason.values["ratio"] == pytest.approx(reason.values["after_rad"] / stated)


def test_every_joint_that_moved_in_a_small_part_of_its_range_is_named(make_scene):
    """The one that moved least comes first."""
    scene = arm(make_scene, 61)
    q = random_joint_values(scene.robot, 60, 1)
    q[:, 1] *= 0.15
    q[:, 2] *= 0.1
    table = table_of(scene, q, np.random.default_rng(1))
    found = reasons(calibrate(scene.robot, table, model="dh"))[Why.CORNER]
    names = scene.robot.joint_names
    assert found["joints"] == [names[2], names[1]]
    assert found["lows"] == [q[:, 2].min(), q[:, 1].min()]
    assert found["highs"] == [q[:, 2].max(), q[:, 1].max()]


@pytest.mark.parametrize(
    ("noise", "stated", "why"),
    [
        (3e-5, None, None),
        (4e-3, None, Why.NOISE_LARGE),
        (4e-3, 4e-3, None),
        (4e-3, 2e-4, Why.NOISE_ABOVE_SIGMA),
        (4e-5, 1e-6, None),  # the robot's repeatability
        (4e-5, 4e-5 / 900.0, Why.SIGMA_UNLIKELY),
        (4e-5, 1e-4, None),
        (4e-5, 5e-3, Why.SIGMA_UNLIKELY),
    ],
)
def test_the_noise_of_lengths_is_held_against_the_stated_or_a_usual_one(
    make_scene, noise, stated, why
):
    scene = arm(make_scene, 63, noise=noise)
    cell = Cell(model="dh", sigma={} if stated is None else {"m": stated})
    result = calibrate(scene.robot, scene.points(60), cell=cell, validate=False)
    found = list(noise_doubts(result, result.fit.geometry, ()))
    assert [reason.why for reason in found] == ([] if why is None else [why])
    for reason in found:
        size = reason.values["noise_m"] if stated is None else reason.values["after_m"]
        assert size == pytest.approx(noise, rel=0.3)


def test_residuals_that_a_model_lacks_or_that_follow_a_joint_are_no_noise(make_scene, calibrated):
    """The latter only where no non-geometric model was tried: neither by a name nor by the data."""
    scene = arm(make_scene, 63, noise=4e-3)
    named = calibrate(scene.robot, scene.points(60), model="dh", validate=False)
    lacks = Reason.of(Why.MODEL_LACKS, model="dh", less_m=1e-3, noise_m=4e-3)
    follows = Reason.of(Why.JOINT_PATTERN)

    def found(result: Calibration, doubt: Reason) -> list[Why]:
        fitted = named.fit.geometry
        return [reason.why for reason in noise_doubts(result, fitted, (doubt,))]

    assert found(named, lacks) == []
    assert found(named, follows) == []
    assert found(named, Reason.of(Why.DRIFT)) == [Why.NOISE_LARGE]
    chosen = with_part(named, "method", candidates=calibrated("points")[1].method.candidates)
    assert found(chosen, follows) == [Why.NOISE_LARGE]
    tried = replace(named, non_geometric=calibrated("gain")[1].non_geometric)
    assert found(tried, follows) == [Why.NOISE_LARGE]


@pytest.mark.parametrize(
    ("share", "freedom", "noise", "told"),
    [
        (0.45, 20.0, 3e-5, True),
        (0.55, 20.0, 3e-5, False),
        (0.45, 10.0, 3e-5, True),
        (0.45, 9.0, 3e-5, False),  # too few to say
        (0.45, 20.0, 0.0, False),  # rounding
    ],
)
def test_repeats_that_agree_better_with_each_other_than_with_the_model(
    make_scene, share: float, freedom: float, noise: float, told: bool
):
    scene = arm(make_scene, 63, noise=noise)
    result = calibrate(scene.robot, scene.points(40), model="dh", validate=False)
    left = result.noise.sigma["m"]
    repeats = Repeats(within={"m": share * left}, freedoms={"m": freedom}, rho=0.9)
    found = list(
        _agreeing_repeats(with_part(result, "noise", repeats=repeats), result.fit.geometry)
    )
    assert [reason.why for reason in found] == [Why.REPEATS_AGREE] * told
    for reason in found:
        assert reason.values["within_m"] == share * left
        assert reason.values["noise_m"] == pytest.approx(left)
    assert (
        list(_agreeing_repeats(with_part(result, "noise", repeats=None), result.fit.geometry)) == []
    )


@pytest.mark.parametrize(
    ("sizes", "std", "held", "negative"),
    [
        ((-3e-5,), 1e-5, False, False),
        ((-6e-5,), 1e-5, False, True),
        ((-6e-5,), 1e-5, True, False),  # by the user's bound
        ((6e-5,), 1e-5, False, False),
        ((-6e-5, 8e-5), 1e-5, False, False),  # a mass beside the points
        ((-6e-5, -4e-5), 1e-5, False, True),
        ((-4e-5, -1e-5), 1e-5, False, False),
    ],
)
def test_a_joint_moves_against_its_load_if_its_compliances_add_up_to_less_than_nothing(
    make_scene, sizes: tuple[float, ...], std: float, held: bool, negative: bool
):
    """By more than twice the interval of the sum."""
    scene = arm(make_scene, 71)
    m = table_of(scene, random_joint_values(scene.robot, 12, 11), np.random.default_rng(11))
    rows, setup = rows_and_setup(scene.robot, m, Cell(model="dh+gravity"))
    fitted = fit(Task(scene.robot, Cell(), setup, "dh+gravity"), rows)
    estimate, parameters = fitted.estimate, fitted.kinematics.model.parameters
    of_elbow = [
        k for k, p in enumerate(parameters) if (p.family, p.place) == ("gravity", "elbow_joint")
    ]
    columns = of_elbow[: len(sizes)]
    x = np.zeros(len(parameters))
    x[columns] = sizes
    variances = np.zeros(len(parameters))
    variances[columns] = std**2
    changed = replace(
        estimate,
        x=x,
        covariance=np.diag(variances),
        freedom=1e6,
        at_bound=tuple(columns) * held,
    )
    found = negative_compliances(replace(fitted, estimate=changed))
    assert [reason.values["joint"] for reason in found] == ["elbow_joint"] * negative


@pytest.mark.parametrize(("silent", "why"), [(1, Why.NOISE_ABOVE_SIGMA), (2, Why.NOISE_LARGE)])
def test_noise_is_stated_if_every_fitted_row_states_it(
    make_scene, monkeypatch, silent: int, why: Why
):
    """The second row, which validates, need not."""
    scene = arm(make_scene, 63, noise=4e-3)
    sets = ("estimate", "validate", *("estimate",) * 58)
    m = replace(scene.points(60), sets=sets)
    result = calibrate(scene.robot, m, model="dh", validate=False)
    sigma = np.full(60, 2e-4)
    sigma[silent] = np.nan
    monkeypatch.setattr(Measurements, "stated_sigma", {"m": sigma})
    fitted = result.fit.geometry
    rows = fitted.estimate.problem.rows
    stated = replace(rows, sigma={"m": np.full(len(rows), 2e-4)})
    problem = replace(fitted.estimate.problem, rows=stated)
    found = noise_doubts(
        result, replace(fitted, estimate=replace(fitted.estimate, problem=problem)), ()
    )
    assert [reason.why for reason in found] == [why]


def test_copies_of_rows_are_left_out(make_scene):
    def twice(m: Measurements) -> Measurements:
        each = np.arange(80) // 2
        return Measurements(m.joint_names, joints=m.joints[each], points=m.points[each])

    one, other = judged(make_scene, 72, rows=40), judged(make_scene, 72, twice, rows=40)
    np.testing.assert_array_equal(one.geometry.x, other.geometry.x)
    assert reasons(other)[Why.ROWS_COPIED] == {"rows": 40, "row": 2}


def test_residuals_that_a_non_geometric_model_explains_are_no_noise(make_scene):
    scene = arm(make_scene, 71, model="dh+eccentricity", other={"eccentricity": 1e-2})
    m = table_of(scene, random_joint_values(scene.robot, 60, 11), np.random.default_rng(11))
    result = calibrate(scene.robot, m, model="dh+eccentricity", validate=False)
    fits = (result.fit.geometry, result.fit.non_geometric)
    geometry, non_geometric = (one.estimate.sigma["m"] for one in fits)
    assert geometry > 1e-3 > 10.0 * non_geometric
    assert not list(noise_doubts(result, result.fit.geometry, ()))
    alone = calibrate(scene.robot, m, model="dh", validate=False)
    [doubt] = noise_doubts(alone, alone.fit.geometry, ())
    assert doubt.why is Why.NOISE_LARGE

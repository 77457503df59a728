"""Two calibrations of one virtual UR3, unchanged or changed in a known way, its tracker and target moved."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.json_files import plain
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Verdict
from calib.errors import FileError, ModelError
from calib.example import PAPER_TARGET
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import spread_between
from calib.robot.robot import Robot
from calib.verbs.compare.comparison import Comparison, Outcome, compare
from calib.verbs.compare.drift import LEVEL
from calib.verbs.compare.text import notes
from tests.parts import with_part
from tests.two_handed import fitted
from tests.verbs.compare.documented import documented_keys, keys


@dataclass(frozen=True)
class Arm:
    """A UR3 that errs by 0.3 mm and 1 mrad, drawn from a seed, and changes of it by name."""

    robot: Robot
    seed: int

    def x(self, change: Mapping[str, float]) -> tuple[Any, np.ndarray]:
        model = error_model(self.robot, "dh", target=False)
        size = np.where(np.array(model.units) == "m", 3e-4, 1e-3)
        x = size * np.random.default_rng(self.seed).normal(size=len(size))
        for name, value in change.items():
            x[model.index(name)] += value
        return model, x

    def measured(
        self,
        visit: int,
        change: Mapping[str, float] | None = None,
        *,
        count: int = 30,
        noise: float = 5e-5,
        elsewhere: bool = True,
        fit: str = "dh",
        start: Robot | None = None,
        validate: bool = False,
    ) -> tuple[Calibration, np.ndarray, np.ndarray]:
        """A calibration, and where frame and target truly were."""
        rng = np.random.default_rng([self.seed, visit])
        model, x = self.x(change or {})
        T_frame_base, T_tip_target = np.eye(4), np.eye(4)
        T_tip_target[:3, 3] = PAPER_TARGET
        if elsewhere:
            T_frame_base[:3, :3] = Rotation.random(random_state=rng).as_matrix()
            T_frame_base[:3, 3] = rng.uniform(-3.0, 3.0, 3)
            T_tip_target[:3, 3] += rng.normal(0.0, 0.02, 3)
        q = rng.uniform(-2.5, 2.5, (count, 6))
        points = Kinematics(self.robot, model, T_frame_base, T_tip_target).points(x, q)
        table = Measurements(self.robot.joint_names, q, points + rng.normal(0.0, noise, (count, 3)))
        cell = Cell(estimate_frame=elsewhere, model=fit)
        found = calibrate(start or self.robot, table, cell=cell, validate=validate)
        return found, T_frame_base, T_tip_target


@pytest.fixture(scope="module")
def arm(ur3: Robot) -> Arm:
    return Arm(ur3, 7)


@pytest.fixture(scope="module")
def before(arm: Arm) -> Calibration:
    return arm.measured(1)[0]


@pytest.fixture(scope="module")
def later(arm: Arm) -> Callable[..., Calibration]:
    """Calibrations of a later visit, each made once."""

    @cache
    def run(theta: str = "", change: float = 0.0, **given: Any) -> Calibration:
        return arm.measured(2, {theta: change} if theta else {}, **given)[0]

    return run


@pytest.fixture(scope="module")
def unchanged(before: Calibration, later: Callable[..., Calibration]) -> Comparison:
    return compare(before, later())


@pytest.fixture(scope="module")
def drifted(before: Calibration, later: Callable[..., Calibration]) -> Comparison:
    return compare(before, later("theta3", 1e-3))


def test_a_robot_that_did_not_change(unchanged: Comparison):
    c = unchanged
    assert (c.outcome, c.why) == ("no drift shown", "")
    assert c.test.p > LEVEL
    # 24 parameters, less two of three parallel axes, two that the frame and four that the target make up for.
    assert c.test.combinations == 16
    assert set(c.compensated) == {"d1", "theta1", "a6", "alpha6", "d6", "theta6"}
    assert [m.where for m in c.moves] == ["measured ranges", "joint limits"]
    for move in c.moves:
        assert 0.4 * move.noise < move.rms < 1.6 * move.noise
        assert move.rms < move.max < 5.0 * move.rms
        assert np.isnan(move.rms_angle)
    assert (c.only_a, c.only_b, notes(c)) == ((), (), ())
    assert repr(c).startswith("Comparison('a', 'b', no drift shown, p = 0.")


def true_move(arm: Arm, c: Comparison, change: Mapping[str, float]) -> float:
    """How far the target truly moved, less the best motion of frame and target, rms: by a path of its own."""
    model, x = arm.x({})
    _, y = arm.x(change)
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = c.a.target
    kinematics = Kinematics(arm.robot, model, np.eye(4), T_tip_target)
    low = np.maximum(c.a.rows.ranges[:, 0], c.b.rows.ranges[:, 0])
    high = np.minimum(c.a.rows.ranges[:, 1], c.b.rows.ranges[:, 1])
    q = spread_between(np.stack([low, high], axis=1), 200)
    T, points = kinematics.poses(x, q), kinematics.points(y, q)
    by_frame = np.concatenate(
        [np.tile(np.eye(3), (200, 1, 1)), np.cross(np.eye(3), points[:, None]).swapaxes(1, 2)],
        axis=2,
    )
    G = np.concatenate([by_frame, T[:, :3, :3]], axis=2).reshape(600, 9)
    moved = (points - T[:, :3, 3]).ravel()
    left = moved - G @ np.linalg.lstsq(G, moved, rcond=None)[0]
    return float(np.linalg.norm(left) / np.sqrt(200))


def test_a_joint_that_drifted_by_a_milliradian(arm: Arm, drifted: Comparison):
    c = drifted
    assert c.outcome == "drift"
    assert c.test.sigma > 8.0
    wanted = true_move(arm, c, {"theta3": 1e-3})
    assert wanted > 1e-4
    assert c.moves[0].moved == pytest.approx(wanted, abs=3.0 * c.moves[0].std)


def test_what_the_frame_makes_up_for_is_no_drift_but_with_a_known_frame_it_is(
    arm: Arm, before: Calibration, later: Callable[..., Calibration]
):
    lost = compare(before, later("theta1", 1e-3))
    assert lost.outcome == "no drift shown"
    assert "theta1" in lost.compensated
    known = [arm.measured(k, c, elsewhere=False)[0] for k, c in ((3, {}), (4, {"theta1": 1e-3}))]
    found = compare(*known)
    assert found.outcome == "drift"
    assert found.test.combinations == 18
    assert set(found.compensated) == {"a6", "alpha6", "d6", "theta6"}


def test_other_parameters_of_the_same_robot_predict_the_same(
    before: Calibration, later: Callable[..., Calibration], unchanged: Comparison
):
    c = compare(before, later(fit="hayati"))
    assert c.outcome == "no drift shown"
    assert c.test.p > LEVEL
    assert c.moves[0].rms == pytest.approx(unchanged.moves[0].rms, rel=0.3)
    assert c.only_a == ()
    assert c.only_b == ("beta2", "beta3")  # of two parallel axes dh has no tilt


def test_a_model_that_leaves_errors_out_looks_like_a_drift_and_is_not_called_one(
    before: Calibration, later: Callable[..., Calibration]
):
    c = compare(later(fit="zeros"), before)
    assert c.outcome == "cannot tell"
    assert c.test.drifted
    assert c.why == "other errors"
    assert c.only_b[:4] == ("a1", "alpha1", "a2", "alpha2")


def test_the_same_measurements_are_no_second_opinion(before: Calibration):
    c = compare(before, before)
    assert (c.outcome, c.test.chi_square) == ("cannot tell", 0.0)
    assert c.why == "same data"


def test_a_result_that_is_not_to_be_used(before, later):
    bad = with_part(later("theta3", 1e-3), "geometry", verdict=Verdict("do not use", ()))
    c = compare(before, bad)
    assert (c.outcome, c.why) == ("cannot tell", "bad verdict")
    careful = compare(before, with_part(bad, "geometry", verdict=Verdict("use with care", ())))
    assert careful.outcome == "drift"


def test_results_that_began_with_different_urdfs(arm: Arm, before: Calibration):
    for change, outcome in (({}, "no drift shown"), ({"theta3": 1e-3}, "drift")):
        again, _, _ = arm.measured(5, change, start=before.robot)
        c = compare(before, again)
        assert c.outcome == outcome
        if change:
            wanted = true_move(arm, c, change)
            assert c.moves[0].moved == pytest.approx(wanted, abs=3.0 * c.moves[0].std)


@pytest.mark.slow
def test_false_alarms_and_power(ur3: Robot):
    """`scripts/comparison_study.py` in small: 16 pairs of measurements of robots that did not change, 6 that did."""
    arms = [Arm(ur3, seed) for seed in range(100, 116)]
    first = [arm.measured(1, count=15)[0] for arm in arms]
    again = [arm.measured(2, count=15)[0] for arm in arms]
    p = np.array([compare(a, b).test.p for a, b in zip(first, again, strict=True)])
    # Unchanged, 3 or more of 16 below 0.01 have a probability of 5e-4, a mean of p beyond these ends one of 0.002.
    assert np.sum(p < LEVEL) < 3
    assert 0.28 < np.mean(p) < 0.72
    change = {"theta2": 1e-3}
    seen = [
        compare(a, arm.measured(2, change, count=15)[0])
        for a, arm in zip(first[:6], arms, strict=False)
    ]
    assert np.sum([c.outcome == "drift" for c in seen]) >= 5


@pytest.fixture(scope="module")
def files(before: Calibration, later: Callable[..., Calibration], tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    before.write_json(folder / "a.json")
    later("theta3", 1e-3).write_json(folder / "b.json")
    (folder / before.nominal.urdf.source).write_bytes(before.nominal.urdf.data)
    return folder


def test_result_files_say_the_same(files: Path, drifted: Comparison):
    c = compare(files / "a.json", str(files / "b.json"))
    assert c.names == ("a.json", "b.json")
    assert c.test.chi_square == pytest.approx(drifted.test.chi_square, rel=1e-6)
    assert c.moves[0].rms == pytest.approx(drifted.moves[0].rms, rel=1e-6)


def test_text_and_table(drifted: Comparison, unchanged: Comparison, tmp_path: Path):
    for c in (drifted, unchanged):
        lines = c.summary().splitlines()
        assert max(map(len, lines)) <= 100
        assert all(line == line.rstrip() and line.isprintable() for line in lines)
    assert "The robot drifted (" in drifted.summary().split("\n\n")[1]
    written = json.loads(drifted.write_json(tmp_path / "c.json").read_text(encoding="utf-8"))
    assert written["schema"] == "comparison 5"
    assert written["outcome"] == "drift"
    assert written["moves"][0]["rms_m"] == drifted.moves[0].rms
    with pytest.raises(FileError, match="exists"):
        drifted.write_json(tmp_path / "c.json")


def test_the_document_has_every_key(drifted: Comparison):
    documented, _ = documented_keys()
    assert keys(plain(drifted.table())) == documented


def test_a_model_without_errors_of_the_robot_cannot_drift(arm: Arm, before: Calibration):
    a, b = (arm.measured(visit, fit="frames")[0] for visit in (1, 2))
    found = compare(a, b)
    assert (found.outcome, found.test.combinations) == ("cannot tell", 0)
    assert [move.rms for move in found.moves] == pytest.approx([0.0, 0.0], abs=1e-9)
    # The other has all errors for itself.
    assert set(compare(a, before).only_b) | set(compare(a, before).compensated) >= {"theta2", "a3"}


@pytest.mark.parametrize("name", ["poses", "distances", "held"])
def test_every_kind_of_measurement(calibrated, name: str):
    _, c = calibrated(name)
    found = compare(c, c)
    assert found.test.chi_square == 0.0
    assert found.test.combinations > 0
    everything = {"d1", "theta1", "a6", "alpha6", "d6", "theta6"}
    assert set(found.compensated) == ({"wrist_3_joint.zero"} if name == "held" else everything)
    assert np.isfinite(found.moves[0].rms_angle) == (name == "poses")


def test_results_of_several_chains_are_of_the_same_chains_or_refused():
    c = fitted()
    (left, *_) = c.nominal.chains
    alone = replace(c, nominal=left)
    with pytest.raises(
        ModelError, match=r"'panda', panda_link0 to panda_link8, right/panda_link8 w"
    ):
        compare(c, alone)
    again = compare(c, replace(c))
    assert again.outcome in get_args(Outcome)
    assert again.test.chi_square == 0.0


@pytest.mark.slow
def test_results_of_several_chains_may_be_of_other_measurements():
    assert compare(fitted(), fitted(2)).outcome in get_args(Outcome)

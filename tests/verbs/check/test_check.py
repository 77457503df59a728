"""What a check says of points that Pinocchio predicts after something has moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError, ModelError
from calib.example import paper_measurements
from calib.verbs.check.check import CheckResult, Finding, check
from tests.verbs.check.shop import JOINTS, POSES, paper_result, points

#: Noise of a coordinate of the paper's table [m].
NOISE = 1.2e-4


def checked(**moved: object) -> CheckResult:
    return check(paper_result(), points(noise=NOISE, seed=5, **moved))  # type: ignore[arg-type]


def best(c: CheckResult) -> tuple[str, str]:
    return c.findings[0].code, c.findings[0].name


def test_nothing():
    c = checked()
    assert (c.outcome, c.named, c.matters) == ("nothing", (), None)
    assert c.p_value > 0.005
    assert c.nothing > 0.5
    assert (c.stops, c.numbers) == (3, 9)
    assert sum(finding.probability for finding in c.findings) == pytest.approx(1.0)


@pytest.mark.parametrize("k", [0, 1, 2, 3, 4])
def test_the_zero_of_a_joint(k: int):
    zeros = np.zeros(6)
    zeros[k] = -0.02
    c = checked(zeros=tuple(zeros))
    finding = c.findings[0]
    assert (c.outcome, best(c), finding.unit) == ("moved", ("joint", JOINTS[k]), "rad")
    assert finding.size == pytest.approx(-0.02, abs=4.0 * finding.size_std)
    assert finding.size_std < 0.005
    assert c.matters
    assert finding.change > 10.0 * c.expected


def test_the_frame():
    twist = np.array([3e-3, -4e-3, 2e-3, 2e-3, 1e-3, -3e-3])
    c = checked(frame=pin.exp6(twist).homogeneous)
    finding = c.findings[0]
    assert (c.outcome, best(c)) == ("moved", ("frame", ""))
    assert finding.turn == pytest.approx(np.linalg.norm(twist[3:]), rel=0.5)


def test_the_target():
    c = checked(target=(2e-3, -1e-3, 2e-3))
    finding = c.findings[0]
    assert (c.outcome, best(c)) == ("moved", ("target", ""))
    assert finding.size == pytest.approx(3e-3, abs=4.0 * finding.size_std)
    assert np.isnan(finding.turn)  # of a point


def test_a_single_row_that_is_off():
    table = points(noise=NOISE, seed=5)
    xyz = table.points.copy()
    xyz[1] += (3e-3, 2e-3, -2e-3)
    c = check(paper_result(), type(table)(joint_names=JOINTS, joints=POSES, points=xyz))
    finding = c.findings[0]
    assert (c.outcome, finding.code, finding.rows) == ("row", "row", (2,))
    assert finding.size == pytest.approx(np.sqrt(17) * 1e-3, rel=0.2)
    assert c.matters is None


def test_rows_of_another_unit_are_no_single_cause():
    table = points()
    xyz = 1.05 * table.points + [[0.01, 0.0, 0.02], [0.0, 0.02, 0.0], [0.0, 0.0, -0.03]]
    c = check(paper_result(), type(table)(joint_names=JOINTS, joints=POSES, points=xyz))
    assert c.outcome in ("other", "undecided")
    assert "other" in [finding.code for finding in c.named]


def test_a_tolerance_decides_whether_it_matters():
    table = points(zeros=(0.0, 0.01, 0.0, 0.0, 0.0, 0.0), noise=NOISE, seed=5)
    assert check(paper_result(), table, tolerance=1e-4).matters
    assert not check(paper_result(), table, tolerance=1e-1).matters
    with pytest.raises(CalibError):
        check(paper_result(), table, tolerance=-1.0)


def test_what_would_have_been_noticed():
    """In 95 of 100 checks, by checks of points that Pinocchio moves by so much."""
    c = checked()
    joint = next(one for one in c.noticed if one.name == "elbow_joint")
    assert np.isnan(joint.shift)
    assert 5e-4 < joint.turn < 1e-2
    target = next(one for one in c.noticed if one.code == "target")
    assert np.isnan(target.turn)
    assert 1e-4 < target.shift < 3e-3


def test_two_points_do_not_show_a_turn_about_their_line():
    c = check(paper_result(), points(POSES[:2]))
    frame = next(one for one in c.noticed if one.code == "frame")
    assert np.isinf(frame.turn)
    assert np.isfinite(frame.shift)


def test_a_target_that_the_result_lacks_is_refused():
    table = points()
    named = type(table)(
        joint_names=JOINTS, joints=POSES, points=table.points, targets=("a", "b", "a")
    )
    with pytest.raises(ModelError):
        check(paper_result(), named)


def test_names_together_have_their_probability():
    c = checked(zeros=(0.0, 0.0014, 0.0, 0.0, 0.0, 0.0))
    assert isinstance(c.findings[0], Finding)
    if c.outcome == "undecided":
        assert sum(finding.probability for finding in c.named) >= 0.99
        assert sum(finding.probability for finding in c.named[:-1]) < 0.99


def test_rows_that_the_result_was_fitted_to_are_refused():
    table = Measurements.read(paper_measurements(), JOINTS)
    with pytest.raises(MeasurementError, match="1 to 30"):
        check(paper_result(), table)
    fresh = table.select(table.validation)
    assert check(paper_result(), fresh).stops == 5


def test_orientations_of_which_the_result_knows_nothing_are_refused():
    table = points()
    turned = replace(table, kinds=("pose",) * 3, rotations=np.tile(np.eye(3), (3, 1, 1)))
    with pytest.raises(MeasurementError, match="orientations"):
        check(paper_result(), turned)

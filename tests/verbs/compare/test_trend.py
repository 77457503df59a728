"""Joint zeros of one robot over time: planted changes are found, whatever the model, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.basics.dates import MONTH
from calib.basics.json_files import plain
from calib.data.record import BLANK
from calib.errors import ArgumentError, CalibError
from calib.verbs.compare.trend import trend
from tests.verbs.compare.documented import documented_keys, keys
from tests.verbs.compare.visits import Planted, visits

DRIFT = Planted(1, rate=0.3e-3)

JOINTS = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]


def test_a_drift_is_found_on_its_joint_with_its_rate():
    found = trend(visits(DRIFT, 4))
    assert [joint.joint for joint in found.joints] == JOINTS
    assert [joint.joint for joint in found.changed] == ["shoulder_lift_joint"]
    of_joint = found.joints[1]
    assert of_joint.trend is not None
    assert of_joint.trend.shape == "drift"
    # Per month of 30.4 days; from 10 January to 10 April there are 90.
    truth = 0.3e-3 * 3.0 * MONTH / (90.0 * 86_400.0)
    assert abs(of_joint.trend.rate - truth) < 3.0 * of_joint.trend.rate_std
    assert of_joint.trend.rate_std < 0.1 * truth
    planted = 0.3e-3 * np.arange(4)
    assert np.all(np.abs(of_joint.values - planted) < 4.0 * of_joint.stds)
    assert found.months[-1] == pytest.approx(90.0 * 86_400.0 / MONTH)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["dh", "placement", "zeros"])
def test_a_step_is_found_whatever_the_model(model):
    found = trend(visits(Planted(2, step=1.5e-3, at=2), 5, model))
    assert [(joint.joint, joint.trend.shape) for joint in found.changed] == [
        ("elbow_joint", "step")
    ]
    of_joint = found.joints[2].trend
    assert of_joint is not None
    assert of_joint.step_at == 2
    assert of_joint.step == pytest.approx(1.5e-3, abs=4.0 * of_joint.step_std)


@pytest.mark.slow
def test_what_frame_and_target_explain_is_not_seen():
    found = trend(visits(DRIFT, 3, frame=True))
    unseen = [joint.joint for joint in found.joints if joint.trend is None]
    assert unseen == ["shoulder_pan_joint", "wrist_3_joint"]
    assert [joint.joint for joint in found.changed] == ["shoulder_lift_joint"]
    assert np.isnan(found.joints[0].values).all()


def test_results_come_in_any_order_and_dates_may_be_given():
    results = visits(DRIFT, 4)
    in_order = trend(results)
    other = trend([results[k] for k in (2, 0, 3, 1)])
    assert other.dates == in_order.dates
    np.testing.assert_array_equal(other.joints[1].values, in_order.joints[1].values)
    slow = trend(results, ["2020-01-10", "2021-01-10", "2022-01-10", "2023-01-10"])
    rates = [one.joints[1].trend.rate for one in (in_order, slow)]
    assert rates[0] / rates[1] == pytest.approx(12.0, rel=0.05)


def test_a_result_without_a_date_is_refused_unless_dates_are_given():
    results = [
        replace(result, record=BLANK, method=replace(result.method, time=""))
        for result in visits(DRIFT, 4)[:2]
    ]
    with pytest.raises(CalibError, match=r"^1 states no date .* --dates"):
        trend(results)
    assert trend(results, ["2026-01-10", "2026-02-10"]).months[1] > 1.0
    with pytest.raises(CalibError, match=r"'10.01.2026' is no date"):
        trend(results, ["10.01.2026", "2026-02-10"])
    with pytest.raises(CalibError, match="1 dates for 2 results"):
        trend(results, ["2026-01-10"])
    with pytest.raises(CalibError, match="two results or more"):
        trend(results[:1])
    with pytest.raises(ArgumentError, match="'results' must be a list"):
        trend("a.json")


def test_a_tolerance_is_kept_broken_or_undecided():
    results = visits(DRIFT, 4)
    moved = trend(results).comparisons[-1].moves[0]
    assert trend(results, tolerance=moved.moved + 3.0 * moved.std).kept == "pass"
    assert trend(results, tolerance=moved.moved + 0.5 * moved.std).kept == "undecided"
    assert trend(results, tolerance=moved.moved - 3.0 * moved.std).kept == "fail"
    assert trend(results).kept is None
    # 0.9 mrad at the shoulder of an arm of 0.9 m that is mostly bent.
    assert 0.2e-3 < moved.moved < 0.8e-3


def test_its_table_is_that_of_the_document(tmp_path):
    found = trend(visits(DRIFT, 4), tolerance=1e-3)
    table = json.loads(found.write_json(tmp_path / "t.json").read_bytes())
    assert table == plain(found.table())
    assert table["schema"] == "trend 1"
    assert [one["date"] for one in table["results"]][:2] == [
        "2026-01-10T00:00:00Z",
        "2026-02-10T00:00:00Z",
    ]
    assert table["joints"][1]["trend"]["shape"] == "drift"
    _, documented = documented_keys()
    # Of a joint that cannot be seen, trend is null.
    assert keys(table) - {"joints[].trend"} == documented

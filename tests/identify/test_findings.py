"""Parameters with their intervals: values count from where they were given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import calibrate
from calib.measure.cell import Cell


def test_intervals_hold_the_truth_as_often_as_they_say(calibrated):
    scene, c = calibrated("points")
    truth = dict(zip(scene.kinematics.model.names, scene.x, strict=True))
    told = [p for p in c.parameters if p.identifiable and p.name in truth]
    inside = [p.low <= p.nominal + truth[p.name] <= p.high for p in told]
    assert len(told) >= 16
    assert np.mean(inside) > 0.8


def test_values_are_nominal_and_change(case):
    _, c = case
    every = c.parameters if c.larger is None else (*c.parameters, *c.larger.parameters)
    for p in every:
        assert p.low < p.value < p.high
        assert p.std > 0.0
        if p.nominal is not None:
            assert p.value - p.nominal == pytest.approx(p.delta, abs=1e-12)
        assert p.unit in ("m", "rad", "1", "rad/Nm")


def test_each_target_counts_from_where_it_was_given(calibrated):
    scene, c = calibrated("targets")
    given = {"t0": scene.kinematics.T_tip_target[0, :3, 3] + [1e-3, 0.0, 0.0]}
    found = calibrate(
        scene.robot, c.measurements, cell=replace(c.cell, targets=given, model="dh"), validate=False
    )
    for axis in range(3):
        known = found.parameter(f"target_{'xyz'[axis]}[t0]")
        free = found.parameter(f"target_{'xyz'[axis]}[t1]")
        assert known.nominal == given["t0"][axis]
        assert free.nominal is None
        for p, t in ((known, 0), (free, 1)):
            assert p.value == pytest.approx(found.setup.T_tip_target[t, axis, 3], abs=1e-12)


def test_a_turned_target_has_its_interval_and_prior_along_the_tips_axes(make_scene):
    """Value, prior and interval of ``target_x`` are of one axis, the one that the target is given in."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.05, 0.04, 0.16]
    given = T[:3, 3] + [1e-3, 1e-3, 0.0]
    scene = make_scene(
        100, frames=[np.eye(4)], targets=[T], length=0, angle=0, noise=1e-4, noise_angle=1e-4
    )
    cell = Cell(model="zeros", target=given, parameter_priors={"target_x": 1e-7})
    found = calibrate(scene.robot, scene.poses(40), cell=cell, validate=False)
    assert found.parameter("target_x").delta == pytest.approx(0.0, abs=3e-7)
    assert found.parameter("target_x").std == pytest.approx(1e-7, rel=0.01)
    assert abs(found.parameter("target_y").delta) > 5e-4
    assert found.parameter("target_y").std > 1e-5

"""The difference of two results, on calibrations of virtual cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.model.parameter_sets import DIRECTIONS
from calib.verbs.compare.difference import (
    _ROOM,
    _WIDEST,
    Displacement,
    _estimate,
    _own_steps,
    _OwnEffects,
    _same_parameters,
    _shared_precision,
    common_ranges,
    differences_of,
    own_names,
    unknown_frame,
    unknown_places,
)
from tests.parts import with_part


def test_own_parameters_are_those_of_no_frame_and_no_target(calibrated):
    _, c = calibrated("set-ups")
    names = own_names(c)
    assert names == tuple(n for n in c.model.names if not n.startswith(("frame_", "target_")))
    assert len(names) < len(c.model.names)


@pytest.mark.parametrize(
    ("case", "directions"),
    [("points", ()), ("set-ups", DIRECTIONS), ("known set-ups", ()), ("sockets", DIRECTIONS)],
)
def test_the_frame_is_unknown_where_it_was_estimated_or_no_row_determines_it(
    calibrated, case, directions
):
    assert unknown_frame(calibrated(case)[1]) == directions


def test_places_are_unknown_where_either_result_estimated_them(calibrated):
    """The base, then position and orientation of the target, which counts only with orientations."""
    _, points = calibrated("points")
    _, poses = calibrated("poses")
    known = with_part(
        points, "geometry", setup=replace(points.setup, target_unknown=np.zeros(1, dtype=bool))
    )
    base_known, base_unknown = [False] * 6, [True] * 6
    position, both, neither = [True] * 3 + [False] * 3, [True] * 6, [False] * 6
    assert unknown_places((points, points), turns=False) == base_known + position
    assert unknown_places((points, points), turns=True) == base_known + both
    assert unknown_places((known, known), turns=True) == base_known + neither
    for a, b in ((known, poses), (poses, known)):
        assert unknown_places((a, b), turns=True) == base_unknown + both
        assert unknown_places((a, b), turns=False) == base_unknown + position


def test_a_displacement_without_its_noise():
    move = Displacement("joint limits", 5e-4, 9e-4, 3e-4, 1e-4, np.nan)
    assert move.moved == pytest.approx(4e-4)
    assert replace(move, noise=6e-4).moved == 0.0


def test_a_result_does_not_differ_from_itself(calibrated):
    _, c = calibrated("points")
    differences = differences_of(c, c, same_start=True)
    assert differences.test.chi_square == 0.0
    assert [move.rms for move in differences.moves] == [0.0, 0.0]
    assert (differences.only_a, differences.only_b) == ((), ())
    # Of a target that both estimated.
    assert "d6" in differences.compensated


def test_a_change_of_the_last_tool_axis_is_compensated_and_one_of_an_elbow_is_not(calibrated):
    _, c = calibrated("points")
    names = list(c.model.names)

    def changed(name: str, by: float) -> float:
        x = c.geometry.x.copy()
        x[names.index(name)] += by
        parameters = tuple(replace(p, value=p.value + by * (p.name == name)) for p in c.parameters)
        other = with_part(c, "geometry", x=x, parameters=parameters)
        return differences_of(c, other, same_start=True).moves[0].rms

    assert changed("d6", 1e-3) < 2e-5
    assert changed("theta3", 1e-3) > 1e-4


def test_orientations_count_at_the_end_of_a_lever(calibrated):
    """Where they were measured the turn of the target is given too."""
    _, c = calibrated("poses")
    x = c.geometry.x.copy()
    x[c.model.index("theta3")] += 1e-3
    move = differences_of(c, with_part(c, "geometry", x=x), same_start=True).moves[0]
    assert move.rms > 1e-4
    assert 0.0 < move.rms_angle < 2e-3


def test_an_estimate_under_common_priors_is_that_of_a_fit_with_them(calibrated):
    """Its covariance by the information of the data alone, with the wider of the priors added."""
    _, c = calibrated("points")
    prior_std = np.array([p.prior_std for p in c.parameters])
    wider = with_part(
        c,
        "geometry",
        parameters=tuple(replace(p, prior_std=3.0 * p.prior_std) for p in c.parameters),
    )
    found = _estimate(c, wider)
    of_data = np.linalg.inv(c.covariance) - np.diag(np.nan_to_num(prior_std**-2.0))
    own = [name in own_names(c) for name in c.model.names]
    common = np.nan_to_num(prior_std**-2.0)
    common[own] = 1.0 / found.prior
    expected = np.linalg.inv(of_data + np.diag(common))[np.ix_(own, own)]
    std = np.sqrt(np.diag(expected))
    correlation = found.covariance / np.outer(std, std)
    np.testing.assert_allclose(correlation, expected / np.outer(std, std), atol=1e-3)
    # Nine times the variance, or more where that leaves too little room for a drift.
    assert np.all(found.prior >= 0.99 * 9.0 * prior_std[own] ** 2)


@pytest.mark.parametrize(("factor", "steps_wide"), [(1e9, _WIDEST), (1e-9, _ROOM)])
def test_common_priors_are_neither_wider_than_an_arm_errs_nor_too_sharp_for_a_drift(
    calibrated, factor, steps_wide
):
    _, c = calibrated("points")
    parameters = tuple(replace(p, prior_std=factor * p.prior_std) for p in c.parameters)
    other = with_part(c, "geometry", parameters=parameters)
    std = _shared_precision(other, other) ** -0.5
    np.testing.assert_allclose(std, steps_wide * _own_steps(c))


def test_effects_along_a_basis_are_those_of_parameters_that_no_motion_compensates():
    remaining = np.array([[1.0, 3.0], [2.0, 4.0]])
    own = _OwnEffects(
        names=np.array(["a", "b"]),
        steps=np.array([1e-3, 2e-3]),
        remaining=remaining,
        known=np.array([True, False]),
    )
    np.testing.assert_allclose(own.along(np.array([[0.0], [1.0]])), [[2.0, 0.0]])
    np.testing.assert_allclose(own.in_steps, remaining * [1e-3, 2e-3])
    assert own.compensated == ["b"]


def test_ranges_that_only_touch_count_as_apart():
    a = np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 1.0]])
    b = np.array([[1.0, 2.0], [1.0, 3.0], [2.0, 3.0]])
    np.testing.assert_array_equal(common_ranges(a, b), [[0.0, 2.0], [1.0, 2.0], [0.0, 3.0]])


def test_parameters_are_the_same_by_name_ties_and_set(calibrated):
    _, c = calibrated("points")
    assert _same_parameters(c, c)
    fewer = c.model.without([own_names(c)[0]])
    assert not _same_parameters(
        c, with_part(c, "geometry", kinematics=replace(c.geometry.kinematics, model=fewer))
    )
    tied = with_part(c, "method", ties={"alpha2": ("alpha3", 1.0)})
    assert not _same_parameters(c, tied)
    assert _same_parameters(tied, tied)

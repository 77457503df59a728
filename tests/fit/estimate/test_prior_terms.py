"""Priors and bounds of parameters, frames and targets."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Priors
from calib.model.error_model import FRAME, TARGET
from calib.model.families import ZERO
from calib.model.parameter_sets import error_model
from tests.fit.estimate.priors_of import prior_terms


@pytest.fixture(scope="module")
def model(ur3):
    return error_model(ur3, "dh+compliance", frame=True, rotation=True)


def test_each_family_has_a_size_and_frame_and_target_a_weak_hold(virtual, model):
    holds = prior_terms(virtual, model)
    assert holds.names == ("length", "angle", "zero", "compliance")
    assert holds.start == (3e-3, 15e-3, 15e-3, 1e-5)
    placed = model.family(FRAME, TARGET)
    np.testing.assert_array_equal(holds.flat, placed)
    np.testing.assert_array_equal(holds.precision, np.where(placed, 1.0, 0.0))
    np.testing.assert_array_equal(sum(holds.families) + placed, 1)
    assert not np.any(holds.mean)


def test_a_prior_of_its_own_takes_a_parameter_out_of_its_family(virtual, model):
    k, t = model.index("theta2"), model.index("target_x")
    single = {"theta2": 1e-4, "target_x": 2e-4}
    holds = prior_terms(virtual, model, parameter_priors=single)
    assert not holds.families[holds.names.index(ZERO)][k]
    assert holds.precision[[k, t]] == pytest.approx([1e8, 2.5e7])
    assert not holds.flat[t]
    assert holds.mean[t] == pytest.approx(-1e-3)  # where it was said to be, from where it starts
    assert np.flatnonzero(holds.mean).tolist() == [t]


def test_a_parameter_at_its_bound_stays_there(virtual, model):
    k = model.index("d1")
    holds = prior_terms(virtual, model).at_bounds({k: 2e-3})
    assert holds.mean[k] == 2e-3
    assert holds.precision[k] > 1e15
    assert not any(members[k] for members in holds.families)


def test_where_priors_are_off_all_families_have_a_weak_one(virtual, model):
    holds = prior_terms(virtual, model, priors=Priors("off"))
    assert holds.start == (1.0, 1.0, 1.0, 1.0)
    assert holds.source == "off"


@pytest.mark.parametrize("kind", ["fixed", "plane"])
def test_a_stated_target_has_a_prior_if_contacts_alone_see_it(virtual, model, kind):
    names = ["target_x", "target_y", "target_z"]
    lengths = [model.index(name) for name in names]
    angles = [model.index(name) for name in ("target_rx", "target_ry", "target_rz")]
    holds = prior_terms(virtual, model, kind=kind)
    assert holds.precision[lengths] == pytest.approx(1.0 / 2.5e-3**2)
    assert holds.precision[angles] == pytest.approx(1.0)  # no orientation was stated
    assert holds.mean[lengths] == pytest.approx([-1e-3, 0.0, 0.0])
    assert not np.any(holds.flat[lengths])
    known = prior_terms(virtual, model, kind=kind, target_rotation=np.eye(3))
    assert known.precision[angles] == pytest.approx(1.0 / np.deg2rad(1.0) ** 2)
    own = prior_terms(virtual, model, kind=kind, parameter_priors={"target_y": 2e-4})
    assert own.precision[lengths[1]] == pytest.approx(2.5e7)

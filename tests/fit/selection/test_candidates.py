"""Candidates: the ladder of models for one robot, their evidence, and the alternatives to the chosen one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.fit.estimate.fitting import fit
from calib.fit.selection.candidates import (
    CLEARLY,
    LADDER,
    alternative_models,
    assess,
    check_parameter_names,
    determinable_families,
    geometry_parameters,
    held_out_rms,
    is_vanished,
    mark_chosen,
    model_name,
    without_vanished_families,
)
from calib.fit.selection.cross_validation import linear_cross_validation
from calib.model.families import FAMILIES, joint_families
from calib.numerics.errors import Errors
from tests.fit.selection.models import a_candidate, scene_of, task_of


@pytest.fixture(scope="module")
def task_and_rows(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    return task_of(scene, scene.points(20), Cell())


def test_a_model_is_named_by_its_geometry_and_families():
    assert model_name("dh", ()) == "dh"
    assert model_name("dh", ("gain", "gravity")) == "dh+gain+gravity"


def test_geometries_grow_along_the_ladder(task_and_rows):
    task, _ = task_and_rows
    counts = geometry_parameters(task)
    assert tuple(counts) == LADDER
    assert sorted(counts.values()) == list(counts.values())
    assert counts["frames"] == 3  # the target
    assert counts["placement"] == 39


def test_a_geometry_without_parameters_is_not_listed(task_and_rows):
    task, _ = task_and_rows
    known = task.setup.with_fixed(np.ones(1, dtype=bool), np.ones(1, dtype=bool))
    assert "frames" not in geometry_parameters(replace(task, setup=known))


def test_families_that_move_no_joint_are_not_listed(task_and_rows):
    task, rows = task_and_rows
    assert determinable_families(task, rows) == joint_families()
    no_load = np.zeros_like(rows.samples.load)
    unloaded = replace(rows, samples=replace(rows.samples, load=no_load))
    assert "compliance" not in determinable_families(task, unloaded)
    assert "gain" in determinable_families(task, unloaded)


def test_families_of_more_errors_than_the_rows_have_numbers_are_not_listed(task_and_rows):
    """Three points are nine numbers: fewer than the ten masses, more than the six gains."""
    task, rows = task_and_rows
    listed = determinable_families(task, rows.select(np.arange(20) < 3))
    assert "gravity" not in listed
    assert "gain" in listed
    assert "gravity" in determinable_families(task, rows.select(np.arange(20) < 4))


def test_lost_motion_needs_both_sides_and_creep_moves_of_several_lengths(task_and_rows):
    task, rows = task_and_rows
    random = np.random.default_rng(5)

    def listed(moves) -> set[str]:
        moved = replace(rows, samples=replace(rows.samples, moves=moves))
        return {"lost_motion", "creep"}.intersection(determinable_families(task, moved))

    one_length = np.full_like(rows.samples.q, 0.1)
    assert listed(one_length) == set()
    from_both_sides = np.where(random.random(one_length.shape) < 0.5, 0.1, -0.1)
    assert listed(from_both_sides) == {"lost_motion"}
    lengths = random.uniform(0.5, 1.5, one_length.shape)
    assert listed(from_both_sides * lengths) == {"lost_motion", "creep"}
    assert listed(one_length * lengths) == {"creep"}


def test_names_that_no_model_has_are_refused(task_and_rows):
    task, _ = task_and_rows
    cell = Cell(frozen=("a99",), ties={"a2": ("nothing", 1.0)}, parameter_priors={"x": 1.0})
    with pytest.raises(ModelError, match="No model has the parameters 'a99', 'nothing', 'x'"):
        check_parameter_names(replace(task, cell=cell))
    check_parameter_names(replace(task, cell=Cell(frozen=("a2",), bounds={"d1": (-1.0, 1.0)})))


def fitted_with(make_scene, source: str, model: str = "dh+gain"):
    scene = scene_of(make_scene, 115, "dh")
    task, rows = task_of(scene, scene.points(40), Cell(priors=Priors(source)), model)
    return fit(task, rows)


def test_evidence_is_the_likelihood_less_what_the_model_costs(make_scene):
    """2.5 for each estimated prior std, and 1 for each step up the ladder; dh is the third rung."""
    fitted = fitted_with(make_scene, "data")
    estimate = fitted.estimate
    assert len(estimate.prior_std) == 4  # lengths, angles, zeros, gains
    candidate = assess(fitted)
    assert candidate.evidence == pytest.approx(estimate.log_likelihood - 4 * 2.5 - 2.0, rel=1e-12)
    assert (candidate.name, candidate.parameters) == ("dh+gain", len(fitted.kinematics.model))
    given = fitted_with(make_scene, "given")
    assert assess(given).evidence == given.estimate.log_likelihood - 2.0


def test_without_priors_evidence_is_the_fall_of_held_out_errors_in_steps(make_scene):
    fitted = fitted_with(make_scene, "off")
    errors = linear_cross_validation(fitted).errors_without_outliers
    expected = -np.log(errors["m"].rms) / CLEARLY - 2.0 - 1.0
    assert assess(fitted).evidence == pytest.approx(expected, rel=1e-12)


def test_errors_are_angles_where_no_length_was_measured():
    lengths = a_candidate("dh", 0.0, 2e-4).cross_validation
    assert held_out_rms(lengths) == pytest.approx(2e-4)
    angles = Channels.of_unit(np.ones((3, 1), dtype=bool), "rad")
    errors = Errors.of(np.full((3, 1), 5e-3), angles)
    assert held_out_rms(replace(lengths, errors_without_outliers=errors)) == pytest.approx(5e-3)


def test_families_vanish_below_a_hundredth_of_their_prior():
    usual = FAMILIES["gain"].prior
    assert is_vanished("gain", {"gain": 0.9e-2 * usual})
    assert not is_vanished("gain", {"gain": 1.1e-2 * usual})
    assert not is_vanished("gain", {})
    prior_std = {"gain": 1e-3 * usual, "gravity": FAMILIES["gravity"].prior}
    assert without_vanished_families("dh+gain+gravity", prior_std) == "dh+gravity"


def test_alternatives_have_more_evidence_and_smaller_errors_than_the_geometry():
    gone = FAMILIES["gain"].prior * 1e-3
    candidates = mark_chosen(
        [
            a_candidate("dh", 0.0, 2e-4),
            a_candidate("dh+gravity", 9.0, 1e-4),
            a_candidate("dh+gain+gravity", 6.5, 1e-4, {"gain": gone}),  # the same model
            a_candidate("dh+compliance", 5.0, 1e-4),
            a_candidate("placement+eccentricity", 7.0, 1.9e-4),
            a_candidate("dh+eccentricity", 8.0, 2.1e-4),  # worse than the geometry
            a_candidate("zeros+gain", -1.0, 1e-4),  # less likely
            a_candidate("placement", -2.0, 1e-4),
        ],
        "dh",
        "dh+gravity",
    )
    assert {c.name: c.chosen for c in candidates if c.chosen} == {
        "dh": "geometry",
        "dh+gravity": "non_geometric",
    }
    assert alternative_models(candidates) == ("placement+eccentricity", "dh+compliance")
    more = [a_candidate(f"{base}+gravity", 4.0, 1e-4) for base in ("zeros", "hayati", "placement")]
    assert len(alternative_models((*candidates, *more))) == 3

"""Plans for the paper's UR3 against the bars that were set for them, and what they must refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib.example
from calib.data.cell import Cell, Priors
from calib.errors import ModelError
from calib.verbs.plan.choice import Choice, PlanRequest, choose_poses
from calib.verbs.plan.forecast import Forecast, Workspace, covariance_root
from calib.verbs.plan.pose_candidates import Pool, draw, planning_ranges
from calib.verbs.plan.sensitivity import Sensitivity

SIGMA = 1e-4


@pytest.fixture(scope="module")
def paper(ur3) -> Sensitivity:
    """The paper's target and its 23 identifiable parameters, without priors."""
    target = np.array(calib.example.PAPER_TARGET)
    cell = Cell(target=target, model="hayati", priors=Priors(source="off"), sigma={"m": SIGMA})
    return Sensitivity.of(ur3, cell)


@pytest.fixture(scope="module")
def some(ur3) -> Pool:
    """Some hundreds: quick to choose from."""
    return draw(ur3, planning_ranges(ur3, {}, 0.0), [], 700, 0)


@pytest.fixture(scope="module")
def planned(paper, some) -> Choice:
    return choose_poses(paper, some, PlanRequest(20, 5, ladder=False, seed=3))


# The bars


def test_the_papers_poses_predict_with_four_times_the_noise(paper, some, paper_table):
    measured = paper_table.joints[paper_table.estimation]
    assert len(measured) == 30
    f = Forecast.of(paper, Workspace.of(paper, some.workspace), measured)
    assert f.rms / SIGMA == pytest.approx(4.2, abs=0.1)


# What the criteria do


def test_each_criterion_is_the_best_at_its_own(paper, some):
    found = {
        name: choose_poses(paper, some, PlanRequest(16, 0, criterion=name, ladder=False))
        for name in "DAV"
    }
    s = replace(paper, precision=np.full(len(paper.names), 1e4))
    by_prior = {
        name: choose_poses(s, some, PlanRequest(16, 0, criterion=name, ladder=False))
        for name in "DA"
    }
    rms = {name: one.forecast.rms for name, one in found.items()}
    assert min(rms, key=rms.__getitem__) == "V"
    volume = {
        name: 2.0 * np.linalg.slogdet(covariance_root(s.measured(one.planned), s.precision))[1]
        for name, one in by_prior.items()
    }
    assert volume["D"] < volume["A"]
    # All parameters of this model have a step of 1 mm or 1 mrad.
    total = {name: np.sum(one.forecast.parameter_std**2) for name, one in by_prior.items()}
    assert total["A"] < total["D"]


# Poses taken already


def test_poses_taken_lower_what_is_planned(paper, some, planned):
    taken = planned.planned[:10]
    c = choose_poses(paper, some, PlanRequest(10, 0, ladder=False), taken=taken)
    alone = choose_poses(paper, some, PlanRequest(10, 0, ladder=False))
    assert c.before is not None
    assert (c.before.poses, c.forecast.poses, c.at_random.poses) == (10, 20, 20)
    assert c.forecast.rms < alone.forecast.rms < c.before.rms
    assert c.forecast.rms < c.at_random.rms
    # As good, all but a hair, as a plan of all of them made at once.
    assert c.forecast.rms < 1.05 * planned.forecast.rms


@pytest.mark.parametrize("criterion", ["V"])
def test_poses_taken_are_not_planned_again(paper, some, criterion):
    few = some._replace(q=some.q[:60])
    taken = choose_poses(paper, few, PlanRequest(30, 0, criterion=criterion, ladder=False)).planned
    # A controller's values are not quite those that it was told.
    taken = taken + np.radians(0.01)
    # Nor the same turn: it is the same pose after one more.
    taken[::2, 5] += 2.0 * np.pi
    c = choose_poses(
        paper, few, PlanRequest(20, 10, criterion=criterion, ladder=False), taken=taken
    )
    both = np.concatenate([c.planned, c.validation])
    turns = both[:, None] - taken[None]
    gap = np.abs(np.arctan2(np.sin(turns), np.cos(turns))).max(axis=2)
    assert gap.min() > np.radians(1.0)
    assert len(np.unique(both, axis=0)) == 30


# Refusals


@pytest.mark.parametrize(
    ("request_", "candidates"),
    [
        (PlanRequest(0), 100),
        (PlanRequest(validation=-1), 100),
        (PlanRequest(30, 5), 34),
        (PlanRequest(5000), 20_000),
        (PlanRequest(criterion="E"), 100),
    ],
)
def test_what_cannot_be_asked_is_refused(request_, candidates):
    with pytest.raises(ModelError):
        request_.check(candidates)


def test_fewer_poses_than_parameters_need_are_refused(paper, some):
    with pytest.raises(ModelError, match=r"7 poses give 21 numbers.* 23 identifiable .* least 8"):
        choose_poses(paper, some, PlanRequest(7, 0))
    assert choose_poses(paper, some, PlanRequest(8, 0, ladder=False)).forecast.rank == 23

"""What poses can tell, before anything is fitted: of each kind of measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.verbs.inspect.inspection import inspect
from calib.verbs.simulate.disturbances import FrameStep, StandingTargets
from calib.verbs.simulate.scenario import Scenario, simulate
from tests import images
from tests.fits import place


@pytest.mark.parametrize(
    ("cell", "rank", "columns"),
    [
        (Cell(), 21, 27),
        (Cell(kind="pose"), 24, 30),
        (Cell(kind="distance"), 22, 30),
        (Cell(estimate_frame=True), 25, 33),
        (Cell(model="zeros"), 8, 9),
    ],
)
def test_the_rank_over_the_joint_limits(ur3, cell, rank, columns):
    found = inspect(ur3, cell).observability
    assert (found.rank, found.columns) == (rank, columns)


def test_both_hands_are_seen_without_a_table():
    cell = Cell(tips={"left": "arm_left_7_link", "right": "arm_right_7_link"}, estimate_frame=True)
    found = inspect("tiago_dual", cell).observability
    # They share the lift alone: 4 for each joint that turns, 2 for it, 3 for each target.
    one = inspect("tiago_dual", Cell(tip="arm_left_7_link", estimate_frame=True, model="placement"))
    shared = 2  # the direction of the lift
    assert found.rank == 2 * one.observability.rank - shared


def test_poses_of_a_table_say_what_the_fit_to_them_says(case):
    """The rank at the nominal robot is that at the solution, for every kind."""
    _, c = case
    cell = Cell(
        **{
            name: getattr(c.fit.cell, name)
            for name in ("estimate_frame", "frames", "distances", "payload", "gravity", "held")
        },
        model=c.model.name,
    )
    found = inspect(c.nominal, cell, c.fit.measurements).observability
    assert (found.rank, found.columns) == (
        c.trust.observability.rank,
        c.trust.observability.columns,
    )


def test_a_known_distance_tells_the_scale(calibrated):
    _, c = calibrated("sockets")
    with_it = inspect(c.nominal, c.fit.cell, c.fit.measurements).observability
    without = inspect(c.nominal, Cell(), c.fit.measurements).observability
    assert with_it.rank == without.rank + 1
    assert any("a2" in u.names for u in without.unidentifiable)
    assert not any("a2" in u.names for u in with_it.unidentifiable)


def test_what_was_assumed(ur3, table):
    found = inspect(ur3, Cell())
    assert (found.poses, found.source, found.assumed) == (200, None, ("target",))
    assert inspect(ur3, Cell(target=np.array([0.0, 0.0, 0.1]))).assumed == ()
    assert inspect(ur3, Cell(kind="distance")).assumed == ("target", "anchor")
    known = Cell(kind="distance", T_frame_base=read_only(place([-0.5, 0.2, -0.3])))
    assert inspect(ur3, known).assumed == ("target",)
    # An instrument that measures positions has its frame anywhere.
    assert inspect(ur3, Cell(estimate_frame=True)).assumed == ("target",)
    assert (inspect(ur3, Cell(), table).poses, inspect(ur3, Cell(), table).assumed) == (30, ())


def test_of_images_single_corners_are_left_out():
    """All is told but two zeros, where joints and mounts meet."""
    found = inspect(images.arm(), images.cell(model="zeros"), images.table(images.poses(12)))
    names = found.model.names
    assert not any(name.startswith("corner_") for name in names)
    assert {"fx", "k3", "board_scale_x", "board_sag_y"} < set(names)
    # The first zero is the camera's mount, the last one the board's place.
    assert found.observability.rank == len(names) - 2


def test_references_of_a_table(ur3):
    scenario = Scenario(
        ur3, step=FrameStep(12, np.array([0.0, 5e-4, 0.0])), standing=StandingTargets(3, 5)
    )
    measured = simulate(scenario, 20, 0, seed=1).measurements
    drift = inspect(ur3, Cell(), measured).drift
    assert [one.readings for one in drift.targets] == [5, 5, 5]
    (step,) = drift.found
    np.testing.assert_allclose(step.by, [0.0, 5e-4, 0.0], atol=1e-4)
    # Rows of poses are 1 to 20; the readings before row 11 and row 16 have the numbers 29 and 30.
    assert (step.after_row, step.before_row) == (29, 30)
    assert inspect(ur3, Cell(), replace(measured, references=None)).drift is None

"""Mistakes of single pictures, found without a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.picture_mistakes import (
    Finding,
    _early_values,
    _not_yet_arrived,
    _old_values,
    mistakes_of_pictures,
)
from calib.diagnosis.reasons import Why
from calib.verbs.simulate.scenario import VirtualCell
from tests.pictures import (
    BOARD,
    STATED,
    joined,
    joints_of,
    named,
    of_pictures,
    pictures_of,
    with_joints,
)

COUNT = 20
CELL = Cell(cameras={"": STATED}, boards={"": BOARD})


@pytest.fixture(scope="module")
def seen() -> tuple[VirtualCell, Measurements]:
    """Return a virtual cell and its pictures, in the order of their names."""
    return pictures_of(BOARD, seed=5, count=COUNT)


def found(cell: VirtualCell, table: Measurements) -> tuple[Finding, ...]:
    """Return what is found in a table."""
    return mistakes_of_pictures(cell.truth.nominal, CELL, table)


def test_nothing_is_found_in_a_correct_table(seen: tuple[VirtualCell, Measurements]) -> None:
    """Errors of an uncalibrated arm are no mistakes."""
    assert found(*seen) == ()


def test_turned_pictures(seen: tuple[VirtualCell, Measurements]) -> None:
    """Two pictures were turned by half a turn."""
    cell, table = seen
    turned = np.isin(table.images, ["3", "11"])
    readings = {
        "u": np.where(turned, 1279.0 - table.readings["u"], table.readings["u"]),
        "v": np.where(turned, 719.0 - table.readings["v"], table.readings["v"]),
    }
    (finding,) = found(cell, replace(table, readings=readings))
    assert finding.reason.why is Why.PICTURES_TURNED
    assert finding.reason.values["named"] == ["3", "11"]
    assert set(finding.rows) == set(np.array(table.rows)[turned].tolist())


def test_exchanged_pictures(seen: tuple[VirtualCell, Measurements]) -> None:
    """Two pictures have each other's joint values."""
    cell, table = seen
    order = np.arange(COUNT)
    order[[2, 15]] = 15, 2
    (finding,) = found(cell, with_joints(table, joints_of(table)[order]))
    assert finding.reason.why is Why.PICTURES_EXCHANGED
    assert finding.reason.values["named"] == ["2", "15"]


@pytest.mark.slow
@pytest.mark.parametrize("first", [6, 12])
def test_shifted_pictures(seen: tuple[VirtualCell, Measurements], first: int) -> None:
    """From some picture on each has the joint values of the one before, whichever part is larger."""
    cell, table = seen
    order = np.arange(COUNT)
    order[first:] -= 1
    (finding,) = found(cell, with_joints(table, joints_of(table)[order]))
    assert finding.reason.why is Why.ROWS_MOVED
    assert finding.rows == ()
    assert finding.reason.values["up"] is True
    # A picture next to the place may agree by chance, or not at all.
    place = of_pictures(table)[table.rows.index(finding.reason.values["row"])]
    assert abs(int(place) - first) <= 1


@pytest.mark.parametrize(("first", "whys"), [(2, [Why.ROWS_MOVED]), (3, [])])
def test_three_quarters_of_the_pictures_tell_that_they_are_shifted(
    seen: tuple[VirtualCell, Measurements], first: int, whys: list[Why]
) -> None:
    """Of nine that have a next one, those from some picture on have their joint values in its rows.

    Those before have the joint values of other poses. The camera and the board are where they were given.
    """
    cell, table = seen
    T_tip_board = cell.truth.T_tip_target[0]
    placed = replace(
        CELL,
        T_frame_base=cell.truth.T_frame_base[0],
        target=T_tip_board[:3, 3],
        target_rotation=T_tip_board[:3, :3],
        estimate_target=False,
    )
    order = np.arange(COUNT) - 1
    order[: first + 1] = np.arange(first + 1)[::-1] + 10
    ten = with_joints(table, joints_of(table)[order]).select(of_pictures(table) < 10)
    findings = mistakes_of_pictures(cell.truth.nominal, placed, ten)
    assert [finding.reason.why for finding in findings] == whys
    for finding in findings:
        values = finding.reason.values
        place = of_pictures(ten)[ten.rows.index(values["row"])]
        assert (place, values["up"], finding.rows) == (first, True, ())
        assert values["error_m"] < 0.01 < 0.3 < values["given_m"]


@pytest.mark.slow
def test_all_pictures_shifted(seen: tuple[VirtualCell, Measurements]) -> None:
    """Each picture has the joint values of the next one."""
    cell, table = seen
    order = np.minimum(np.arange(COUNT) + 1, COUNT - 1)
    (finding,) = found(cell, with_joints(table, joints_of(table)[order]))
    assert finding.reason.why in (Why.ROWS_SHIFTED, Why.ROWS_MOVED)


def test_joint_values_of_another_time_are_led_back():
    """Read on the way from the row before, on the way to the next one, or commanded where the joints fell short."""
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (6, 2))
    move = np.diff(q, axis=0, prepend=q[:1])
    next_move = np.diff(q, axis=0, append=q[-1:])
    np.testing.assert_allclose(_old_values(q - 0.2 * move, 0.2), q, atol=1e-14)
    np.testing.assert_allclose(_early_values(q + 0.2 * next_move, 0.2), q, atol=1e-14)
    np.testing.assert_allclose(_not_yet_arrived(q, 0.2), q - 0.2 * move, atol=1e-14)


@pytest.mark.slow
def test_late_joint_values(seen: tuple[VirtualCell, Measurements]) -> None:
    """The joint values lack 15 % of each move."""
    cell, table = seen
    q = joints_of(table)
    late = q - 0.15 * np.diff(q, axis=0, prepend=q[:1])
    (finding,) = found(cell, with_joints(table, late))
    assert finding.reason.why is Why.JOINTS_LATE
    assert finding.reason.values["of_step"] == pytest.approx(0.15, abs=0.01)


def moved_camera(cell: VirtualCell) -> VirtualCell:
    """Return the cell with its camera 10 cm and 5 deg away."""
    bump = np.eye(4)
    bump[:3, :3] = Rotation.from_rotvec([0.0, np.radians(5.0), 0.0]).as_matrix()
    bump[:3, 3] = 0.0, 0.1, 0.0
    truth = replace(cell.truth, T_frame_base=read_only(bump @ cell.truth.T_frame_base))
    return replace(cell, truth=truth)


def refocused_camera(cell: VirtualCell) -> VirtualCell:
    """Return the cell with focal lengths that are larger by a tenth."""
    assert cell.equipment is not None
    assert cell.equipment.camera.values is not None
    values = cell.equipment.camera.values * np.where(np.arange(9) < 2, 1.1, 1.0)
    camera = replace(cell.equipment.camera, values=read_only(values))
    return replace(cell, equipment=replace(cell.equipment, cameras=(camera,)))


def changed(table: Measurements, other: VirtualCell, first: int, last: int = COUNT) -> Measurements:
    """Return the pictures before ``last``, those from ``first`` on of another cell."""
    after = named(other.measure(other.poses(COUNT, 5), 5).measurements)
    is_later = (of_pictures(after) >= first) & (of_pictures(after) < last)
    return joined(table.select(of_pictures(table) < first), after.select(is_later))


@pytest.mark.slow
def test_a_camera_that_was_moved(seen: tuple[VirtualCell, Measurements]) -> None:
    """From picture 13 on it stands elsewhere: these are fewer."""
    cell, table = seen
    both = changed(table, moved_camera(cell), 13)
    (finding,) = found(cell, both)
    assert finding.reason.why is Why.CAMERA_MOVED
    assert finding.reason.values["first"] == "13"
    assert finding.reason.values["moved_rad"] == pytest.approx(np.radians(5.0), rel=0.1)
    # Pictures of fewer than four corners determine no pose.
    later = np.flatnonzero(of_pictures(both) >= 13) + 1
    assert set(finding.rows) <= set(later)
    assert len(finding.rows) > 0.9 * len(later)


def test_a_camera_that_was_refocused(seen: tuple[VirtualCell, Measurements]) -> None:
    """The last three of twelve pictures; another place of the camera would explain them, too."""
    cell, table = seen
    (finding,) = found(cell, changed(table, refocused_camera(cell), 9, 12))
    assert finding.reason.why is Why.CAMERA_REFOCUSED
    assert finding.reason.values["first"] == "9"
    assert finding.reason.values["share"] == pytest.approx(0.1, abs=0.04)


@pytest.mark.parametrize(("last", "whys"), [(11, []), (12, [Why.CAMERA_MOVED])])
def test_two_pictures_do_not_tell_that_the_camera_was_moved_and_three_do(
    seen: tuple[VirtualCell, Measurements], last: int, whys: list[Why]
) -> None:
    cell, table = seen
    findings = found(cell, changed(table, moved_camera(cell), 9, last))
    assert [finding.reason.why for finding in findings] == whys
    assert all(f.reason.values["named"] == ["9", "10", "11"] for f in findings)

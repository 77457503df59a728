"""A camera that was moved or refocused by little, found by a quick fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.camera_changes import changes_between_pictures
from calib.diagnosis.reasons import Why
from calib.verbs.simulate.scenario import VirtualCell
from tests.pictures import BOARD, STATED, joined, named, of_pictures, pictures_of

COUNT, FIRST = 24, 15
CELL = Cell(cameras={"": STATED}, boards={"": BOARD})


@pytest.fixture(scope="module")
def seen() -> tuple[VirtualCell, Measurements]:
    """Return a virtual cell and its pictures, in the order of their names."""
    return pictures_of(BOARD, seed=7, count=COUNT)


def changed(table: Measurements, other: VirtualCell) -> Measurements:
    """Return a table whose last pictures, from `FIRST` on, are of another cell."""
    after = named(other.measure(other.poses(COUNT, 7), 7).measurements)
    return joined(
        table.select(of_pictures(table) < FIRST), after.select(of_pictures(after) >= FIRST)
    )


def test_nothing_is_found_in_a_correct_table(seen: tuple[VirtualCell, Measurements]) -> None:
    """Noise and an arm's errors are no change."""
    cell, table = seen
    assert changes_between_pictures(cell.truth.nominal, CELL, table) == ()


def moved_camera(cell: VirtualCell) -> VirtualCell:
    """Return the cell with its camera 4 mm aside, and turned by 10 mrad about itself."""
    bump = np.eye(4)
    bump[:3, :3] = Rotation.from_rotvec([0.01, 0.0, 0.0]).as_matrix()
    bump[0, 3] = 4e-3
    truth = replace(cell.truth, T_frame_base=read_only(bump @ cell.truth.T_frame_base))
    return replace(cell, truth=truth)


def test_a_camera_that_was_moved_by_millimetres(seen: tuple[VirtualCell, Measurements]) -> None:
    """From some picture on: the later ones are fewer, and are left out."""
    cell, table = seen
    both = changed(table, moved_camera(cell))
    (finding,) = changes_between_pictures(cell.truth.nominal, CELL, both)
    assert finding.reason.why is Why.CAMERA_MOVED
    assert finding.reason.values["first"] == str(FIRST)
    assert finding.reason.values["moved_m"] == pytest.approx(4e-3, rel=0.1)
    assert finding.reason.values["moved_rad"] == pytest.approx(0.01, rel=0.1)
    assert set(finding.rows) == set(np.flatnonzero(of_pictures(both) >= FIRST) + 1)


def test_of_two_cameras_the_one_that_was_moved_is_named(
    seen: tuple[VirtualCell, Measurements],
) -> None:
    """The other one took half as many pictures, and its rows come first."""
    cell, table = seen
    left, right = table.select(of_pictures(table) < 12), changed(table, moved_camera(cell))
    both = joined(
        *(
            replace(
                part,
                images=tuple(f"{name} {image}" for image in part.images),
                groups=(name,) * len(part),
            )
            for part, name in ((left, "left"), (right, "right"))
        )
    )
    (finding,) = changes_between_pictures(cell.truth.nominal, CELL, both)
    values = finding.reason.values
    assert (finding.reason.why, values["camera"]) == (Why.CAMERA_MOVED, "right")
    assert (values["first"], values["off"], values["of"]) == (
        f"right {FIRST}",
        COUNT - FIRST,
        COUNT,
    )
    assert values["moved_m"] == pytest.approx(4e-3, rel=0.3)
    later = of_pictures(both) >= 12 + FIRST
    assert finding.rows == tuple(np.array(both.rows)[later].tolist())


def test_a_camera_that_was_refocused(seen: tuple[VirtualCell, Measurements]) -> None:
    """Its focal lengths are 1 % larger from some picture on."""
    cell, table = seen
    assert cell.equipment is not None
    assert cell.equipment.camera.values is not None
    values = cell.equipment.camera.values * np.where(np.arange(9) < 2, 1.01, 1.0)
    camera = replace(cell.equipment.camera, values=read_only(values))
    both = changed(table, replace(cell, equipment=replace(cell.equipment, cameras=(camera,))))
    (finding,) = changes_between_pictures(cell.truth.nominal, CELL, both)
    assert finding.reason.why is Why.CAMERA_REFOCUSED
    assert finding.reason.values["share"] == pytest.approx(0.01, rel=0.3)
    assert finding.reason.values["first"] == str(FIRST)


@pytest.mark.slow
def test_pictures_that_no_cause_explains_end_the_search(
    seen: tuple[VirtualCell, Measurements],
) -> None:
    """Each picture has the joint values of some other: the noise is of hundreds of pixels."""
    cell, table = seen
    pictures = of_pictures(table)
    first = np.array([int(np.argmax(pictures == k)) for k in range(COUNT)])
    order = np.random.default_rng(3).permutation(COUNT)
    mixed = replace(table, joints=table.joints[first[order]][pictures], moves=None)
    (finding,) = changes_between_pictures(cell.truth.nominal, CELL, mixed)
    assert finding.reason.why is Why.NOISE_ABSURD
    assert finding.rows == ()

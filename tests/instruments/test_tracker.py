"""Trackers: edges of range and cone to a hair, noise by distance, and readings and derivatives of their kinds."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from calib.data.cell import Cell, Reflector, Tracker, TrackerNoise
from calib.errors import ModelError
from calib.instruments.instrument import Sightline
from calib.instruments.tracker import USUAL_NOISE, TrackerInstrument, noise_of_lengths
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.instruments.scenes import pose

#: An arm that turns about z, with its tip 1.5 m out.
TURNTABLE = """<robot name="t"><link name="base"/><link name="arm"/><link name="tip"/>
  <joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>
  <joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="1.5 0 0"/></joint></robot>"""


@cache
def turntable() -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(TURNTABLE.encode(), "t.urdf"), "base", "tip")


def seen(cell: Cell, q, T_tip_target=None) -> dict[str, list[bool]]:
    """Which poses pass, by the reason of refusal."""
    instrument = TrackerInstrument.of(cell)
    T_tip_target = np.eye(4) if T_tip_target is None else T_tip_target
    sightline = Sightline(turntable(), instrument.T_instrument_base, T_tip_target)
    conditions = instrument.sees([sightline])
    return {condition.reason: condition.passes(q).tolist() for condition in conditions}


@pytest.mark.parametrize(
    ("nearest", "farthest", "passes"),
    [(1.0, 2.0, True), (1.0 + 1e-6, 2.0, False), (0.5, 1.0, True), (0.5, 1.0 - 1e-6, False)],
)
def test_the_range(nearest, farthest, passes):
    cell = Cell(tracker=Tracker((2.5, 0, 0), nearest, farthest))
    assert seen(cell, np.zeros((1, 1))) == {"tracker_range": [passes]}


@given(q=st.floats(-3.1, 3.1), half=st.floats(0.05, 3.1), turn=st.floats(-3.0, 3.0))
@settings(deadline=None)
def test_the_cone_in_closed_form(q, half, turn):
    # The target in the base is at (1.5 cos q, 1.5 sin q), the normal along the arm, however the target is turned.
    point, normal = 1.5 * np.array([np.cos(q), np.sin(q)]), np.array([np.cos(q), np.sin(q)])
    way = np.array([3.0, 1.0]) - point
    angle = np.arccos(np.clip(way @ normal / np.linalg.norm(way), -1.0, 1.0))
    assume(abs(angle - half) > 1e-6)
    cell = Cell(tracker=Tracker((3.0, 1.0, 0.0)), reflector=Reflector((1, 0, 0), half))
    T_tip_target = pose((0.0, 0.0, 0.0), (0.3, turn, -0.2))
    found = seen(cell, np.array([[q]]), T_tip_target)
    assert found == {"tracker_range": [True], "reflector_cone": [bool(angle <= half)]}


def test_an_instrument_whose_place_is_not_known_sees_everything():
    instrument = TrackerInstrument.of(Cell(reflector=Reflector((1, 0, 0))))
    assert instrument.T_instrument_base is None
    assert list(instrument.sees([])) == []


def test_a_tracker_has_no_viewpoints():
    """Random joint values do: it is not brought before the target, as a camera is."""
    instrument = TrackerInstrument.of(Cell())
    numbers = instrument.VIEWPOINT_NUMBERS
    assert numbers == 0
    assert instrument.viewpoints(np.zeros((5, numbers))).shape == (0, 4, 4)


def test_the_noise_is_the_cells_or_the_trackers_or_a_usual_one():
    noise = TrackerNoise(10e-6, 50e-6, 1e-6)
    tracker = Tracker((2.5, 0, 0), noise=noise)
    assert noise_of_lengths(Cell()) is USUAL_NOISE
    assert noise_of_lengths(Cell(tracker=tracker)) is noise
    of_cell = noise_of_lengths(Cell(tracker=tracker, sigma={"m": 3e-5}))
    assert of_cell == TrackerNoise(3e-5, 0.0, 0.0)
    stated = TrackerInstrument.of(Cell(tracker=tracker, sigma={"m": 3e-5}))
    assert stated.noise(np.array([1.0, 5.0])).tolist() == [3e-5, 3e-5]
    found = TrackerInstrument.of(Cell(tracker=tracker)).noise(np.array([1.0, 2.0]))
    assert found == pytest.approx(np.hypot([60e-6, 110e-6], 1e-6))


def test_it_reads_what_its_kind_measures():
    T = np.stack([pose((1.0, 2.0, 2.0), (0.1, 0.2, 0.3)), pose((3.0, 0.0, 4.0))])
    lengths = TrackerInstrument.of(Cell(kind="distance", T_frame_base=np.eye(4))).predict(T)
    assert lengths.ravel() == pytest.approx([3.0, 5.0])
    poses = TrackerInstrument.of(Cell(kind="pose"))
    np.testing.assert_allclose(poses.predict(T)[:, :3], T[:, :3, 3])
    np.testing.assert_allclose(poses.predict(T)[:, 3:].reshape(-1, 3, 3), T[:, :3, :3])
    assert poses.assumed == (("orientation_noise", (1e-3,)),)
    assert TrackerInstrument.of(Cell(kind="pose", sigma={"rad": 1e-4})).assumed == ()
    assert not TrackerInstrument.of(Cell(kind="distance", T_frame_base=np.eye(4))).locates


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        (Cell(kind="fixed"), "'point', 'pose', 'distance'"),
        (Cell(kind="pair"), "'point', 'pose', 'distance'"),
        (Cell(kind="distance"), "frame_xyz_mm"),
        (Cell(frames={"A": np.eye(4), "B": np.eye(4)}), "at one station"),
        (Cell(kind="pixel"), "planned as images"),
    ],
)
def test_cells_whose_poses_cannot_be_chosen_are_refused(cell, words):
    with pytest.raises(ModelError, match=words):
        TrackerInstrument.of(cell)

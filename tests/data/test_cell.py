"""A cell: its defaults, and the values that it refuses."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest

from calib.basics.units import Angle, Length
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.priors import Priors
from calib.data.record import Record
from calib.data.stated_uncertainty import StatedUncertainty
from calib.data.surroundings import (
    Box,
    FurtherRobot,
    GroupDistance,
    Reflector,
    Tracker,
    TrackerNoise,
)
from calib.errors import CalibError, MeasurementError
from calib.result.calibration_file import cell_table
from calib.robot.gravity import Payload


def test_the_defaults():
    cell = Cell()
    assert cell.estimate_target
    assert not cell.estimate_frame
    assert cell.model == "auto"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"T_frame_base": -np.eye(4)}, "A cell's T_frame_base is [["),
        ({"sigma": 1e-4}, "A cell's sigma is 0.0001; it must be standard deviations from 1e-15"),
        ({"sigma": {"m": 0.0}}, "A cell's sigma is {'m': 0.0}; it must be standard deviations"),
        ({"sigma": {"mm": 0.1}}, "units are 'm', 'rad'"),
        ({"target_rotation": np.ones((3, 3))}, "A cell's target_rotation is"),
        ({"frame_directions": ("x", "x")}, "A cell's frame_directions is"),
        ({"repeats": "often"}, "A cell's repeats is 'often'"),
        ({"gravity": [0, 0]}, "The gravity is [0.0, 0.0]"),
        ({"targets": {"a": [1, 2]}}, "The target is [1.0, 2.0]"),
        ({"frames": {"a": np.eye(3)}}, "'a' in a cell's frames is"),
        ({"bounds": {"a1": (1e-3, 2e-3)}}, "'a1' in a cell's bounds is (0.001, 0.002)"),
        ({"held": {"j": float("inf")}}, "'j' in a cell's held is inf"),
        ({"coupling": {"j": 1.0}}, "'j' in a cell's coupling is 1.0; it must be factors of other"),
        ({"coupling": {"j": {}}}, "'j' in a cell's coupling is {}"),
        ({"coupling": {"j": {"k": 0.0}}}, "'j' in a cell's coupling is {'k': 0.0}"),
        ({"coupling": {"j": {"k": "1"}}}, "'j' in a cell's coupling is {'k': '1'}"),
        ({"coupling": {"j": {3: 1.0}}}, "'j' in a cell's coupling is {3: 1.0}"),
        ({"ties": {"a1": ("a2", 0)}}, "'a1' in a cell's ties is ('a2', 0)"),
        ({"ties": {"a1": ("a2", 1)}, "frozen": ("a1",)}, "'a1' is tied to 'a2'"),
        ({"estimate_target": False}, "The target is marked as known, but its position"),
    ],
)
def test_values_that_are_refused(arguments, says):
    with pytest.raises(CalibError, match=re.escape(says)):
        Cell(**arguments)


def test_a_kind_is_registered():
    with pytest.raises(MeasurementError, match="no kind of measurement 'ball'"):
        Cell(kind="ball")


def test_values_are_read_only_and_reach_another_process():
    cell = Cell(frames={"a": np.eye(4)}, ties={"a1": ("a2", 2)}, frame_directions=("rz", "x"))
    with pytest.raises(TypeError):
        cell.frames["b"] = np.eye(4)
    with pytest.raises(ValueError, match="read-only"):
        cell.frames["a"][0, 0] = 2
    assert cell.frame_directions == ("x", "rz")
    assert cell.ties == {"a1": ("a2", 2.0)}
    assert repr(pickle.loads(pickle.dumps(cell))) == repr(cell)


def test_another_target():
    cell = Cell(sigma={"m": 1e-4}).with_target([1, 2, 3], estimate=False)
    np.testing.assert_array_equal(cell.target, [1, 2, 3])
    assert (cell.sigma, cell.estimate_target) == ({"m": 1e-4}, False)


def test_a_cell_in_one_line():
    assert repr(Cell()) == "Cell(model 'auto')"
    cell = Cell(model="dh", target=(0.1, 0.0, 0.0), held={"a": 0.1})
    assert repr(cell) == "Cell(model 'dh', given: target, held)"


@pytest.mark.parametrize(
    ("text", "sigma"),
    [
        ("", 1e-2),
        ('instrument = "tracker"', 2e-5),
        ('instrument = "stereo"', 5e-4),
        ('instrument = "motion_capture"', 5e-4),
        ('instrument = "print"', 3e-3),
        ("scale_certified = true", 0.0),
        ("sigma_scale_percent = 0.05", 5e-4),
        ("scale_certified = true\nsigma_scale_percent = 0.01", 1e-4),
        ("sigma_scale_percent = 0.0", 0.0),
    ],
)
def test_a_cell_file_says_how_well_the_scale_is_known(tmp_path, text, sigma):
    path = tmp_path / "cell.toml"
    path.write_text(text)
    assert Cell.read(path).scale_sigma == pytest.approx(sigma, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('instrument = "laser"', "'instrument' is 'laser'"),
        ("sigma_scale_percent = -1.0", "'sigma_scale_percent' is -1.0; .* 0 or more"),
        ("sigma_scale_percent = nan", "'sigma_scale_percent' is nan"),
    ],
)
def test_a_scale_that_is_refused_is_named_as_it_was_written(tmp_path, text, says):
    path = tmp_path / "cell.toml"
    path.write_text(text)
    with pytest.raises(CalibError, match=says):
        Cell.read(path)


def test_a_frame_is_stated_as_aligned(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text("frame_aligned = true")
    assert Cell.read(path).frame_aligned


def test_a_cell_is_written_as_the_file_that_it_is_read_from(tmp_path):
    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T[:3, 3] = [0.1, -0.2, 0.3]
    cell = Cell(
        base="world",
        bases={"station 1": "rail"},
        tips={"T.1": "tool0"},
        robots={"right": FurtherRobot("ur3", T, estimated=False)},
        target=np.array([0.07, -0.07, 0.0225]),
        target_rotation=T[:3, :3],
        targets={"A": np.array([0.1, 0.2, 0.3])},
        estimate_frame=True,
        frame_directions=("x", "rz"),
        T_frame_base=T,
        frames={'of "left"': T},
        kind="point",
        sigma={"m": 1e-5, "px": 0.2},
        instrument="tracker",
        stated_scale_sigma=1e-4,
        repeats="average",
        frozen=("a2",),
        ties={"a3": ("a2", -1.0)},
        bounds={"d2": (-1e-3, 2e-3), "elbow.zero": (-0.1, 0.1), "elbow.gain": (-0.01, 0.01)},
        priors=Priors("given", length=1e-3, compliance=2e-6),
        parameter_priors={"d2": 1e-3, "elbow.compliance": 1e-6},
        payload=Payload(5.0),
        gravity=np.array([0.0, 9.81, 0.0]),
        held={"lift": 0.3, "waist": 0.5},
        coupling={"j3": {"j2": 1.0}},
        references={"R": "world"},
        distances=(GroupDistance("a/*", "b/*", 0.2, 1e-5),),
        tracker=Tracker(np.array([2.5, 0.0, 0.5]), noise=TrackerNoise(1e-5, 5e-6)),
        reflector=Reflector(np.array([0.0, 0.0, 1.0])),
        boxes=tuple(Box(name, np.array([1.0, 1.0, 0.1]), T) for name in ("floor", "wall")),
        ranges={"lift": (0.0, 0.4), "elbow": (-1.0, 1.0)},
        cameras={"left": Camera(width=1280, height=720)},
        boards={"": Board(pattern="chessboard", columns=9, rows=6, square=0.025)},
        record=Record(robot_serial="12\x7f3", temperature_C=(21.5, 23.0)),
        uncertainty=StatedUncertainty(instrument_limit=1e-5, instrument_limit_per_length=1e-6),
    )
    path = tmp_path / "cell.toml"
    path.write_text(cell.to_toml({"lift"}), encoding="utf-8")
    again = Cell.read(path)
    assert isinstance(again.held["lift"], Length)
    assert isinstance(again.ranges["elbow"][0], Angle)
    assert cell_table(again).keys() == cell_table(cell).keys()
    for name, value in cell_table(cell).items():
        _assert_close(cell_table(again)[name], value)


def _assert_close(value, wanted):
    """Assert that entries of JSON are equal, numbers to 15 digits."""
    if isinstance(wanted, dict):
        assert value.keys() == wanted.keys()
        for name in wanted:
            _assert_close(value[name], wanted[name])
    elif isinstance(wanted, list):
        assert len(value) == len(wanted)
        for one, other in zip(value, wanted, strict=True):
            _assert_close(one, other)
    elif isinstance(wanted, float):
        assert value == pytest.approx(wanted, rel=1e-14, abs=1e-14)
    else:
        assert value == wanted


def test_the_default_cell_has_nothing_to_be_written():
    assert Cell().to_toml() == ""

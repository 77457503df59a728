"""Cell files: every key is read into SI units, bad values are named, and the documentation has the same keys."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from calib.basics.units import UNITS, parse_noise, parse_quantity
from calib.data.cell import Cell, GroupDistance, Priors, TrackerNoise
from calib.data.cell_keys import frame_of
from calib.data.record import Record
from calib.errors import CalibError, FileError
from calib.model.parameter_sets import DIRECTIONS
from tests.places import ROOT

DISTANCE = """
[[distances]]
first = "A"
second = "B"
length_mm = 20
sigma_mm = 0.1
"""

DOC = ROOT / "docs" / "cell.md"


def read(folder: Path, text: str) -> Cell:
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return Cell.read(path)


def test_an_empty_file_is_the_default(tmp_path: Path):
    assert repr(read(tmp_path, "# nothing\n")) == repr(Cell())


def test_every_key(tmp_path: Path):
    cell = read(
        tmp_path,
        """
        base = "base"
        tip = "tool0"
        model = "hayati"
        freeze = ["a1", "target_x"]
        target = "known"
        target_mm = [70, -70.5, 22.5]
        frame = "estimate"
        frame_xyz_mm = [1000, 2, -3]
        frame_rpy_deg = [10, 20, 30]
        sigma_mm = 0.2
        priors = "given"
        prior_length_mm = 2
        prior_angle_mrad = 8
        """,
    )
    assert (cell.base, cell.tip, cell.model) == ("base", "tool0", "hayati")
    assert cell.frozen == ("a1", "target_x")
    assert not cell.estimate_target
    assert cell.target is not None
    np.testing.assert_allclose(cell.target, [0.07, -0.0705, 0.0225], rtol=1e-15)
    assert cell.estimate_frame
    assert cell.T_frame_base is not None
    np.testing.assert_allclose(cell.T_frame_base[:3, 3], [1.0, 0.002, -0.003], rtol=1e-15)
    rpy = np.radians([10.0, 20.0, 30.0])
    np.testing.assert_allclose(cell.T_frame_base[:3, :3], pin.rpy.rpyToMatrix(*rpy), atol=1e-15)
    assert cell.sigma["m"] == pytest.approx(2e-4, rel=1e-15)
    assert cell.priors == Priors("given", length=2e-3, angle=8e-3)


def test_every_new_key_and_table(tmp_path: Path):
    cell = read(
        tmp_path,
        """
        kind = "pose"
        repeats = "average"
        target_rpy_deg = [10, 20, 30]
        frame = ["rz", "x"]
        sigma_angle_deg = 0.1
        prior_zero_mrad = 1
        prior_gain = 2e-4
        prior_eccentricity_mrad = 3
        prior_compliance_rad_per_Nm = 4e-6
        gravity_m_per_s2 = [0, 9.81, 0]
        [targets_mm]
        up = [1, 2, 3]
        [frames."1/left"]
        xyz_mm = [1000, 0, 0]
        rpy_deg = [0, 0, 90]
        [frames.right]
        [ties]
        a3 = "a2"
        a4 = ["a2", -2]
        [bounds]
        d1 = "0.5 mm"
        "theta1" = ["-1 mrad", "180deg"]
        "j.gain" = 1e-3
        "target_x[up]" = ["-1um", "2 mm"]
        [parameter_priors]
        "j.compliance" = "2 mrad/Nm"
        "lift.compliance" = "3 mm/N"
        anything = "0.1 rad"
        [payload]
        mass_kg = 5
        com_mm = [0, 0, 60]
        [held]
        lift = "0.3 m"
        pan = "-90 deg"
        [[distances]]
        first = "*/left"
        second = "*/right"
        length_mm = 200
        sigma_mm = 0.01
        """,
    )
    assert (cell.kind, cell.repeats) == ("pose", "average")
    assert cell.target_rotation is not None
    rpy = np.radians([10.0, 20.0, 30.0])
    np.testing.assert_allclose(cell.target_rotation, pin.rpy.rpyToMatrix(*rpy), atol=1e-15)
    assert cell.estimate_frame
    assert cell.frame_directions == ("x", "rz")
    assert cell.sigma["rad"] == pytest.approx(np.radians(0.1), rel=1e-15)
    assert cell.priors == Priors("data", zero=1e-3, gain=2e-4, eccentricity=3e-3, compliance=4e-6)
    np.testing.assert_array_equal(cell.gravity, [0.0, 9.81, 0.0])
    assert set(cell.targets) == {"up"}
    np.testing.assert_allclose(cell.targets["up"], [1e-3, 2e-3, 3e-3], rtol=1e-15)
    assert set(cell.frames) == {"1/left", "right"}
    np.testing.assert_allclose(
        cell.frames["1/left"] @ [1, 0, 0, 1], [1.0, 1.0, 0.0, 1.0], atol=1e-15
    )
    np.testing.assert_array_equal(cell.frames["right"], np.eye(4))
    assert cell.ties == {"a3": ("a2", 1.0), "a4": ("a2", -2.0)}
    assert cell.bounds == {
        "d1": (-5e-4, 5e-4),
        "theta1": (-1e-3, pytest.approx(np.pi, rel=1e-15)),
        "j.gain": (-1e-3, 1e-3),
        "target_x[up]": (-1e-6, 2e-3),
    }
    assert cell.parameter_priors == {"j.compliance": 2e-3, "lift.compliance": 3e-3, "anything": 0.1}
    assert cell.payload is not None
    assert cell.payload.mass == 5.0
    np.testing.assert_allclose(cell.payload.com, [0.0, 0.0, 0.06], rtol=1e-15)
    assert cell.held == {"lift": 0.3, "pan": pytest.approx(-np.pi / 2, rel=1e-15)}
    assert cell.distances == (GroupDistance("*/left", "*/right", 0.2, 1e-5),)


def test_half_a_frame_and_half_the_priors(tmp_path: Path):
    moved = read(tmp_path, "frame_xyz_mm = [1, 2, 3]").T_frame_base
    assert moved is not None
    np.testing.assert_array_equal(moved[:3, :3], np.eye(3))
    turned = read(tmp_path, "frame_rpy_deg = [0, 0, 90]").T_frame_base
    assert turned is not None
    np.testing.assert_allclose(turned[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(turned[:3, 3], np.zeros(3))
    assert read(tmp_path, 'priors = "off"').priors == Priors("off")
    assert read(tmp_path, "prior_length_mm = 1").priors == Priors("data", length=1e-3)


def test_a_key_may_give_two_attributes_and_the_table_of_simulations_none(tmp_path: Path):
    cell = read(tmp_path, 'frame = "x,rz"\nprior_angle_mrad = 3\n[simulation]\nx = 1')
    assert (cell.estimate_frame, cell.frame_directions) == (True, ("x", "rz"))
    assert cell.priors == Priors("data", angle=0.003)
    with pytest.raises(FileError, match="this is not a TOML file"):
        read(tmp_path, "a = = 1")


@pytest.mark.parametrize(
    ("value", "estimate", "directions"),
    [
        ("known", False, DIRECTIONS),
        ("estimate", True, DIRECTIONS),
        ("x, rz", True, ("x", "rz")),
        (["y"], True, ("y",)),
    ],
)
def test_a_frame_is_known_or_estimated_in_directions(value, estimate, directions):
    assert frame_of(value) == (estimate, directions)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("targt_mm = [1, 2, 3]", "'targt_mm': unknown key (did you mean 'target_mm'"),
        ('freeze = "d2"', "'freeze' is 'd2'"),
        ('target = "fixed"', "'target' is 'fixed'"),
        ("target_mm = [1, 2]", "'target_mm' is [1, 2]; it must be three numbers [mm]."),
        ('target = "known"', "The target is marked as known, but its position"),
        ('frame = ["u"]', "'frame' is ['u']"),
        ('frame = "x,yaw"', "'frame' is 'x,yaw'"),
        ("sigma_angle_deg = -1", "sigma is {'rad': -0.017"),
        ('sigma_mm = "0.1"', "'sigma_mm' is '0.1'; it must be a number [mm]."),
        ('kind = "ball"', "There is no kind of measurement 'ball'; there are 'point', 'pose', "),
        ('repeats = "often"', "'repeats' is 'often'; it must be one of 'weighted', 'average', "),
        ('priors = "some"', "'priors' is 'some'; it must be one of 'data', 'given', 'off'"),
        ("prior_angle_mrad = 0", "The prior's angle is 0 rad"),
        ("[coupling]\na = 1", "'a' in [coupling] is 1; it must be a table of joints and factors"),
        ('[coupling]\na = { b = "1" }', "'a' in a cell's coupling is {'b': '1'}"),
        ("[frames]\na = 1", "'a' in [frames] is 1; it must be a table."),
        ("[record]\nscale_certified = true", "'scale_certified' in [record]: this key is not of"),
        ("[frames.a]\nxyz = [1, 2, 3]", "'xyz' in 'a' in [frames]: unknown key"),
        ("[ties]\na1 = ['a2', 0]", "'a1' in a cell's ties is ['a2', 0]"),
        ("[ties]\na1 = 'a2'\na2 = 'a3'", "'a1' is tied to 'a2'"),
        ("[bounds]\na1 = '1 mrad'", "'a1' in [bounds] is '1 mrad', which is an angle; write"),
        ("[bounds]\na1 = '1 furlong'", "'furlong' is not a unit that calib knows: "),
        ("[bounds]\na1 = '-1 mm'", "'a1' in a cell's bounds is (0.001, -0.001)"),
        ("[bounds]\n'j.zero' = 0.1", 'which is a number; write "0.5 mm" or "1 mrad".'),
        ("[parameter_priors]\n'j.gain' = '1 mm'", "'j.gain' in [parameter_priors] is '1 mm', w"),
        ("[held]\nlift = 0.3", "'lift' in [held] is 0.3; a joint's value needs a unit of angle"),
        ("[payload]\ncom_mm = [1, 2, 3]", "[payload] lacks 'mass_kg'."),
        ("[[distances]]\nfirst = 'a'", "number 1 lacks 'second', 'length_mm', 'sigma_mm'."),
        (DISTANCE.replace("B", "A"), "between the groups 'A' and 'A'"),
        ("[tracker]\nxyz_mm = [1, 2, 3]\nnoise = '15 um + 6'", 'given as "15 um + 6"'),
        ("[tracker]\nxyz_mm = [1, 2, 3]\nnearest_mm = 90000", "from 90 m to 80 m"),
        ("[reflector]\nnormal = [0, 0, 1]\nacceptance_deg = 181", "acceptance 181 deg"),
        (2 * "[[boxes]]\nname = 'a'\nsize_mm = [1, 2, 3]\nxyz_mm = [0, 0, 0]\n", "name of its own"),
        ("[ranges]\na = ['1 m', '1 mm']", "'a' in a cell's ranges is (1.0, 0.001)"),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(tmp_path: Path, text: str, said: str):
    with pytest.raises(CalibError, match=re.escape(said)) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'cell.toml'}: ")
    assert "\n" not in str(caught.value)


@given(number=st.floats(-1e6, 1e6), unit=st.sampled_from(["mm", "m", "um", "deg", "mrad", "rad"]))
def test_every_number_with_a_unit_is_read(number: float, unit: str):
    value, kind = parse_quantity(f"{number!r} {unit}")
    assert value == number * UNITS[unit].to_si
    assert kind == f"a{'n' if UNITS[unit].quantity == 'angle' else ''} {UNITS[unit].quantity}"
    assert parse_quantity(repr(number)) == (number, "a number")
    assert (
        parse_quantity(f" {number!r}{unit}/Nm" if unit == "mrad" else "1 rad/Nm")[1]
        == "a compliance"
    )


@pytest.mark.parametrize(
    ("text", "constant", "per_length"),
    [
        ("15 um + 6 um/m", 15e-6, 6e-6),
        ("15µm+6 μm/m", 15e-6, 6e-6),
        ("0.05 mm", 5e-5, 0.0),
        ("1e-2 mm + 0.001mm / m", 1e-5, 1e-6),
    ],
)
def test_words(text, constant, per_length):
    assert parse_noise(text, "noise") == pytest.approx((constant, per_length))


# The documentation


EXAMPLES = re.findall(r"```toml\n(.*?)```", DOC.read_text(encoding="utf-8"), re.DOTALL)


def test_the_documents_examples(tmp_path: Path):
    first, by_name, single, still, loads, coupled, sockets, *_, stated, record, _ = (
        read(tmp_path, example) for example in EXAMPLES
    )
    assert (first.base, first.tip, first.model, first.frozen) == ("base", "tool0", "dh", ("d2",))
    assert list(by_name.targets) == ["upper", "lower"]
    assert list(by_name.frames) == ["morning", "after lunch"]
    assert not by_name.estimate_target
    assert single.ties == {"a3": ("a2", 1.0), "a4": ("a2", -1.0)}
    assert single.bounds["theta6"] == pytest.approx((np.radians(-0.02), 1e-3))
    assert single.parameter_priors["shoulder_lift_joint.compliance"] == 1e-5
    assert single.frame_directions == ("x", "y", "z", "rz")
    assert dict(still.references) == {"floor 1": "world", "floor 2": "world", "foot": "base"}
    assert stated.uncertainty.instrument_limit == pytest.approx(15e-6)
    assert loads.payload is not None
    assert loads.payload.mass == 5.0
    assert loads.gravity[2] == 9.81
    assert loads.held["torso_lift_joint"] == 0.3
    assert coupled.coupling == {
        "joint_3": {"joint_2": 1.0},
        "joint_5": {"joint_4": -0.5, "joint_6": 0.025},
    }
    assert (record.record.robot_serial, record.record.date) == ("20183300123", "2026-11-26")
    assert record.record.calibration_due == "2027-05-31"
    assert record.record.temperature_C == (21.4, 22.1)
    assert list(record.record.given) == [entry.name for entry in fields(Record)]
    assert sockets.kind == "fixed"
    assert sockets.distances[0].pairs(["3/right", "3/left"]) == (("3/left", "3/right"),)


def test_the_documents_cameras_and_boards(tmp_path: Path):
    single, several = (read(tmp_path, example) for example in EXAMPLES[7:9])
    camera, board = single.cameras[""], single.boards[""]
    assert (single.base, single.tip) == ("tool0", "base")
    assert (camera.name, camera.width, camera.height, camera.lens) == (
        "camera",
        1280,
        720,
        "pinhole",
    )
    assert camera.values.tolist() == [912.4, 911.8, 640.2, 361.7, 0.11, -0.24, 0.0, 0.0, 0.0]
    # The defaults that the table says.
    assert camera.sigma.tolist() == [5.0, 5.0, 3.0, 3.0, 0.02, 0.02, 0.002, 0.002, 0.02]
    assert (board.pattern, board.columns, board.rows, board.square) == ("charuco", 7, 5, 0.02987)
    assert list(several.cameras) == ["left", "right"]
    right, gripper = several.cameras["right"], several.boards["gripper"]
    assert (right.name, right.width, right.lens, right.values) == ("right", 1920, "fisheye", None)
    assert (gripper.name, gripper.sigma_scale, gripper.sigma_warp) == ("gripper", 0.001, 0.0003)


CAMERA_INFO = """
image_width: 640
image_height: 480
camera_name: wrist
camera_matrix: {rows: 3, cols: 3, data: [580.5, 0, 315.25, 0, 576.75, 247.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.003, 3e-05, 0.5]}
"""

BOARD = """
name = "sheet"
pattern = "chessboard"
columns = 9
rows = 7
square_mm = 20.0
"""


def test_files_of_cameras_and_boards_are_beside_the_cell_file(tmp_path: Path, monkeypatch):
    folder = tmp_path / "cell"
    (folder / "cameras").mkdir(parents=True)
    (folder / "cameras" / "wrist.yaml").write_text(CAMERA_INFO)
    (folder / "board.toml").write_text(BOARD)
    monkeypatch.chdir(tmp_path)
    cell = read(
        folder,
        """
        [camera]
        file = "cameras/wrist.yaml"
        intrinsics = "exact"
        [cameras.left]
        file = "cameras/wrist.yaml"
        k3 = 0
        [board]
        file = "board.toml"
        square_mm = 19.9
        [boards.left]
        file = "board.toml"
        """,
    )
    assert {key: camera.name for key, camera in cell.cameras.items()} == {
        "": "wrist",
        "left": "left",
    }
    assert cell.cameras[""].values.tolist() == [
        *(580.5, 576.75, 315.25, 247.5),
        *(0.1, -0.2, 0.003, 3e-05, 0.5),
    ]
    assert cell.cameras[""].sigma.tolist() == [0.0] * 9
    assert cell.cameras["left"].values[8] == 0.0
    assert cell.cameras["left"].sigma is None
    assert {key: board.name for key, board in cell.boards.items()} == {"": "sheet", "left": "left"}
    assert (cell.boards[""].square, cell.boards["left"].square) == (0.0199, 0.02)


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("camera = 3", CalibError, ("'camera' is 3", "a table")),
        ("cameras = 3", CalibError, ("'cameras' is 3", "a table")),
        ("cameras.left = 3", CalibError, ("'left' in [cameras] is 3", "a table")),
        ("[camera]\nwidth = 640", CalibError, ("[camera]", "'height'")),
        ("[cameras.left]\nheight = 480", CalibError, ("[cameras.left]", "'width'")),
        ("[cameras.'']\nwidth = 640", CalibError, ("[cameras]", "write [camera]")),
        ("[boards.'']\nrows = 6", CalibError, ("[boards]", "write [board]")),
        ("[board]\nrows = 7", CalibError, ("[board]", "'pattern'")),
        ("[boards.left]\nrow = 7", CalibError, ("[boards.left]", "'row'", "'rows'")),
        ("[camera]\nfile = 'left.yaml'", FileError, ("[camera]", "left.yaml", "does not exist")),
        ("[board]\nfile = 'left.toml'", FileError, ("left.toml", "does not exist")),
        ("[camer]\nwidth = 640", CalibError, ("'camer'", "did you mean 'camera'")),
    ],
)
def test_mistakes_in_cameras_and_boards_are_named(tmp_path: Path, text, kind, words):
    with pytest.raises(CalibError) as error:
        read(tmp_path, text)
    assert type(error.value) is kind
    assert str(error.value).count("cell.toml") == 1
    for word in words:
        assert word in str(error.value)


def test_a_record_takes_texts_whole_numbers_and_dates(tmp_path: Path):
    text = "[record]\norder = 4711\ntemperature_C = 20\nnote = '''two\n lines'''\n"
    expected = Record(order="4711", temperature_C=(20.0,), note="two lines")
    assert read(tmp_path, text).record == expected


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "robot_seriall = '1'",
            "'robot_seriall' in [record]: unknown key (did you mean 'robot_serial'",
        ),
        (
            "order = 1.5",
            "'order' in [record] is 1.5; it must be a text in quotes, a whole number or a date",
        ),
        ("order = true", "'order' in [record] is True"),
        ("temperature_C = 'warm'", "'temperature_C' in [record] is 'warm'"),
        ("temperature_C = [20, 21, 22]", "it must be one number or two"),
        ("temperature_C = 293.15", "from -50 to 80"),
        (f"note = '{'x' * 161}'", "note has 161 characters; there is room for 160"),
    ],
)
def test_what_a_record_cannot_hold_is_refused(tmp_path: Path, line: str, said: str):
    with pytest.raises(CalibError, match=re.escape(said)):
        read(tmp_path, f"[record]\n{line}\n")


def test_the_documents_surroundings(tmp_path: Path):
    text = EXAMPLES[-1]
    cell = read(tmp_path, text)
    assert cell.tracker is not None
    assert cell.reflector is not None
    np.testing.assert_allclose(cell.tracker.position, [2.5, 0.0, 0.5])
    assert (cell.tracker.nearest, cell.tracker.farthest) == (0.8, 20.0)
    np.testing.assert_array_equal(cell.reflector.normal, [0.0, 0.0, 1.0])
    table, cabinet = cell.boxes
    assert (table.name, cabinet.name) == ("table", "cabinet")
    np.testing.assert_allclose(table.size, [1.2, 0.8, 0.04])
    np.testing.assert_allclose(table.T_base_box[:3], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.02]])
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(30.0))
    np.testing.assert_allclose(cabinet.T_base_box[:3, :3], turn, atol=1e-15)
    assert cell.ranges["shoulder_pan_joint"] == pytest.approx((-np.pi / 2, np.pi / 2))
    assert cell.ranges["elbow_joint"] == (-2.0, 0.0)

    # Without the keys that may be left out: the defaults that the tables below the example state.
    optional = "nearest_mm|farthest_mm|noise|repeatability_mm|acceptance_deg|rpy_deg"
    least = read(tmp_path, re.sub(rf"(?m)^({optional}) = .*$", "", text))
    assert least.tracker is not None
    assert least.reflector is not None
    assert (least.tracker.nearest, least.tracker.farthest) == (0.0, 80.0)
    assert least.tracker.noise == TrackerNoise(15e-6, 6e-6, 20e-6)
    assert cell.tracker.noise.std(3.0) == pytest.approx(least.tracker.noise.std(3.0), rel=1e-12)
    assert least.reflector.acceptance == cell.reflector.acceptance == pytest.approx(np.radians(30))
    np.testing.assert_array_equal(least.boxes[1].T_base_box[:3, :3], np.eye(3))

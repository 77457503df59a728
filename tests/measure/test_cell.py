from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import CalibError, FileError
from calib.measure.cell_file import KEYS
from calib.measure.cell import Cell, Priors

DOC = Path(__file__).parents[2] / "docs" / "cell.md"


def read(folder: Path, text: str) -> Cell:
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return Cell.read(path)


def test_an_empty_file_is_the_default(tmp_path: Path):
    assert repr(read(tmp_path, "# nothing\n")) == repr(Cell())
    assert Cell().estimate_target
    assert not Cell().estimate_frame
    assert Cell().model == "dh"


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
    assert cell.sigma == pytest.approx(2e-4, rel=1e-15)
    assert cell.priors == Priors("given", 2e-3, 8e-3)


def test_half_a_frame_and_half_the_priors(tmp_path: Path):
    moved = read(tmp_path, "frame_xyz_mm = [1, 2, 3]").T_frame_base
    assert moved is not None
    np.testing.assert_array_equal(moved[:3, :3], np.eye(3))
    turned = read(tmp_path, "frame_rpy_deg = [0, 0, 90]").T_frame_base
    assert turned is not None
    np.testing.assert_allclose(turned[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(turned[:3, 3], np.zeros(3))
    assert read(tmp_path, 'priors = "off"').priors == Priors("off")
    assert read(tmp_path, "prior_length_mm = 1").priors == Priors("data", 1e-3)


def test_the_byte_order_mark_of_an_editor_is_skipped(tmp_path: Path):
    assert read(tmp_path, '\N{BYTE ORDER MARK}tip = "flänsch"').tip == "flänsch"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("targt_mm = [1, 2, 3]", "unknown key 'targt_mm'. Did you mean 'target_mm'?"),
        ("[cell]", "unknown key 'cell'. A cell file may have 'base', 'tip', 'model', 'freeze', "),
        ("base = 1", "'base' is 1; it must be a name in quotes."),
        ("tip = []", "'tip' is []; it must be a name in quotes."),
        ("model = true", "'model' is True; it must be a name in quotes."),
        ('freeze = "d2"', "'freeze' is 'd2'; it must be a list of names."),
        ("freeze = [2]", "'freeze' is [2]; it must be a list of names."),
        ('target = "fixed"', "'target' is 'fixed'; it must be 'known' or 'estimate'."),
        ("target = [1, 2, 3]", "'target' is [1, 2, 3]; it must be 'known' or 'estimate'."),
        ("target_mm = [1, 2]", "'target_mm' is [1, 2]; it must be three numbers."),
        ("target_mm = 5", "'target_mm' is 5; it must be three numbers."),
        ("target_mm = [1, 2, nan]", "'target_mm' is [1, 2, nan]; it must be three numbers."),
        ('target = "known"', "The target is said to be known but is not given."),
        ("[frame]\nx = 1", "'frame' is {'x': 1}; it must be 'known' or 'estimate'."),
        ("frame = true", "'frame' is True; it must be 'known' or 'estimate'."),
        ('frame_xyz_mm = ["1", 2, 3]', "'frame_xyz_mm' is ['1', 2, 3]; it must be three"),
        ("frame_rpy_deg = [1, 2, true]", "'frame_rpy_deg' is [1, 2, True]; it must be three"),
        ("sigma_mm = 0", "'sigma_mm' is 0; it must be a positive number."),
        ('sigma_mm = "0.1"', "'sigma_mm' is '0.1'; it must be a positive number."),
        ("sigma_mm = inf", "'sigma_mm' is inf; it must be a positive number."),
        ('priors = "none"', "'priors' is 'none'; it must be 'data', 'given' or 'off'."),
        ("prior_length_mm = -1", "'prior_length_mm' is -1; it must be a positive number."),
        ("prior_angle_mrad = nan", "'prior_angle_mrad' is nan; it must be a positive number."),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(tmp_path: Path, text: str, said: str):
    with pytest.raises(CalibError, match=re.escape(said)) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'cell.toml'}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"base =", b"base = base", b"\xff\xfe", b"a = 1\na = 2"])
def test_what_is_not_toml(tmp_path: Path, data: bytes):
    path = tmp_path / "cell.toml"
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"cell\.toml: this is not a TOML file: "):
        Cell.read(path)


def test_a_file_that_cannot_be_read(tmp_path: Path):
    with pytest.raises(FileError, match=r"cell file '.*none\.toml' does not exist; check the name"):
        Cell.read(tmp_path / "none.toml")
    with pytest.raises(FileError, match="is a folder; name the file inside it"):
        Cell.read(tmp_path)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"target": (1.0, 2.0)}, "The target must be three finite numbers x, y, z [m]; (1.0, 2.0)"),
        ({"target": np.array([0.0, np.nan, 1.0])}, "[m]; [0.0, nan, 1.0] was given."),
        ({"target": "tip"}, "The target must be three finite numbers x, y, z [m]; 'tip' was given"),
        ({"estimate_target": False}, "The target is said to be known but is not given. Give it"),
        ({"T_frame_base": np.eye(3)}, "T_frame_base must be a 4 x 4 pose with a right-handed"),
        ({"T_frame_base": np.diag([1.0, 1.0, -1.0, 1.0])}, "with a right-handed rotation"),
        ({"T_frame_base": np.diag([2.0, 1.0, 1.0, 1.0])}, "with a right-handed rotation"),
        ({"T_frame_base": 2.0 * np.eye(4)}, "with a right-handed rotation"),
        ({"T_frame_base": np.full((4, 4), np.nan)}, "with a right-handed rotation"),
        ({"T_frame_base": [[1.0], [1.0, 2.0]]}, "[m]; [[1.0], [1.0, 2.0]] was given."),
        ({"T_frame_base": "here"}, "[m]; 'here' was given."),
        ({"sigma": 0.0}, "The noise sigma is 0.0 m; it must be a positive number."),
        ({"sigma": -1e-4}, "The noise sigma is -0.0001 m; it must be a positive number."),
        ({"sigma": float("inf")}, "The noise sigma is inf m; it must be a positive number."),
        ({"frozen": "d2"}, "The frozen parameters are a tuple of names; 'd2' was given."),
    ],
)
def test_a_cell_that_is_built_wrongly(wrong: dict[str, Any], said: str):
    with pytest.raises(CalibError, match=re.escape(said)):
        Cell(**wrong)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"sizes": "none"}, "Priors of the kind 'none' were asked for; choose one of 'data', "),
        ({"length": 0.0}, "The prior's length is 0.0 m; it must be positive. Use sizes 'off'"),
        ({"angle": float("nan")}, "The prior's angle is nan rad; it must be positive."),
    ],
)
def test_priors_that_are_built_wrongly(wrong: dict[str, Any], said: str):
    with pytest.raises(CalibError, match=re.escape(said)):
        Priors(**wrong)


def test_arrays_are_copies_that_cannot_be_written_to():
    target, T = np.array([1.0, 2.0, 3.0]), np.eye(4)
    cell = Cell(target=target, T_frame_base=T)
    target[0] = T[0, 3] = 9.0
    assert cell.target is not None
    assert cell.T_frame_base is not None
    assert cell.target[0] == 1.0
    assert cell.T_frame_base[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        cell.target[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        cell.T_frame_base[0, 3] = 0.0


def test_with_target():
    cell = Cell(model="zeros").with_target([0.1, 0.2, 0.3], estimate=False)
    assert cell.target is not None
    np.testing.assert_array_equal(cell.target, [0.1, 0.2, 0.3])
    assert not cell.estimate_target
    assert cell.model == "zeros"
    assert cell.with_target((0, 0, 0)).estimate_target


@given(
    angles=st.tuples(*[st.floats(-720.0, 720.0)] * 3),
    place=st.tuples(*[st.floats(-1e5, 1e5)] * 3),
)
def test_every_frame_of_numbers_is_a_pose(
    tmp_path_factory: pytest.TempPathFactory,
    angles: tuple[float, ...],
    place: tuple[float, ...],
):
    folder = tmp_path_factory.getbasetemp()
    T = read(
        folder, f"frame_rpy_deg = {list(angles)!r}\nframe_xyz_mm = {list(place)!r}"
    ).T_frame_base
    assert T is not None
    np.testing.assert_allclose(
        T[:3, :3], pin.rpy.rpyToMatrix(*np.radians(np.array(angles))), atol=1e-12
    )
    np.testing.assert_allclose(1e3 * T[:3, 3], place, rtol=1e-12, atol=1e-300)


def test_the_documents_example_is_read(tmp_path: Path):
    (example,) = re.findall(r"```toml\n(.*?)```", DOC.read_text(encoding="utf-8"), re.DOTALL)
    cell = read(tmp_path, example)
    assert (cell.base, cell.tip, cell.model, cell.frozen) == ("base", "tool0", "dh", ("d2",))
    assert cell.target is not None
    np.testing.assert_allclose(cell.target, [-0.07, 0.07, 0.0225])
    assert cell.sigma == pytest.approx(1e-4)
    assert cell.priors == Priors()


def test_the_document_has_every_key_and_no_other():
    documented = re.findall(r"^\| `(\w+)` \|", DOC.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(documented) == sorted(KEYS)

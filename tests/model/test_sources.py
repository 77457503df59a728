from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from calib.model.sources import read_urdf, recorded_urdf

URDF = Path(__file__).parents[2] / "urdf"
XACRO = "ur3_from_origins.urdf.xacro origins:=ur3_nominal_origins.yaml"


def test_a_urdf_is_told_by_its_bytes(tmp_path: Path):
    urdf = read_urdf(URDF / "ur3.urdf")
    assert recorded_urdf("ur3.urdf", urdf.sha256, URDF) == urdf
    assert recorded_urdf("ur3.urdf", urdf.sha256, tmp_path) is None
    (tmp_path / "ur3.urdf").write_bytes(urdf.data + b"\n")
    assert recorded_urdf("ur3.urdf", urdf.sha256, tmp_path) is None


def test_one_here_or_of_example_robot_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    urdf = read_urdf(URDF / "ur3.urdf")
    monkeypatch.chdir(URDF)
    assert recorded_urdf("ur3.urdf", urdf.sha256, tmp_path) == urdf
    panda = read_urdf("panda")
    assert recorded_urdf("panda.urdf", panda.sha256, tmp_path) == panda


def test_a_xacro_is_flattened_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    urdf = read_urdf(f"{URDF}/{XACRO}")
    assert urdf.source == XACRO
    assert recorded_urdf(XACRO, urdf.sha256, URDF) == urdf
    assert recorded_urdf(XACRO, urdf.sha256, tmp_path) is None
    assert (
        recorded_urdf(XACRO.split()[0], urdf.sha256, URDF) is None
    )  # its arguments are another robot's
    monkeypatch.chdir(URDF)
    assert recorded_urdf(XACRO, urdf.sha256, tmp_path) == urdf


@pytest.mark.parametrize("name", ["r.xacro a=b", "r.xacro a:=1 a:=2", "r.xacro", "broken.xacro"])
def test_what_cannot_be_flattened_is_not_at_hand(name: str, tmp_path: Path):
    (tmp_path / "broken.xacro").write_text("<robot>")
    assert recorded_urdf(name, "0" * 64, tmp_path) is None


def test_a_xacro_that_became_another(tmp_path: Path):
    for name in ("ur3_from_origins.urdf.xacro", "ur3_nominal_origins.yaml"):
        shutil.copy(URDF / name, tmp_path)
    urdf = read_urdf(f"{tmp_path}/{XACRO}")
    origins = tmp_path / "ur3_nominal_origins.yaml"
    origins.write_text(origins.read_text().replace("0.1519", "0.152"))
    assert recorded_urdf(XACRO, urdf.sha256, tmp_path) is None


@pytest.mark.parametrize(
    "name", ["u" * 300, "u" * 300 + ".urdf", "u" * 300 + ".xacro a:=1", "u/" * 3000]
)
def test_a_name_that_no_file_has(tmp_path: Path, name: str):
    assert recorded_urdf(name, "0" * 64, tmp_path) is None

"""What can be read, by ending and key, and what does not fit a source."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib.example
from calib.errors import CalibError, FileError, ModelError, UrdfError
from calib.result.calibration_file import write_result
from calib.verbs.convert.dh_files import DHTables, write_dh
from calib.verbs.convert.source import Options, Source
from calib.verbs.convert.source_kinds import KINDS, source_kind
from tests.hard_cases import made
from tests.verbs.convert.forms import write_forms

URDF = str(calib.example.paper_urdf())
CHAIN = Options(base="base", tip="tool0")
ON_PAPER = replace(CHAIN, robot=URDF)
Q = np.random.default_rng(4).uniform(-2, 2, (3, 6))


@pytest.fixture(scope="module")
def shop(tmp_path_factory) -> Path:
    """One robot in every form."""
    return write_forms(tmp_path_factory.mktemp("forms"))


def read_source(source: str, options: Options) -> Source:
    return KINDS[source_kind(source)].read(source, options)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("result.json", "result"),
        ("calibration.conf", "ur-conf"),
        ("kinematics.yaml", "ur-yaml"),
        ("origins.yaml", "origins"),
        ("corrected.urdf", "robot"),
    ],
)
def test_the_kind_of_a_file(shop, name, kind):
    assert source_kind(str(shop / name)) == kind
    assert source_kind("ur3") == "robot"


def test_rows_are_a_source(tmp_path):
    given = calib.example.dh_rows("kuka_kr6_r900")
    assert source_kind(str(given)) == "rows"
    source = read_source(str(given), Options())
    assert (source.nominal, [note.code for note in source.notes]) == (None, ["rows read"])
    assert source.notes[0].values[:2] == ("6", "standard")
    for ending in (".csv", ".json"):
        path = write_dh(DHTables.of(source.robot), tmp_path / f"rows{ending}")
        again = read_source(str(path), Options())
        assert again.kind == "rows"
        q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
        np.testing.assert_allclose(again.robot.poses(q), source.robot.poses(q), atol=1e-12)
    with pytest.raises(CalibError, match="not of DH rows"):
        read_source(str(calib.example.paper_measurements()), Options())
    (tmp_path / "broken.json").write_text("{")
    assert source_kind(str(tmp_path / "broken.json")) == "result"


def test_other_files_are_no_sources(tmp_path):
    (tmp_path / "x.yaml").write_text("joints: {}\nlimits: {}\n")
    for name in ("data.bin", "x.yaml"):
        with pytest.raises(FileError, match="what it is"):
            source_kind(str(tmp_path / name))


def test_the_urdf_of_a_result(shop, tmp_path):
    result = str(shop / "result.json")
    assert read_source(result, CHAIN).robot.tip == "tool0"
    nominal = read_source(result, Options(robot=str(shop / "robot.urdf")))
    corrected = read_source(result, Options(robot=str(shop / "corrected.urdf")))
    for other in (corrected, read_source(result, Options())):  # the result holds its URDF
        np.testing.assert_allclose(nominal.robot.poses(Q), other.robot.poses(Q), atol=1e-12)
        np.testing.assert_allclose(nominal.nominal.poses(Q), other.nominal.poses(Q), atol=1e-12)
    assert corrected.robot.urdf.data == (shop / "corrected.urdf").read_bytes()
    non_geometric = write_result(made("non_geometric"), tmp_path / "result.json")
    notes = read_source(str(non_geometric), Options()).notes
    assert [note.code for note in notes] == ["geometry alone"]


def test_origins_of_some_of_the_joints(shop, tmp_path):
    lines = (shop / "origins.yaml").read_text().splitlines()
    path = tmp_path / "origins.yaml"
    path.write_text("\n".join(line for line in lines if "elbow_joint:" not in line) + "\n")
    found = read_source(str(path), ON_PAPER)
    assert found.notes == (("joints without origin", ("'elbow_joint'",)),)


@pytest.mark.parametrize(
    ("name", "options", "error", "said"),
    [
        ("result.json", Options(tip="wrist_3_link"), CalibError, "leave out --base, --tip"),
        ("result.json", Options(robot="ur5"), ModelError, "the origin of '.*' is neither"),
        ("corrected.urdf", Options(ur_model="UR3"), UrdfError, "no link 'world'"),
        ("origins.yaml", Options(), CalibError, "give the URDF that they belong to"),
    ],
)
def test_what_does_not_fit_a_source(shop, name, options, error, said):
    with pytest.raises(error, match=said):
        read_source(str(shop / name), options)

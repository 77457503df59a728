"""Results and robots as sources, and what does not fit them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib.example
from calib.errors import CalibError, ModelError, UrdfError
from calib.result.calibration_file import write_result
from calib.verbs.convert.convert import KINDS, source_kind
from calib.verbs.convert.format import Options, Source
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


@pytest.mark.parametrize(
    ("name", "options", "error", "said"),
    [
        ("result.json", Options(tip="wrist_3_link"), CalibError, "leave out --base, --tip"),
        ("result.json", Options(robot="ur5"), ModelError, "joint origins are neither"),
        ("corrected.urdf", Options(arm="UR3"), UrdfError, "no link 'world'"),
        ("origins.yaml", Options(), CalibError, "give the URDF that they belong to"),
    ],
)
def test_what_does_not_fit_a_source(shop, name, options, error, said):
    with pytest.raises(error, match=said):
        read_source(str(shop / name), options)

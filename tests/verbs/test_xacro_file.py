"""Verbs with a xacro in the place of a URDF, as docs/xacro.md has them."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.example import paper_measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.convert.origins import origins_of, read_origins
from tests.places import ROOT

PAGE = (ROOT / "docs" / "xacro.md").read_text(encoding="utf-8")
NOMINAL = "ur3_from_origins.urdf.xacro origins:=ur3_nominal_origins.yaml"

Call = Callable[..., "object"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The example beside a table."""
    for name in ("ur3_from_origins.urdf.xacro", "ur3_nominal_origins.yaml"):
        shutil.copy(ROOT / "urdf" / name, tmp_path)
    shutil.copy(paper_measurements(), tmp_path / "data.csv")
    return tmp_path


@pytest.mark.slow
def test_the_examples_of_the_document(call, folder: Path):
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines():
        program, *words = shlex.split(line)
        assert program == "calib"
        done = call(folder, *words)
        assert (done.code, done.err) == (0, ""), line
    table = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert table["inputs"]["urdf"]["name"] == NOMINAL
    assert table["inputs"]["urdf"]["sha256"] == read_urdf(f"{folder}/{NOMINAL}").sha256

    corrected = Robot.load(folder / "corrected.urdf", "base", "tool0")
    written, wanted = read_origins(folder / "new_origins.yaml"), origins_of(corrected)
    assert list(written) == list(wanted)
    for name, origin in written.items():
        T, S = origin.T_parent_joint, wanted[name].T_parent_joint
        np.testing.assert_allclose(T, S, rtol=0, atol=1e-14)
    new = "ur3_from_origins.urdf.xacro origins:=new_origins.yaml"
    again = Robot.load(f"{folder}/{new}", "base", "tool0")
    q = random_joint_values(corrected, 50, np.random.default_rng(2))
    np.testing.assert_allclose(again.poses(q), corrected.poses(q), rtol=0, atol=1e-12)
    calibrated = Robot.load(ROOT / "urdf" / "ur3_calibrated.urdf", "base", "tool0")
    assert np.abs(again.poses(q) - calibrated.poses(q))[:, :3, 3].max() < 5e-3
    assert new in (folder / "view.html").read_text(encoding="utf-8")


def test_a_result_holds_the_robot_that_its_xacro_became(call, folder: Path):
    fit = ["fit", NOMINAL, "data.csv", "--base", "base", "--tip", "tool0", "--quiet"]
    fit += ["--model", "paper", "--no-validate"]
    for name in ("a.json", "b.json"):
        assert call(folder, *fit, "--json", name).code == 0
    (folder / "ur3_nominal_origins.yaml").unlink()
    said = call(folder, "compare", "a.json", "b.json")
    assert said.code == 0
    assert "Over the joint limits" in said.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["inspect", "ur3_from_origins.urdf.xacro orgins:=ur3_nominal_origins.yaml"],
            "It has no argument 'orgins' (did you mean 'origins'?)",
        ),
        (
            ["inspect", "ur3_from_origins.urdf.xacro"],
            "it uses the file 'ur3_origins.yaml', which cannot be read: No such file or directory",
        ),
        (
            ["inspect", "ur3_from_origins.urdf.xacro", "origins:=ur3_nominal_origins.yaml"],
            "Arguments of a xacro follow its name, in the same pair of quotes",
        ),
        (
            ["fit", NOMINAL, "data.csv", "-o", "corrected.urdf.xacro"],
            "'corrected.urdf.xacro' is the name of a xacro",
        ),
        (
            ["simulate", NOMINAL, "-o", "sim.xacro", "--base", "base", "--tip", "tool0"],
            "is the name of a xacro",
        ),
    ],
)
def test_errors_are_one_line(call, folder: Path, words: list[str], said: str):
    before = sorted(folder.iterdir())
    done = call(folder, *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert len(done.err.splitlines()) == 1
    assert sorted(folder.iterdir()) == before


def test_inspect_says_which_robot_it_is(call, folder: Path):
    done = call(folder, "inspect", NOMINAL, "--base", "base", "--tip", "tool0")
    assert done.lines[0] == f"Robot 'ur3' ({NOMINAL}), chain base to tool0:"

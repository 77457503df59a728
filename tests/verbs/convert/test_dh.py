from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, FileError, ModelError
from calib.example import dh_rows, paper_measurements
from calib.model.dh_table import dh_table
from calib.robot.dh_rows import CONVENTIONS
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.convert.convert import source_kind
from calib.verbs.convert.dh import ENDINGS, KINDS, DHTables, write_dh
from calib.verbs.convert.format import Options

#: The columns, in the order of the factors of a row, and how each is entered into the product.
FACTORS = {
    "standard": [("theta [deg]", "Rz"), ("d [mm]", "Tz"), ("a [mm]", "Tx"), ("alpha [deg]", "Rx")],
    "modified": [
        ("alpha(i-1) [deg]", "Rx"),
        ("a(i-1) [mm]", "Tx"),
        ("theta [deg]", "Rz"),
        ("d [mm]", "Tz"),
    ],
}
FACTORS["hayati"] = [*FACTORS["standard"], ("beta [deg]", "Ry")]

CROOKED = b"""<robot name="m|_1_"><link name="b"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="t"/>
<joint name="lift, up" type="prismatic"><parent link="b"/><child link="l1"/><origin xyz="0.1 0 0.2" rpy="0.1 0 0"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="_arm|*a*_" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.3 0.1 0" rpy="0 0.3 0.2"/>
<axis xyz="0 1 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.4 0 0" rpy="0 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
<mimic joint="_arm|*a*_" multiplier="-2" offset="0.1"/></joint>
<joint name="j" type="fixed"><parent link="l3"/><child link="t"/><origin xyz="0.1 0.2 0.3" rpy="1 2 3"/></joint>
</robot>"""


def moved(robot: Robot, size: float = 1e-3) -> Robot:
    """A robot off by about a millimetre and a milliradian in every placement."""
    rng = np.random.default_rng(5)
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            D = np.eye(4)
            D[:3, :3] = Rotation.from_rotvec(rng.normal(0, size, 3)).as_matrix()
            D[:3, 3] = rng.normal(0, size, 3)
            placements[i] = placements[i] @ D
    return robot.with_placements(placements)


@pytest.fixture(scope="module")
def crooked() -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(CROOKED, "m.urdf"), tip="t")


def by_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def pose(record: dict[str, str]) -> np.ndarray:
    """R = Rz(yaw) Ry(pitch) Rx(roll), as the file says."""
    T = np.eye(4)
    angles = [float(record[f"{name} [deg]"]) for name in ("yaw", "pitch", "roll")]
    T[:3, :3] = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    T[:3, 3] = [float(record[f"{name} [mm]"]) / 1e3 for name in "xyz"]
    return T


def from_records(records: list[dict[str, str]], table: str, convention: str, values) -> np.ndarray:
    """The tip's pose by the equation that the file states."""
    rows = {record["row"]: record for record in records if record["table"] == table}
    T = pose(rows["base"])
    for i, q in enumerate(values, start=1):
        row = rows[str(i)]
        for head, factor in FACTORS[convention]:
            number = float(row[head]) * (np.pi / 180 if factor[0] == "R" else 1e-3)
            added = {"theta": "Rz", "d": "Tz"}[row["added to"]]
            T = T @ elementary(factor, number + (q if factor == added else 0.0))
    return T @ pose(rows["tool"])


def from_json(table: dict, state: str, values) -> np.ndarray:
    """The same of a JSON file."""
    T = np.array(table[state]["T_base_0"])
    keys = {"theta": "theta_rad", "d": "d_m", "a": "a_m", "alpha": "alpha_rad", "beta": "beta_rad"}
    for row, q in zip(table[state]["rows"], values, strict=True):
        for head, factor in FACTORS[table["convention"]]:
            name = head.split(" ")[0].split("(")[0]
            T = T @ elementary(factor, row[keys[name]] + (q if row["added_to"] == name else 0.0))
    return T @ np.array(table[state]["T_n_tip"])


def elementary(factor: str, number: float) -> np.ndarray:
    T = np.eye(4)
    if factor[0] == "R":
        T[:3, :3] = Rotation.from_euler(factor[1], number).as_matrix()
    else:
        T["xyz".index(factor[1]), 3] = number
    return T


@pytest.mark.parametrize("name", ["ur3", "panda", "crooked"])
def test_every_file_says_what_the_robots_say(request, tmp_path, name):
    nominal: Robot = request.getfixturevalue(name)
    robot = moved(nominal)
    q = np.random.default_rng(2).uniform(0.1, 1, (2, len(nominal.joint_names)))
    values = robot.chain_values(q)
    for convention in CONVENTIONS:
        tables = DHTables.of(robot, nominal, convention)
        for ending in ENDINGS:
            path = write_dh(tables, tmp_path / f"{convention}{ending}")
            for state, arm in (("before", nominal), ("after", robot)):
                for one, wanted in zip(values, arm.poses(q), strict=True):
                    if ending == ".json":
                        found = from_json(json.loads(path.read_text()), state, one)
                    else:
                        found = from_records(by_csv(path), state, convention, one)
                    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


def test_the_change_is_after_minus_before(ur3, tmp_path):
    records = by_csv(write_dh(DHTables.of(moved(ur3), ur3, "hayati"), tmp_path / "dh.csv"))
    by = {(record["table"], record["row"]): record for record in records}
    for i in "123456":
        for head, _ in FACTORS["hayati"]:
            before, after, change = (float(by[t, i][head]) for t in ("before", "after", "change"))
            assert change == pytest.approx(after - before, abs=1e-5)
    for place in ("base", "tool"):
        before, after, change = (pose(by[t, place]) for t in ("before", "after", "change"))
        np.testing.assert_allclose(before @ change, after, atol=1e-8)
    assert max(abs(float(by["change", i]["theta [deg]"])) for i in "123456") < 1.0


def test_notes(ur3):
    (note,) = DHTables.of(moved(ur3, 2e-5), ur3, "standard").notes
    assert note.code == "nearly parallel axes"
    assert note.values[1] > 2.0
    assert f"(here up to {1e3 * note.values[1]:.3g} mm)" in note.text
    assert DHTables.of(moved(ur3, 2e-5), ur3, "hayati").notes == DHTables.of(ur3).notes == ()
    placements = ur3.placements.copy()
    tilt = Rotation.from_rotvec([3e-8, 0, 0]).as_matrix()
    placements[2, :3, :3] = placements[2, :3, :3] @ tilt
    tilted = ur3.with_placements(placements)
    q = np.random.default_rng(2).uniform(-3, 3, (9, 6))
    off = np.abs(DHTables.of(tilted, ur3).after.poses(q) - tilted.poses(q)).max()
    assert 1e-9 < off < 3e-7


def test_joints_that_follow_others_and_held_ones(crooked):
    tables = DHTables.of(crooked)
    wanted = ["lift, up", "_arm|*a*_", "-2 * _arm|*a*_ + 5.72957795131 deg"]
    assert [added.formula for added in tables.added()] == wanted
    assert tables.notes[-1].code == "joints without value"
    held = Robot.from_urdf(crooked.urdf, tip="t", held={"lift, up": 0.25})
    assert DHTables.of(held).added()[0][3] == "held at 250 mm"


def test_what_is_refused(ur3, tmp_path, monkeypatch):
    """What the rows are compared with is the robot's own poses."""
    with pytest.raises(FileError, match=r"dh\.xlsx: a DH table is written as"):
        write_dh(DHTables.of(ur3), tmp_path / "dh.xlsx")
    other = dh_table(moved(ur3), "standard")
    monkeypatch.setattr("calib.verbs.convert.dh.dh_table", lambda *_, **__: other)
    with pytest.raises(ModelError, match=r"standard.*nothing is written"):
        DHTables.of(ur3)


def test_rows_in_the_form_that_they_came_in(tmp_path):
    nominal = Robot.load(dh_rows("fanuc_lrmate200id"))
    robot = moved(nominal, 1e-4)
    tables = DHTables.of(robot, nominal)
    formulas = [added.formula for added in tables.added()]
    assert formulas == ["J1", "J2 - 90 deg", "J3 + J2", "J4", "J5", "J6"]
    assert tables.added()[2].others == {"J2": 1.0}
    records = by_csv(write_dh(tables, tmp_path / "rows.csv"))
    by = {(record["table"], record["row"]): record for record in records}
    assert [by["before", row]["d [mm]"] for row in "1456"] == ["330", "-335", "0", "-80"]
    assert by["before", "3"]["lower"] == "-140 deg"
    assert by["change", "3"]["lower"] == ""
    assert abs(float(by["change", "4"]["d [mm]"])) < 1.0
    # Hayati's rows are the standard ones, and hold the tilt of the parallel axes.
    hayati = DHTables.of(robot, nominal, "hayati")
    assert [added.formula for added in hayati.added()] == formulas
    change = hayati.states()["change"].rows
    assert max(abs(row.d) for row in change) < 1e-3
    # Of another chain, or in another convention, open choices are made as of any robot.
    other = Robot.from_urdf(nominal.urdf, tip="link_5")
    assert [a.formula for a in DHTables.of(other).added()] == ["J1", "J2", "J3 + J2", "J4", "J5"]
    assert DHTables.of(nominal, None, "modified").after.rows[1].offset == 0.0


def test_rows_are_a_source(tmp_path):
    given = dh_rows("kuka_kr6_r900")
    assert source_kind(str(given)) == "rows"
    source = KINDS["rows"].read(str(given), Options())
    assert (source.nominal, [note.code for note in source.notes]) == (None, ["rows read"])
    assert source.notes[0].values[:2] == ("6", "standard")
    for ending in (".csv", ".json"):
        path = write_dh(DHTables.of(source.robot), tmp_path / f"rows{ending}")
        again = KINDS["rows"].read(str(path), Options())
        assert again.kind == "rows"
        q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
        np.testing.assert_allclose(again.robot.poses(q), source.robot.poses(q), atol=1e-12)
    with pytest.raises(CalibError, match="no DH rows"):
        KINDS["rows"].read(str(paper_measurements()), Options())
    (tmp_path / "broken.json").write_text("{")
    assert source_kind(str(tmp_path / "broken.json")) == "result"

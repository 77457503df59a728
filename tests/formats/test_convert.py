"""Every source in every format: what was written, read by other programs' readers, is the robot that was read."""

from __future__ import annotations

import configparser
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib.example
from calib.cli.setup import parse_held
from calib.errors import CalibError, FileError, ModelError, UrdfError
from calib.formats.convert import (
    Wanted,
    check_options,
    chosen_format,
    write_target,
)
from calib.formats.sources import Asked, Source, read_source, source_kind
from calib.formats.universal_robots import write_ur_conf
from calib.formats.ur_arms import FullDH, ur_model
from calib.formats.ur_files import Conf
from calib.model.dh import dh_table
from calib.result.calibration_file import write_result
from calib.robot.robot import Robot
from tests.formats.forms import UR3, write_conf, write_forms
from tests.formats.ur_cases import CALIBRATIONS, rows, write_deltas
from tests.hard_cases import made

URDF = str(calib.example.paper_urdf())
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
#: A UR3 and the case with d2 = 439 m.
CASES = [case for case in CALIBRATIONS if case["robot"] in ("UR3", "UR10e")][:2]


@pytest.fixture(scope="module")
def shop(tmp_path_factory) -> Path:
    """One robot in every form."""
    return write_forms(tmp_path_factory.mktemp("forms"))


ASKED = {
    "result.json": Asked(),
    "calibration.conf": Asked(ur_model="UR3"),
    "kinematics.yaml": Asked(),
    "origins.yaml": Asked(robot=URDF, base="base", tip="tool0"),
    "corrected.urdf": Asked(robot=URDF, base="base", tip="tool0"),
}
NAMES = {"urdf": "o.urdf", "ur-yaml": "o.yaml", "ur-conf": "o.conf", "origins": "o.yaml"}


@pytest.fixture(scope="module", params=ASKED)
def source(request, shop) -> Source:
    return read_source(str(shop / request.param), ASKED[request.param])


def poses_of_urdf(path: Path, robot: Robot, q: np.ndarray) -> np.ndarray:
    """Tip in base by Pinocchio alone."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    found = []
    for row in q:
        values = pin.neutral(model)
        for name, value in zip(robot.joint_names, row, strict=True):
            joint = model.joints[model.getJointId(name)]
            values[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
        pin.framesForwardKinematics(model, data, values)
        base, tip = (
            data.oMf[model.getFrameId(n, pin.FrameType.BODY)] for n in (robot.base, robot.tip)
        )
        found.append((base.inverse() * tip).homogeneous)
    return np.array(found)


def poses_of_yaml(path: Path, q: np.ndarray) -> np.ndarray:
    """Flange in the controller's base, as Universal Robots' description makes it of the file."""
    table = yaml.safe_load(path.read_text())["kinematics"]
    found = []
    for row in q:
        T = np.eye(4)  # base_link_inertia is turned by half a turn in base_link, and so is base
        for link, value in zip(LINKS, row, strict=True):
            one = table[link]
            P = np.eye(4)
            P[:3, :3] = Rotation.from_euler(
                "xyz", [one[k] for k in ("roll", "pitch", "yaw")]
            ).as_matrix()
            P[:3, 3] = [one[k] for k in "xyz"]
            J = np.eye(4)
            J[:3, :3] = Rotation.from_euler("z", value).as_matrix()
            T = T @ P @ J
        found.append(T)
    return np.array(found)


def deltas_of_conf(path: Path) -> dict[str, np.ndarray]:
    parser = configparser.ConfigParser()
    parser.read(path)
    return {
        key: np.array(json.loads(parser["mounting"][f"delta_{key}"]))
        for key in ("theta", "a", "d", "alpha")
    }


def own_hash(path: Path) -> str:
    return yaml.safe_load(path.read_text())["kinematics"]["hash"]


Q = np.random.default_rng(4).uniform(-2, 2, (3, 6))


# Every source in every format is the same robot


def test_a_urdf(source, tmp_path):
    assert write_target(source, Wanted(tmp_path / "o.urdf", "urdf")) == ()
    found = poses_of_urdf(tmp_path / "o.urdf", source.robot, Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)


def test_origins(source, tmp_path):
    write_target(source, Wanted(tmp_path / "o.yaml", "origins"))
    table = yaml.safe_load((tmp_path / "o.yaml").read_text())["origins"]
    for joint, T in source.robot.origins().items():
        one = table.pop(joint)
        xyz, rpy = ([float(word) for word in one[key].split()] for key in ("xyz", "rpy"))
        np.testing.assert_allclose(xyz, T[:3, 3], rtol=0, atol=1e-12)
        R = Rotation.from_euler("xyz", rpy).as_matrix()
        np.testing.assert_allclose(R, T[:3, :3], rtol=0, atol=1e-12)
    assert table == {}


def test_a_kinematics_yaml(source, shop, tmp_path):
    own = shop / "kinematics.yaml"
    assert write_target(source, Wanted(tmp_path / "o.yaml", "ur-yaml", own)) == ()
    found = poses_of_yaml(tmp_path / "o.yaml", Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)
    assert own_hash(tmp_path / "o.yaml") == own_hash(own)


def test_a_calibration_conf(source, tmp_path):
    assert write_target(source, Wanted(tmp_path / "o.conf", "ur-conf")) == ()
    nominal = rows(UR3["nominal"])
    found = (nominal + rows(deltas_of_conf(tmp_path / "o.conf"))).poses(Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["dh", "modified-dh", "hayati"])
def test_dh_table(source, name, tmp_path):
    write_target(source, Wanted(tmp_path / "o.json", name))
    table = json.loads((tmp_path / "o.json").read_text())
    convention = {"dh": "standard", "modified-dh": "modified"}.get(name, name)
    assert table["convention"] == convention
    assert [row["joint"] for row in table["before"]["rows"]] == list(source.robot.joint_names)
    wanted = dh_table(source.robot, convention, like=source.nominal).rows
    assert [row["d_m"] for row in table["after"]["rows"]] == [row.d for row in wanted]


@pytest.mark.parametrize("base", ["base", "base_link"])
def test_what_a_file_of_universal_robots_has_no_place_for_is_said(shop, tmp_path, base):
    # Seen from base_link, which is turned by half a turn, a displacement of the arm's base is another one.
    found = read_source(str(shop / "robot.urdf"), Asked(base=base, tip="tool0"))
    placements = found.robot.placements.copy()
    placements[0, :3, :3] = placements[0, :3, :3] @ Rotation.from_euler("x", 1e-3).as_matrix()
    placements[-1, :3, 3] += [1e-4, 2e-4, 0]
    moved = replace(found, robot=found.robot.with_placements(placements))
    wanted = Wanted(tmp_path / "k.yaml", "ur-yaml", hash_from=shop / "kinematics.yaml")
    (remark,) = write_target(moved, wanted)
    assert "k.yaml: the flange lies (" in remark
    # The last row has a and alpha for the flange; before the first one there is nothing.
    (remark,) = write_target(moved, Wanted(tmp_path / "k.conf", "ur-conf"))
    assert "k.conf: the first axis lies (" in remark


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_factory_calibrations_against_their_own_rows(case, tmp_path):
    conf = write_conf(case, tmp_path / "calibration.conf")
    source = read_source(str(conf), Asked(ur_model=case["robot"]))
    assert source.hash == case["driver_hash"]
    q, wanted = (np.array(case["fk"][key]) for key in ("q", "T"))
    write_target(source, Wanted(tmp_path / "o.urdf", "urdf"))
    found = poses_of_urdf(tmp_path / "o.urdf", source.robot, q)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
    write_target(source, Wanted(tmp_path / "o.yaml", "ur-yaml"))
    np.testing.assert_allclose(poses_of_yaml(tmp_path / "o.yaml", q), wanted, rtol=0, atol=1e-9)
    again = read_source(str(tmp_path / "o.yaml"), Asked(ur_model=case["robot"]))
    assert again.hash == source.hash
    np.testing.assert_allclose(again.robot.poses(q), wanted, rtol=0, atol=1e-9)
    for name in ("dh", "modified-dh", "hayati"):
        write_target(source, Wanted(tmp_path / f"{name}.md", name))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_standard_rows_are_those_that_the_factory_wrote(case, tmp_path):
    # From deltas to frames near their nominal places, and from those back to rows: d2 is 439 m again.
    conf = write_conf(case, tmp_path / "calibration.conf")
    source = read_source(str(conf), Asked(ur_model=case["robot"]))
    found = dh_table(source.robot, "standard", like=source.nominal).rows
    full = case["full_dh"]
    assert [row.d for row in found] == pytest.approx(full["d"], rel=1e-9, abs=1e-9)
    for key in ("a", "alpha", "theta"):
        # Half a turn of an x axis changes the sign of a and alpha, and theta before and behind it.
        values = np.array([getattr(row, key) for row in found])
        wanted = np.array(full[key])
        if key == "theta":
            np.testing.assert_allclose(np.sin(2 * values), np.sin(2 * wanted), atol=1e-9)
        else:
            np.testing.assert_allclose(np.abs(values), np.abs(wanted), atol=1e-9)


def test_a_file_that_reads_back_as_another_robot_is_not_written(shop, tmp_path, monkeypatch):
    found = read_source(str(shop / "result.json"), Asked())
    nothing = SimpleNamespace(deltas=FullDH(*np.zeros((4, 6))))
    monkeypatch.setattr(Conf, "read", lambda *_: nothing)
    with pytest.raises(ModelError, match=r"k\.conf: read back, .* 1e-09 is allowed"):
        write_target(found, Wanted(tmp_path / "k.conf", "ur-conf"))
    assert list(tmp_path.iterdir()) == []


def test_rows_that_hold_less_are_said(shop, tmp_path):
    # Axes 1e-8 rad from parallel: too far for parallel rows, too near for a common normal in double precision.
    found = read_source(str(shop / "robot.urdf"), Asked(base="base", tip="tool0"))
    placements = found.robot.placements.copy()
    turn = Rotation.from_euler("x", 1e-8).as_matrix()
    placements[2, :3, :3] = placements[2, :3, :3] @ turn
    placements[2, :3, 3] += [1e-4, 2e-4, 3e-4]
    bent = replace(found, robot=found.robot.with_placements(placements))
    written = write_ur_conf(bent.robot, bent.nominal, tmp_path / "k.conf")
    assert written.remarks[0].startswith("The rows hold the robot to")
    assert write_target(bent, Wanted(tmp_path / "l.conf", "ur-conf")) != ()


UR5E = ur_model("UR5e").nominal


#: All but a and alpha of the last row, which a kinematics.yaml has no place for.
HELD = np.array([[1] * 6, [1, 1, 1, 1, 1, 0]])[[0, 1, 0, 1]]


ENDS = FullDH([0.01, 0, 0, 0, 0, 0.02], [0] * 6, [1e-3, 0, 0, 0, 0, 2e-3], [0] * 6)


def test_a_calibration_of_the_ends_alone_is_not_lost(tmp_path):
    # The axes of such an arm are the nominal ones: its base and flange are not.
    conf = write_deltas(tmp_path / "ends.conf", ENDS)
    first = read_source(str(conf), Asked(ur_model="UR5e"))
    write_target(first, Wanted(tmp_path / "mid.urdf", "urdf"))
    links = {"base": "base", "tip": "tool0"}
    wanted = (UR5E + ENDS).poses(Q)
    alone = read_source(str(tmp_path / "mid.urdf"), Asked(**links))
    assert (alone.nominal, alone.model) == (None, None)
    source = read_source(str(tmp_path / "mid.urdf"), Asked(ur_model="UR5e", **links))
    own = tmp_path / "own.yaml"
    write_target(first, Wanted(own, "ur-yaml"))
    assert write_target(source, Wanted(tmp_path / "o.yaml", "ur-yaml", hash_from=own)) == ()
    np.testing.assert_allclose(poses_of_yaml(tmp_path / "o.yaml", Q), wanted, rtol=0, atol=1e-9)
    assert write_target(source, Wanted(tmp_path / "o.conf", "ur-conf")) == ()
    found = (UR5E + rows(deltas_of_conf(tmp_path / "o.conf"))).poses(Q)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
    # A file of the arm's own on this URDF, which has it already, is not added to it.
    again = read_source(str(conf), Asked(robot=str(tmp_path / "mid.urdf"), **links))
    np.testing.assert_allclose(again.robot.poses(Q), wanted, rtol=0, atol=1e-9)
    assert "is not the nominal UR5e: its flange lies up to" in again.remarks[0]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_a_conf_of_a_conf_has_the_same_numbers(case, tmp_path):
    conf = write_conf(case, tmp_path / "own.conf")
    conf.write_text(conf.read_text() + "joint_checksum = [ 0x1, 0x2]\ncalibration_status = 2\n")
    source = read_source(str(conf), Asked(ur_model=case["robot"]))
    (remark,) = write_target(source, Wanted(tmp_path / "o.conf", "ur-conf"))
    assert f"left out of {conf}: 'joint_checksum', 'calibration_status'. --update {conf}" in remark
    before, after = deltas_of_conf(conf), deltas_of_conf(tmp_path / "o.conf")
    for key in before:
        np.testing.assert_allclose(after[key], before[key], rtol=1e-12, atol=1e-12)
    again = read_source(str(tmp_path / "o.conf"), Asked(ur_model=case["robot"]))
    assert again.hash == source.hash
    kept = write_target(source, Wanted(tmp_path / "p.conf", "ur-conf", update=conf))
    assert kept[0].startswith("joint_checksum, calibration_status are as in")
    assert (tmp_path / "p.conf").read_bytes() == conf.read_bytes()


def test_how_far_a_source_is_from_its_nominal_robot(shop):
    source = read_source(str(shop / "result.json"), Asked())
    apart, turned = source.distances()
    assert len(apart) == len(turned) == 200
    assert 1e-3 < apart.mean() < apart.max() < 1e-2
    assert 1e-3 < turned.mean() < turned.max() < 3e-2
    placements = source.nominal.placements.copy()
    placements[-1, :3, :3] = placements[-1, :3, :3] @ Rotation.from_euler("x", 0.25).as_matrix()
    placements[-1, :3, 3] += [3e-3, 0, 4e-3]
    moved = Source("robot", "", source.nominal.with_placements(placements), source.nominal)
    np.testing.assert_allclose(moved.distances()[0], 5e-3, atol=1e-12)
    np.testing.assert_allclose(moved.distances()[1], 0.25, atol=1e-12)
    assert read_source(URDF.replace("ur3.urdf", "ur3_calibrated.urdf"), Asked()).distances() is None


# What a source is


def test_other_files_are_no_sources(tmp_path):
    with pytest.raises(
        FileError, match=r"data\.csv: this is none of what .* its ending is '\.csv'"
    ):
        source_kind("data.csv")
    path = tmp_path / "x.yaml"
    path.write_text("joints: {}\nlimits: {}\n")
    with pytest.raises(
        FileError, match=r"neither 'kinematics' nor 'origins', but 'joints', 'limits'. Give"
    ):
        source_kind(str(path))
    path.write_text("- 1\n")
    with pytest.raises(FileError, match="but no keys"):
        source_kind(str(path))
    with pytest.raises(FileError, match=r"YAML file 'none.yaml' does not exist"):
        source_kind("none.yaml")


# What goes with it


def test_a_result_says_base_tip_and_held_joints_itself(shop):
    result = str(shop / "result.json")
    assert read_source(result, Asked(base="base", tip="tool0")).robot.tip == "tool0"
    with pytest.raises(
        CalibError, match="for --tip tool0, and 'wrist_3_link' was given; leave out"
    ):
        read_source(result, Asked(tip="wrist_3_link"))
    with pytest.raises(CalibError, match="for --base base, and 'world' was given"):
        read_source(result, Asked(base="world"))
    with pytest.raises(CalibError, match="says itself which joints are held"):
        read_source(result, Asked(held=parse_held(["elbow_joint=1 rad"])))


def test_the_urdf_of_a_result(shop):
    result = str(shop / "result.json")
    nominal = read_source(result, Asked(robot=str(shop / "robot.urdf")))
    corrected = read_source(result, Asked(robot=str(shop / "corrected.urdf")))
    q = np.random.default_rng(1).uniform(-1, 1, (3, 6))
    for other in (corrected, read_source(result, Asked())):  # the result holds its URDF
        np.testing.assert_allclose(nominal.robot.poses(q), other.robot.poses(q), atol=1e-12)
        np.testing.assert_allclose(nominal.nominal.poses(q), other.nominal.poses(q), atol=1e-12)
    assert corrected.robot.urdf.data == (shop / "corrected.urdf").read_bytes()


def test_another_robot_than_the_result_s(shop):
    result = str(shop / "result.json")
    with pytest.raises(ModelError, match=r"of another robot than ur5_robot.urdf: the origin of '"):
        read_source(result, Asked(robot="ur5"))
    with pytest.raises(UrdfError, match="base"):
        read_source(result, Asked(robot="panda"))


def test_a_larger_model_is_said(tmp_path):
    path = write_result(made("larger"), tmp_path / "result.json")
    (remark,) = read_source(str(path), Asked()).remarks
    assert remark.startswith("The result has a larger model, 'dh+")


def test_a_conf_needs_its_arm(shop):
    conf = str(shop / "calibration.conf")
    with pytest.raises(
        CalibError, match=r"Say of which arm it is, as in --ur-model UR5e, or give its"
    ):
        read_source(conf, Asked())
    with pytest.raises(ModelError, match="'UR6' is not an arm"):
        read_source(conf, Asked(ur_model="UR6"))
    on_ours = read_source(conf, Asked(robot=str(shop / "robot.urdf"), base="base", tip="tool0"))
    bare = read_source(conf, Asked(ur_model="ur3"))
    q = np.random.default_rng(1).uniform(-1, 1, (3, 6))
    np.testing.assert_allclose(on_ours.robot.poses(q), bare.robot.poses(q), atol=1e-9)
    assert on_ours.model.name == bare.model.name == "UR3"


def test_origins_of_some_of_the_joints(shop, tmp_path):
    lines = (shop / "origins.yaml").read_text().splitlines()
    path = tmp_path / "origins.yaml"
    path.write_text("\n".join(line for line in lines if "elbow_joint:" not in line) + "\n")
    found = read_source(str(path), ASKED["origins.yaml"])
    assert found.remarks == (
        "The file has no origin of 'elbow_joint', which the chain 'base' to 'tool0' has: they stay as they are in "
        "the URDF.",
    )


def test_robots_and_their_nominal_ones(shop):
    corrected = str(shop / "corrected.urdf")
    alone = read_source(corrected, Asked(base="base", tip="tool0"))
    assert (alone.nominal, alone.model) == (None, None)
    nominal = read_source(str(shop / "robot.urdf"), Asked(base="base", tip="tool0"))
    assert nominal.nominal is nominal.robot
    assert nominal.model.name == "UR3"
    longer = shop / "longer.urdf"
    text = (shop / "robot.urdf").read_text()
    longer.write_text(text.replace('"elbow_joint" type="revolute"', '"knee" type="revolute"'))
    with pytest.raises(
        ModelError, match=r"and longer\.urdf has .*'knee'.* --robot is the same robot"
    ):
        read_source(corrected, Asked(robot=str(longer), base="base", tip="tool0"))
    with pytest.raises(UrdfError, match=r"corrected.urdf has no link 'panda_link0'"):
        read_source("panda", Asked(robot=corrected))


def test_an_arm_of_another_name(shop):
    for name in ("robot.urdf", "result.json"):
        links = Asked(ur_model="UR5", base="base", tip="tool0")
        with pytest.raises(
            ModelError, match=r"has not the nominal kinematics of the UR5: .* of the UR3"
        ):
            read_source(str(shop / name), links)
    with pytest.raises(ModelError, match="not named as in Universal Robots' description"):
        read_source(str(shop / "corrected.urdf"), Asked(ur_model="UR3"))


# Formats


@pytest.mark.parametrize(
    ("name", "asked", "kind", "format"),
    [
        ("o.urdf", None, "result", "urdf"),
        ("o.conf", None, "result", "ur-conf"),
        ("o.yaml", None, "ur-conf", "ur-yaml"),
        ("o.yaml", "origins", "ur-conf", "origins"),
        ("o.YML", "ur-yaml", "result", "ur-yaml"),
        ("o.md", "hayati", "robot", "hayati"),
        ("robot", "urdf", "robot", "urdf"),
    ],
)
def test_the_format_of_a_file(name, asked, kind, format):
    assert chosen_format(Path(name), asked, kind) == format


@pytest.mark.parametrize(
    ("name", "asked", "message"),
    [
        (
            "o.yaml",
            None,
            r"o.yaml: '.yaml' does not say which format .*: --to ur-yaml \(kinem.*origins",
        ),
        ("o.urdf", "excel", "There is no format 'excel'; --to is one of 'urdf', 'ur-yaml'"),
        ("o.txt", "dh", "not in '.txt'"),
        ("o.urdf.xacro", None, "a xacro is not written: .*--to origins -o origins.yaml"),
    ],
)
def test_formats_that_are_refused(name, asked, message):
    with pytest.raises(CalibError, match=message):
        chosen_format(Path(name), asked, "result")


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        (
            {"format": "urdf", "update": Path("u.conf")},
            "result",
            "--update u.conf ",
        ),
        ({"format": "dh", "hash_from": Path("o.yaml")}, "result", "--hash-from o.yaml "),
        (
            {"format": "urdf", "urcontrol": Path("c.conf")},
            "result",
            "--urcontrol c.conf ",
        ),
    ],
)
def test_options_that_nothing_needs(given, kind, message):
    with pytest.raises(CalibError, match=message):
        check_options(Wanted(Path("o"), **given), kind)


def test_a_kinematics_yaml_keeps_the_robot_s_own_hash(shop, tmp_path):
    source = read_source(str(shop / "result.json"), Asked())
    with pytest.raises(
        CalibError, match=r"compares with what the controller reports. Give the robot's"
    ):
        write_target(source, Wanted(tmp_path / "k.yaml", "ur-yaml"))
    assert list(tmp_path.iterdir()) == []
    by_conf = Wanted(tmp_path / "k.yaml", "ur-yaml", hash_from=shop / "calibration.conf")
    write_target(source, by_conf)
    assert own_hash(tmp_path / "k.yaml") == own_hash(shop / "kinematics.yaml")


@pytest.mark.parametrize("format", ["ur-yaml", "ur-conf"])
def test_other_robots_have_no_files_of_universal_robots(shop, tmp_path, format):
    corrected = read_source(str(shop / "corrected.urdf"), Asked(base="base", tip="tool0"))
    wanted = Wanted(tmp_path / "o", format, hash_from=shop / "kinematics.yaml")
    with pytest.raises(
        ModelError, match="for arms of Universal Robots, and no nominal robot is known"
    ):
        write_target(corrected, wanted)
    panda = Source("robot", "", Robot.load("panda"), Robot.load("panda"))
    with pytest.raises(
        ModelError, match=r"and 'panda' has the nominal kinematics of none. Name the arm"
    ):
        write_target(panda, wanted)
    assert list(tmp_path.iterdir()) == []


def test_an_update_keeps_the_other_lines(shop, tmp_path):
    own = tmp_path / "own.conf"
    own.write_text("[other]\nkept = 1  # yes\n" + (shop / "calibration.conf").read_text())
    source = read_source(str(shop / "result.json"), Asked())
    write_target(source, Wanted(tmp_path / "new.conf", "ur-conf", update=own))
    assert (tmp_path / "new.conf").read_text().startswith("[other]\nkept = 1  # yes\n[mounting]\n")
    before, after = deltas_of_conf(own), deltas_of_conf(tmp_path / "new.conf")
    assert not np.allclose(before["theta"], after["theta"])


def test_a_urdf_on_another_that_differs_in_more_than_origins(shop, tmp_path):
    text = (shop / "robot.urdf").read_text()
    other = tmp_path / "other.urdf"
    other.write_text(text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 1))
    assert other.read_text() != text
    source = read_source(
        str(shop / "corrected.urdf"), Asked(robot=str(other), base="base", tip="tool0")
    )
    with pytest.raises(ModelError, match="differ in more than the origins of their joints"):
        write_target(source, Wanted(tmp_path / "o.urdf", "urdf"))
    assert not (tmp_path / "o.urdf").exists()

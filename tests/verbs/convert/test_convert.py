"""Every source in every format: what was written, read by other programs' readers, is the robot that was read.

convert obeys the verdict of a result, and that which a URDF states.
"""

from __future__ import annotations

import configparser
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib.example
from calib.diagnosis.reasons import CARE, NO, Reason, Verdict, Why
from calib.errors import CalibError, FileError, ModelError, VerdictError
from calib.result.calibration_file import read_result, write_result
from calib.robot.robot import Robot
from calib.robot.ur_models import chain_of_rows, ur_model
from calib.robot.urdf import Urdf
from calib.verbs.convert.convert import FORMATS, KINDS, chosen_format, convert, source_kind
from calib.verbs.convert.format import CameraOptions, Options, Source
from calib.verbs.convert.text import text
from calib.verbs.convert.ur_arms import chain_poses
from tests.parts import with_part
from tests.robot.ur3_mjcf import ur3_mjcf
from tests.two_handed import fitted
from tests.verbs.convert.forms import UR3, write_forms
from tests.verbs.convert.ur_cases import CALIBRATIONS, rows, write_deltas

URDF = str(calib.example.paper_urdf())
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
#: A UR3 and the case with d2 = 439 m.
CASES = [case for case in CALIBRATIONS if case["robot"] in ("UR3", "UR10e")][:2]
CHAIN = Options(base="base", tip="tool0")
Q = np.random.default_rng(4).uniform(-2, 2, (3, 6))


@pytest.fixture(scope="module")
def shop(tmp_path_factory) -> Path:
    """One robot in every form."""
    return write_forms(tmp_path_factory.mktemp("forms"))


OPTIONS = {
    "result.json": Options(),
    "calibration.conf": Options(arm="UR3"),
    "kinematics.yaml": Options(),
    "origins.yaml": replace(CHAIN, robot=URDF),
    "corrected.urdf": replace(CHAIN, robot=URDF),
}


@pytest.fixture(scope="module", params=OPTIONS)
def source(request, shop) -> Source:
    return read_source(str(shop / request.param), OPTIONS[request.param])


def read_source(source: str, options: Options) -> Source:
    return KINDS[source_kind(source)].read(source, options)


def write(source: Source, path: Path, name: str, **options):
    return FORMATS[name].write(source, path, Options(**options))


def codes(notes) -> list[str]:
    return [note.code for note in notes]


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
            P, J = np.eye(4), np.eye(4)
            angles = [one[k] for k in ("roll", "pitch", "yaw")]
            P[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
            P[:3, 3] = [one[k] for k in "xyz"]
            J[:3, :3] = Rotation.from_euler("z", value).as_matrix()
            T = T @ P @ J
        found.append(T)
    return np.array(found)


def deltas_of_conf(path: Path) -> np.ndarray:
    parser = configparser.ConfigParser()
    parser.read(path)
    keys = ("theta", "a", "d", "alpha")
    return np.transpose([json.loads(parser["mounting"][f"delta_{key}"]) for key in keys])


def own_hash(path: Path) -> str:
    return yaml.safe_load(path.read_text())["kinematics"]["hash"]


# Every source in every format is the same robot


def test_a_urdf_and_origins(source, tmp_path):
    assert write(source, tmp_path / "o.urdf", "urdf") == ()
    found = poses_of_urdf(tmp_path / "o.urdf", source.robot, Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)
    write(source, tmp_path / "o.yaml", "origins")
    table = yaml.safe_load((tmp_path / "o.yaml").read_text())["origins"]
    for joint, T in source.robot.origins().items():
        one = table.pop(joint)
        xyz, rpy = ([float(word) for word in one[key].split()] for key in ("xyz", "rpy"))
        np.testing.assert_allclose(xyz, T[:3, 3], rtol=0, atol=1e-12)
        R = Rotation.from_euler("xyz", rpy).as_matrix()
        np.testing.assert_allclose(R, T[:3, :3], rtol=0, atol=1e-12)
    assert table == {}


def test_files_of_universal_robots(source, shop, tmp_path):
    own = shop / "kinematics.yaml"
    assert write(source, tmp_path / "o.yaml", "ur-yaml", hash_from=own) == ()
    found = poses_of_yaml(tmp_path / "o.yaml", Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)
    assert own_hash(tmp_path / "o.yaml") == own_hash(own)
    notes = write(source, tmp_path / "o.conf", "ur-conf")
    assert codes(notes) == []
    full = rows(UR3["nominal"]) + deltas_of_conf(tmp_path / "o.conf")
    found = chain_poses(chain_of_rows(full), Q)
    np.testing.assert_allclose(found, source.robot.poses(Q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_factory_calibrations_against_their_own_rows(case, tmp_path):
    conf = write_deltas(tmp_path / "own.conf", rows(case["delta"]))
    conf.write_text(conf.read_text() + "joint_checksum = [ 0x1, 0x2]\ncalibration_status = 2\n")
    arm = Options(arm=case["robot"])
    source = read_source(str(conf), arm)
    assert source.hash == case["driver_hash"]
    # The deltas alone do not tell a UR3 from a UR3e, nor a UR10e from a UR10.
    assert codes(source.notes) == ["arm not certain"]
    # Though d2 is hundreds of metres, no frame lies far from its nominal place.
    moved = source.robot.placements[:, :3, 3] - source.nominal.placements[:, :3, 3]
    assert np.linalg.norm(moved, axis=1).max() < 0.02
    q, wanted = (np.array(case["fk"][key]) for key in ("q", "T"))
    write(source, tmp_path / "o.urdf", "urdf")
    found = poses_of_urdf(tmp_path / "o.urdf", source.robot, q)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
    write(source, tmp_path / "o.yaml", "ur-yaml")
    np.testing.assert_allclose(poses_of_yaml(tmp_path / "o.yaml", q), wanted, rtol=0, atol=1e-9)
    again = read_source(str(tmp_path / "o.yaml"), arm)
    assert again.hash == source.hash
    # A conf of a conf has the same numbers, and the other lines if they are to be kept.
    assert codes(write(source, tmp_path / "o.conf", "ur-conf")) == ["other lines left out"]
    before, after = deltas_of_conf(conf), deltas_of_conf(tmp_path / "o.conf")
    np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12)
    kept = write(source, tmp_path / "p.conf", "ur-conf", update=conf)
    assert codes(kept) == ["other lines kept"]
    assert (tmp_path / "p.conf").read_bytes() == conf.read_bytes()


def test_a_calibration_of_the_ends_alone_is_not_lost(tmp_path):
    # The axes of such an arm are the nominal ones: its base and flange are not.
    ends = np.zeros((6, 4))
    ends[0, 0], ends[5, 0], ends[0, 2], ends[5, 2] = 0.01, 0.02, 1e-3, 2e-3
    conf = write_deltas(tmp_path / "ends.conf", ends)
    convert(str(conf), tmp_path / "mid.urdf", options=Options(arm="UR5e"))
    wanted = chain_poses(chain_of_rows(ur_model("UR5e").rows + ends), Q)
    alone = read_source(str(tmp_path / "mid.urdf"), CHAIN)
    assert (alone.nominal, alone.model) == (None, None)
    source = read_source(str(tmp_path / "mid.urdf"), replace(CHAIN, arm="UR5e"))
    assert write(source, tmp_path / "o.conf", "ur-conf") == ()
    np.testing.assert_allclose(deltas_of_conf(tmp_path / "o.conf"), ends, rtol=0, atol=1e-12)
    # A file of the arm's own on this URDF, which has it already, is not added to it.
    again = read_source(str(conf), replace(CHAIN, robot=str(tmp_path / "mid.urdf")))
    np.testing.assert_allclose(again.robot.poses(Q), wanted, rtol=0, atol=1e-9)


# Formats


@pytest.mark.parametrize(
    ("name", "asked", "kind", "format"),
    [
        ("o.urdf", None, "result", "urdf"),
        ("o.conf", None, "result", "ur-conf"),
        ("o.yaml", None, "ur-conf", "ur-yaml"),
        ("o.YML", "ur-yaml", "result", "ur-yaml"),
    ],
)
def test_the_format_of_a_file(name, asked, kind, format):
    assert chosen_format(Path(name), asked, kind) == format


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("o.yaml", {}, r"'.yaml' does not say which format .*: --to ur-yaml \(kinem.*origins"),
        ("o.urdf", {"to": "excel"}, "no format 'excel'. Give one of: --to urdf"),
        ("o.yaml", {"to": "ur-yaml"}, "compares with what the controller reports"),
    ],
)
def test_formats_and_options_that_are_refused(shop, tmp_path, name, options, said):
    with pytest.raises(CalibError, match=said):
        convert(str(shop / "result.json"), tmp_path / name, options=Options(**options))
    assert list(tmp_path.iterdir()) == []


def test_other_robots_have_no_files_of_universal_robots(shop, tmp_path):
    panda = Source("robot", Robot.load("panda"), Robot.load("panda"))
    for source in (read_source(str(shop / "corrected.urdf"), CHAIN), panda):
        for format in ("ur-yaml", "ur-conf"):
            with pytest.raises(ModelError, match="for arms of Universal Robots"):
                write(source, tmp_path / "o", format, hash_from=shop / "kinematics.yaml")


# Sources


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


def test_other_files_are_no_sources(tmp_path):
    (tmp_path / "x.yaml").write_text("joints: {}\nlimits: {}\n")
    for name in ("data.bin", "x.yaml"):
        with pytest.raises(FileError, match="what it is"):
            source_kind(str(tmp_path / name))


# The verdict


LOST = Reason.of(Why.PARAMETER_FAR, largest=0.2)
ENDINGS = {
    "urdf": ".urdf",
    "ur-yaml": ".yaml",
    "ur-conf": ".conf",
    "origins": ".yaml",
    "pal": ".yaml",
    "dynamixel-hardware": ".yaml",
    "ros2-transmission": ".yaml",
    "lerobot": ".json",
    "lerobot-dynamixel": ".json",
    "camera-mount": ".urdf",
    "static-transform": ".sh",
    "mjcf": ".xml",
    "xacro": ".xacro",
}
#: Written of results of images alone, which this is not.
OF_IMAGES = {"camera-info", "opencv"}
#: Written of arms with other joints.
OF_OTHER_ARMS = {"ufactory-yaml", "flexiv-yaml"}
TRACKER = CameraOptions(new_camera_frame="tracker")


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One robot in every form, and its result with other verdicts."""
    folder = write_forms(tmp_path_factory.mktemp("forms"))
    result = read_result(folder / "result.json")
    for name, use in (("bad", NO), ("care", CARE)):
        write_result(
            with_part(result, "geometry", verdict=Verdict(use, (LOST,))), folder / f"{name}.json"
        )
    write_result(with_part(result, "geometry", verdict=None), folder / "none.json")
    convert(str(folder / "bad.json"), folder / "bad.urdf", accept=True)
    return folder


@pytest.mark.parametrize("name", sorted(set(FORMATS) - OF_IMAGES - OF_OTHER_ARMS))
def test_no_format_is_written_of_what_is_not_to_be_used(verdicts: Path, tmp_path: Path, name: str):
    path = tmp_path / f"made{ENDINGS.get(name, '.csv')}"
    camera = TRACKER if FORMATS[name].of_camera else CameraOptions()
    robot = None
    if name == "mjcf":
        robot = ur3_mjcf(verdicts / "scene.xml")
    if name == "xacro":  # a URDF is a xacro without macros
        robot = verdicts / "robot.xacro"
        robot.write_bytes((verdicts / "robot.urdf").read_bytes())
    options = Options(
        to=name,
        hash_from=verdicts / "calibration.conf",
        arm="UR3",
        camera=camera,
        robot=robot,
    )
    with pytest.raises(VerdictError, match="parameter_far"):
        convert(str(verdicts / "bad.json"), path, options=options)
    assert not path.exists()
    done = convert(str(verdicts / "bad.json"), path, options=options, accept=True)
    assert done.against.startswith("do not use (parameter_far): ")
    assert path.exists()


def test_a_urdf_states_the_verdict_and_is_else_the_same(verdicts: Path, tmp_path: Path):
    convert(str(verdicts / "none.json"), tmp_path / "plain.urdf")
    stated = Urdf.read(verdicts / "bad.urdf")
    assert "parameter_far" in stated.verdict
    assert (
        stated.with_comments(run=stated.run, verdict="").data
        == (tmp_path / "plain.urdf").read_bytes()
    )


def test_a_urdf_that_states_it_is_refused_like_the_result(verdicts: Path, tmp_path: Path):
    source, options = str(verdicts / "bad.urdf"), Options(base="base", tip="tool0")
    for to in ("origins", "urdf"):
        path = tmp_path / f"made{ENDINGS[to]}"
        with pytest.raises(VerdictError, match="parameter_far"):
            convert(source, path, options=replace(options, to=to))
        assert not path.exists()
    nominal = replace(options, robot=str(verdicts / "robot.urdf"))
    convert(source, tmp_path / "again.urdf", options=nominal, accept=True)
    assert Urdf.read(tmp_path / "again.urdf").verdict == Urdf.read(source).verdict


def test_a_file_on_a_urdf_that_states_an_earlier_verdict_does_not_inherit_it(verdicts, tmp_path):
    options = Options(robot=str(verdicts / "bad.urdf"), base="base", tip="tool0")
    convert(str(verdicts / "origins.yaml"), tmp_path / "made.urdf", options=options)
    assert Urdf.read(tmp_path / "made.urdf").verdict == ""


@pytest.mark.parametrize(
    ("source", "said"),
    [("care.json", "use with care"), ("none.json", "none, the result was not validated")],
)
def test_the_verdict_is_printed(verdicts: Path, tmp_path: Path, source: str, said: str):
    done = convert(str(verdicts / source), tmp_path / "made.csv", to="dh")
    assert done.against == ""
    assert f"Verdict on {source}: {said}" in " ".join(text(done, source).split())


def test_a_calibration_and_a_robot_are_written_as_their_files_are(verdicts: Path, tmp_path: Path):
    result = read_result(verdicts / "care.json")
    expected = convert(
        verdicts / "care.json", tmp_path / "expected.csv", to="hayati"
    ).path.read_bytes()
    made = convert(result, tmp_path / "made.csv", to="hayati")
    assert made.path.read_bytes() == expected
    assert made.source.kind == "result"
    of_robot = convert(result.robot, tmp_path / "robot.csv", to="hayati", robot=result.nominal)
    assert of_robot.path.read_bytes() == expected
    assert (
        convert(result.robot, tmp_path / "robot.urdf").path.read_bytes() == result.robot.urdf.data
    )
    with pytest.raises(FileError, match=r"made\.csv"):
        convert(result, tmp_path / "made.csv", to="hayati")
    convert(result, tmp_path / "made.csv", to="hayati", overwrite=True)


def test_a_calibration_that_is_not_to_be_used_is_refused(verdicts: Path, tmp_path: Path):
    result = read_result(verdicts / "bad.json")
    with pytest.raises(VerdictError, match="parameter_far"):
        convert(result, tmp_path / "made.csv", to="dh")
    assert convert(result, tmp_path / "made.csv", to="dh", accept=True).against


def test_a_file_to_update_is_refused_where_the_format_is_written_anew(
    verdicts: Path, tmp_path: Path
):
    options = Options(update=verdicts / "result.json")
    for name in ("zeros", "dh", "urdf"):
        with pytest.raises(CalibError, match="--update"):
            convert(
                verdicts / "care.json",
                tmp_path / f"new{ENDINGS.get(name, '.csv')}",
                to=name,
                options=options,
            )


@pytest.mark.slow
def test_a_result_of_several_chains_is_converted_whole_or_refused(tmp_path):
    c = fitted()
    path = c.write_json(tmp_path / "two.json")
    convert(path, tmp_path / "two.urdf", to="urdf", accept=True)
    written = Urdf.read(tmp_path / "two.urdf")
    for name, T in c.robot.origins().items():
        np.testing.assert_allclose(written.joint(name).T_parent_joint, T, rtol=0.0, atol=1e-12)
    convert(path, tmp_path / "origins.yaml", to="origins", accept=True)
    origins = yaml.safe_load((tmp_path / "origins.yaml").read_text())["origins"]
    assert {"panda_joint3", "right/panda_joint3"} <= set(origins)
    with pytest.raises(ModelError, match="holds one chain"):
        convert(path, tmp_path / "rows.csv", to="dh", accept=True)
    zeros = c.zeros
    assert zeros is not None
    determined = dict(zip(zeros.joints, zeros.determined, strict=True))
    # Of each hand the zeros between its first and its last joint are determined by points.
    for prefix in ("", "right/"):
        assert [determined[f"{prefix}panda_joint{k}"] for k in range(2, 7)] == [True] * 5

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import FileError, ModelError
from calib.formats.universal_robots import (
    read_ur,
    write_ur_conf,
    write_ur_yaml,
)
from calib.formats.ur_arms import FullDH, UrModel, ur_model, ur_robot
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from tests.formats.ur_cases import WITH_DELTAS, rows, write_deltas

Q = np.random.default_rng(12).uniform(-2 * np.pi, 2 * np.pi, (100, 6))
HASH = "calib_4711"

by_name = pytest.mark.parametrize("case", WITH_DELTAS, ids=lambda case: case["name"])


@pytest.fixture
def conf_of(tmp_path):
    """A function that writes the calibration.conf of a case."""
    return lambda case: write_deltas(tmp_path / f"{case['name']}.conf", rows(case["delta"]))


def case_of(name: str):
    return next(case for case in WITH_DELTAS if case["name"] == name)


def urcontrol_of(table, path):
    lines = [f"{name} = {[float(v) for v in table[name]]}" for name in ("a", "d", "alpha")]
    path.write_text("\n".join(["[DH]", *lines]))
    return path


def displaced(robot: Robot, size: float = 1e-3, seed: int = 9) -> Robot:
    """Every placement displaced by millimetres and milliradians."""
    twists = np.random.default_rng(seed).normal(size=(7, 6)) * size
    return robot.with_placements(
        np.array(
            [P @ pin.exp6(t).homogeneous for P, t in zip(robot.placements, twists, strict=True)]
        )
    )


# calibration.conf


@by_name
def test_conf_to_urdf(case, conf_of):
    source = read_ur(conf_of(case), model=case["robot"])
    np.testing.assert_allclose(
        source.robot.poses(case["fk"]["q"]), case["fk"]["T"], rtol=0, atol=1e-9
    )
    assert source.hash == case["driver_hash"]
    assert source.model.name == case["robot"]
    # All that is to be said: the deltas alone do not tell a UR3 from a UR3e, nor a UR10e from a UR10.
    (remark,) = source.remarks
    assert "alike: that it is a " in remark
    # Though d2 is hundreds of metres, no frame lies far from its nominal place.
    moved = source.robot.placements[:, :3, 3] - source.nominal.placements[:, :3, 3]
    assert np.linalg.norm(moved, axis=1).max() < 0.02
    check_written(source.robot, rows(case["full_dh"]).poses(Q[:20]), Q[:20])


def test_the_nominal_rows_may_come_from_urcontrol(conf_of, tmp_path):
    case = case_of("ur3_a")
    conf, urcontrol = conf_of(case), urcontrol_of(case["nominal"], tmp_path / "urcontrol.conf")
    source = read_ur(conf, urcontrol=urcontrol)
    assert source.model.name == "UR3"
    np.testing.assert_allclose(
        source.robot.poses(case["fk"]["q"]), case["fk"]["T"], rtol=0, atol=1e-9
    )
    assert read_ur(conf, urcontrol=urcontrol, model="ur3").hash == case["driver_hash"]


@pytest.mark.parametrize(
    ("base", "tip"), [("base", "tool0"), ("base_link", "ee_link"), ("world", "wrist_3_link")]
)
def test_onto_the_user_s_urdf(base, tip, conf_of, ur3):
    case = case_of("ur3_a")
    nominal = ur3.rebuilt(base=base, tip=tip)
    source = read_ur(conf_of(case), robot=nominal)
    assert source.nominal is nominal
    # Seen from the controller's base at its flange, whatever the URDF calls them.
    T = source.robot.rebuilt(base="base").poses(case["fk"]["q"])
    if tip != "tool0":
        T = (
            T
            @ np.linalg.inv(nominal.poses(np.zeros(6))[0])
            @ nominal.rebuilt(tip="tool0").poses(np.zeros(6))
        )
    np.testing.assert_allclose(T, case["fk"]["T"], rtol=0, atol=1e-8)
    moved = source.robot.placements[:, :3, 3] - nominal.placements[:, :3, 3]
    assert np.linalg.norm(moved, axis=1).max() < 0.02
    changed = [
        joint.name
        for joint, was in zip(source.robot.urdf.joints, nominal.urdf.joints, strict=True)
        if not np.array_equal(joint.T_parent_joint, was.T_parent_joint)
    ]
    assert set(changed) <= set(nominal.joint_names)


def test_the_round_trip_of_a_conf(conf_of, tmp_path):
    for case in WITH_DELTAS:
        conf = conf_of(case)
        source = read_ur(conf, model=case["robot"])
        for update in (None, conf):
            path = tmp_path / "again.conf"
            written = write_ur_conf(
                source.robot, source.nominal, path, update=update, overwrite=True
            )
            assert written.remarks == ()
            again = read_ur(path, model=case["robot"])
            full = rows(case["full_dh"]).poses(Q)
            np.testing.assert_allclose(again.robot.poses(Q), full, rtol=0, atol=1e-12)
        # Updated, the file is what it was, the hash with it.
        assert path.read_bytes() == conf.read_bytes()
        assert again.hash == case["driver_hash"]


# A calibration of calib's own


@pytest.mark.parametrize(("base", "tip"), [("base", "tool0"), ("base_link", "ee_link")])
def test_what_a_yaml_has_no_place_for_is_said(base, tip, ur3, tmp_path):
    nominal = ur3.rebuilt(base=base, tip=tip)
    robot = displaced(nominal)
    written = write_ur_yaml(robot, nominal, tmp_path / "k.yaml", hash=HASH)
    assert "the flange lies" in written.remarks[0]
    assert "mm and" in written.remarks[0]
    assert len(written.remarks) == 1
    np.testing.assert_array_equal(written.T_base, np.eye(4))
    assert np.abs(written.T_tool[:2, 3]).max() > 1e-4
    assert abs(written.T_tool[2, 3]) < 1e-12  # along the axis the sixth joint holds it
    again = read_ur(written.path, robot=nominal)
    # T_base_tip = T_base_arm K(q) T_tool T_flange_tip
    flange = nominal.rebuilt(tip="tool0")
    T_flange_tip = np.linalg.inv(flange.poses(np.zeros(6))[0]) @ nominal.poses(np.zeros(6))[0]
    made = again.robot.poses(Q) @ np.linalg.inv(T_flange_tip) @ written.T_tool @ T_flange_tip
    np.testing.assert_allclose(made, robot.poses(Q), rtol=0, atol=2e-9)


def test_what_a_conf_has_no_place_for_is_said(tmp_path):
    nominal = ur_robot("UR5e")
    robot = displaced(nominal)
    written = write_ur_conf(robot, nominal, tmp_path / "calibration.conf")
    assert "the first axis lies" in written.remarks[0]
    assert "the flange lies" in written.remarks[1]
    again = read_ur(written.path, robot=nominal)
    made = written.T_base @ again.robot.poses(Q) @ written.T_tool
    np.testing.assert_allclose(made, robot.poses(Q), rtol=0, atol=1e-11)
    # An update keeps the other lines, and says that they are the old ones.
    old = tmp_path / "old.conf"
    old.write_text(written.path.read_text() + "joint_checksum = [ 0xb84e3393]\n")
    more = write_ur_conf(robot, nominal, tmp_path / "new.conf", update=old)
    assert "joint_checksum are as in" in more.remarks[0]
    assert "joint_checksum = [ 0xb84e3393]\n" in more.path.read_text()


def test_a_robot_that_was_calibrated_in_the_factory_is_corrected_further(conf_of, tmp_path):
    case = case_of("ur3_a")
    factory = read_ur(conf_of(case), model="UR3")
    robot = displaced(factory.robot, 1e-4)
    written = write_ur_yaml(robot, factory.robot, tmp_path / "k.yaml", hash=factory.hash)
    assert "is not the nominal UR3: its flange lies up to" in written.remarks[0]
    again = read_ur(written.path, robot=factory.nominal).robot
    np.testing.assert_allclose(again.poses(Q) @ written.T_tool, robot.poses(Q), rtol=0, atol=1e-12)
    rows_too = write_ur_conf(robot, factory.robot, tmp_path / "c.conf")
    back = read_ur(rows_too.path, model="UR3").robot.poses(Q)
    np.testing.assert_allclose(
        rows_too.T_base @ back @ rows_too.T_tool, robot.poses(Q), rtol=0, atol=1e-12
    )
    # And its URDF takes another file.
    on_it = read_ur(written.path, robot=factory.robot)
    np.testing.assert_allclose(on_it.robot.poses(Q), again.poses(Q), rtol=0, atol=1e-12)
    assert "names of its links" in on_it.remarks[0]
    on_it = read_ur(conf_of({**case, "name": "own"}), robot=factory.robot)
    np.testing.assert_allclose(on_it.robot.poses(Q), factory.robot.poses(Q), rtol=0, atol=1e-12)


def test_a_displacement_says_in_which_frame_it_is(tmp_path):
    # From base_link, half a turn from the controller's base, to the old flange of a tool turned by a right angle.
    bare = ur_robot("UR5e")
    nominal = bare.rebuilt(base="base_link", tip="flange")
    placements = np.array(nominal.placements)
    placements[0, :3, 3] += [1e-3, 1e-10, 0]  # along base_link's x: against the base's
    robot = nominal.with_placements(placements)
    written = write_ur_conf(robot, nominal, tmp_path / "c.conf")
    (remark,) = written.remarks
    assert "lies (-1.000000, 0.000000, 0.000000) mm and (0.000000, 0.000000, 0.000000) " in remark
    assert "along and about the axes of the controller's base (link 'base')" in remark
    placements = np.array(nominal.placements)
    placements[6, :3, 3] += placements[6, :3, :3] @ [0, 0, 1e-3]  # the flange link's z is tool0's y
    robot = nominal.with_placements(placements)
    (remark,) = write_ur_yaml(robot, nominal, tmp_path / "k.yaml", hash=HASH).remarks
    shift = ", ".join(f"{round(value, 4) + 0.0:.6f}" for value in T_tool0_flange()[:3, 2])
    assert f"the flange lies ({shift}) mm and" in remark
    assert "along and about the axes of the controller's flange (link 'tool0')" in remark


def T_tool0_flange() -> np.ndarray:
    """The link 'flange' in tool0, of the bare URDF."""
    return np.linalg.inv(ur_robot("UR5e").urdf.joint("flange-tool0").T_parent_joint)


def test_a_calibration_that_the_controller_does_not_use_is_said(conf_of):
    conf = conf_of(case_of("ur3_a"))
    for status, said in (("0", True), ("1", True), ("2", False)):
        conf.write_text(f"{conf.read_text()}calibration_status = {status} # 2 == Linearised\n")
        remarks = " ".join(read_ur(conf, model="UR3").remarks)
        assert ("which is not 2, linearised" in remarks) is said
        assert (f"calibration_status = {status}" in remarks) is said


def test_rows_lose_digits_where_axes_are_almost_parallel(tmp_path):
    nominal = ur_robot("UR5e")
    far, parallel = (
        "m where two axes are almost parallel, and no more digits fit",
        "are taken as parallel",
    )
    for angle, word in ((2e-8, far), (5e-9, parallel), (1e-4, "")):
        placements = np.array(nominal.placements)
        placements[2] = placements[2] @ pin.exp6(np.array([0, 0, 0, 0, angle, 0])).homogeneous
        placements[2, 1, 3] += 0.01
        robot = nominal.with_placements(placements)
        written = write_ur_conf(robot, nominal, tmp_path / "c.conf", overwrite=True)
        assert bool(written.remarks) == bool(word)
        for remark in written.remarks:
            assert remark.startswith("The rows hold the robot to")
            assert word in remark
        back = read_ur(written.path, robot=nominal).robot
        np.testing.assert_allclose(back.poses(Q), robot.poses(Q), rtol=0, atol=1e-7)


# kinematics.yaml


def test_a_yaml_says_of_which_arm_it_may_be(tmp_path):
    source = ur_robot("UR10e")
    robot = displaced(source, 3e-4)
    path = write_ur_yaml(robot, source, tmp_path / "k.yaml", hash=HASH).path
    found = read_ur(path)
    assert found.model.name == "UR10e"
    assert found.remarks == (
        f"{path} does not say of which arm it is; its kinematics are those of the UR10e or UR12e.",
    )
    assert read_ur(path, model="UR12e").remarks == ()
    assert read_ur(path, robot=source).remarks == ()


# Hashes


def test_the_hash_of_a_robot_s_own_files(conf_of, tmp_path):
    case = case_of("ur3_a")
    conf = conf_of(case)
    assert read_ur(conf, model="ur3").hash == case["driver_hash"]
    assert read_ur(conf, robot=ur_robot("ur3")).hash == case["driver_hash"]
    robot = ur_robot("ur3")
    path = write_ur_yaml(robot, robot, tmp_path / "k.yaml", hash="calib_7").path
    assert read_ur(path).hash == "calib_7"
    path.write_text(path.read_text().replace("hash:", "# hash:"))
    assert read_ur(path).hash is None
    assert "has no hash; the ROS driver wants the robot's own" in read_ur(path).remarks[-1]


# What is refused


@pytest.mark.parametrize("model", ["UR5", "UR10", "UR16e", "UR20"])
def test_a_conf_of_an_arm_of_another_size(conf_of, model):
    # Centimetres, no more: nearly parallel axes cancel for the right upper arm only.
    with pytest.raises(FileError, match="and that of 'UR3', 'UR3e' by 3"):
        read_ur(conf_of(case_of("ur3_a")), model=model)


def test_a_file_that_is_of_no_arm(tmp_path):
    deltas = FullDH([0.5, 0, 0, 0, 0, 0], [0] * 6, [0] * 6, [0] * 6)
    with pytest.raises(FileError, match=r"up to 0\.\d\d m from where that of a nominal UR3 is"):
        read_ur(write_deltas(tmp_path / "c.conf", deltas), model="UR3")


def test_names_that_do_not_agree(conf_of, tmp_path, ur3):
    case = case_of("ur3_a")
    conf = conf_of(case)
    urcontrol = urcontrol_of(case["nominal"], tmp_path / "urcontrol.conf")
    with pytest.raises(ModelError, match=r"are those of the UR3, not those of the UR5"):
        read_ur(conf, urcontrol=urcontrol, model="UR5")
    unknown = urcontrol_of({**case["nominal"], "a": [0, -0.3, 0, 0, 0, 0]}, tmp_path / "x.conf")
    with pytest.raises(ModelError, match=r"are no arm's that is known, not those of the UR5"):
        read_ur(conf, urcontrol=unknown, model="UR5")
    with pytest.raises(ModelError, match=r"not the nominal kinematics of the UR5: .* the UR3"):
        read_ur(conf, model="UR5", robot=ur3)
    with pytest.raises(ModelError, match=r"kinematics of the arm of x\.conf"):
        read_ur(conf, urcontrol=unknown, robot=ur3)
    with pytest.raises(ModelError, match="'UR99' is not an arm"):
        read_ur(conf, model="UR99")


def test_a_robot_that_is_no_such_arm(panda, ur3, tmp_path):
    path = tmp_path / "out"
    with pytest.raises(ModelError, match="of no Universal Robots arm that calib knows"):
        write_ur_yaml(panda, panda, path, hash=HASH)
    with pytest.raises(ModelError, match="of no Universal Robots arm that calib knows"):
        write_ur_conf(panda, panda, path)
    with pytest.raises(ModelError, match="is not the 'shoulder_pan_joint'"):
        write_ur_yaml(panda, ur3, path, hash=HASH)
    with pytest.raises(ModelError, match=r"axis 0 0 1\)"):
        write_ur_conf(ur_robot("ur3"), ur3, path)
    with pytest.raises(ModelError, match="not the nominal kinematics of the UR5"):
        write_ur_conf(ur3, ur3, path, model="UR5")
    far = ur_robot("UR5")
    with pytest.raises(
        ModelError, match=r"0\.\d\d m from where the nominal UR3 has it, so that it"
    ):
        write_ur_yaml(far, ur_robot("UR3"), path, hash=HASH)
    with pytest.raises(ModelError, match="it is no correction of it"):
        write_ur_conf(far, ur_robot("UR3"), path)
    with pytest.raises(FileError, match="is none of a calibration"):
        write_ur_yaml(ur3, ur3, path, hash="none of them")
    assert not path.exists()


def test_the_python_of_the_page_runs(conf_of, tmp_path, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "universal-robots.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    case = case_of("ur3_a")
    conf_of({**case, "name": "calibration"})
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(code.replace("UR5e", "UR3"), page.name, "exec"), names)
    assert names["written"].remarks == ()
    assert read_ur("kinematics.yaml").hash == case["driver_hash"]
    assert Robot.load("ur5e.urdf", "base", "tool0").urdf == names["source"].robot.urdf


@pytest.fixture
def conf_named(tmp_path):
    """A function that writes the calibration.conf of a robot."""

    def write(name: str):
        case = next(case for case in WITH_DELTAS if case["robot"] == name)
        return write_deltas(tmp_path / f"{name}.conf", rows(case["delta"]))

    return write


@pytest.fixture
def yaml_of(tmp_path, conf_named):
    """A function that writes the kinematics.yaml of a robot."""

    def write(name: str, hash: str = "calib_4711"):
        source = read_ur(conf_named(name), model=name)
        return write_ur_yaml(
            source.robot, source.nominal, tmp_path / f"{name}.yaml", hash=hash
        ).path

    return write


def urcontrol_rows(nominal: FullDH, path):
    lines = [f"{name} = {getattr(nominal, name).tolist()}" for name in ("theta", "a", "d", "alpha")]
    path.write_text("\n".join(["[DH]", *lines]))
    return path


# Deltas that fit several arms


def test_deltas_that_fit_several_arms_are_said_to(conf_named):
    conf = conf_named("UR3")
    said = "fit 'UR3', 'UR3e' alike: that it is a UR3e is taken from "
    (remark,) = read_ur(conf, model="UR3e").remarks
    assert f"{said}--ur-model. Taken for the wrong one of these, the flange is up to " in remark
    (remark,) = read_ur(conf, robot=ur_robot("UR3e")).remarks
    assert f"{said}--robot. " in remark
    (remark,) = read_ur(conf, robot=ur_robot("UR3e"), model="UR3e").remarks
    assert f"{said}--robot and --ur-model. " in remark


def test_the_controller_s_own_rows_say_which_arm_it_is(conf_named, tmp_path):
    urcontrol = urcontrol_rows(ur_model("UR3").nominal, tmp_path / "urcontrol.conf")
    assert read_ur(conf_named("UR3"), urcontrol=urcontrol).remarks == ()


# Files of another arm


def test_a_hash_of_another_arm_is_refused(conf_named, yaml_of):
    for path in (conf_named("UR3"), conf_named("UR10e"), yaml_of("UR3"), yaml_of("UR10e")):
        with pytest.raises(FileError, match=r"mm only.*Name the right one"):
            read_ur(path, model="UR5e")
        with pytest.raises(FileError, match="the file is of another arm"):
            read_ur(path, robot=ur_robot("UR5e"))
        (own,) = [name for name in ("UR3", "UR10e") if path.stem == name]
        assert read_ur(path, model=own).hash.startswith("calib_")


def test_a_hash_that_is_of_no_particular_robot_is_said(yaml_of):
    path = yaml_of("UR3", ur_model("UR5e").default_hash)
    remark = "has the hash of the nominal UR5e or UR7e: it is of no particular robot"
    assert remark in read_ur(path, model="UR3").remarks[-1]
    assert any(remark in said for said in read_ur(path).remarks)


def test_a_calibration_that_is_far_off_is_said_of_its_hash(tmp_path):
    conf = write_deltas(
        tmp_path / "c.conf", FullDH([0] * 6, [0, 0.05, 0, 0, 0, 0], [0] * 6, [0] * 6)
    )
    assert "by up to 50 mm from the nominal UR10" in read_ur(conf, model="UR10").remarks[0]


def test_another_arm_s_conf_is_not_updated(conf_named, tmp_path):
    robot = ur_robot("UR5e")
    for name in ("UR3", "UR10e"):
        with pytest.raises(FileError, match=rf"{name}\.conf: .*Give the calibration\.conf of this"):
            write_ur_conf(
                robot, robot, tmp_path / "new.conf", update=conf_named(name), model="UR5e"
            )
    assert not (tmp_path / "new.conf").exists()


# Arms that calib does not know


def near(**changes) -> FullDH:
    """A UR5e's rows with one number changed: column = (joint, change)."""
    columns = {name: getattr(ur_model("UR5e").nominal, name).copy() for name in changes}
    for name, (joint, change) in changes.items():
        columns[name][joint] += change
    nominal = ur_model("UR5e").nominal
    return FullDH(
        *(columns.get(name, getattr(nominal, name)) for name in ("theta", "a", "d", "alpha"))
    )


ARMS = {
    "d1": near(d=(0, 0.012)),
    "d6": near(d=(5, 0.0204)),
    "theta6": near(theta=(5, 0.02)),
    "a3": near(a=(2, -0.01)),
    "three": near(a=(1, -0.3), theta=(1, -1.5707963)),
}
SMALL = FullDH(
    [1e-4, 2e-4, 3e-4, 1e-4, 2e-4, 1e-4],
    [1e-4, 2e-4, 3e-4, 1e-4, 2e-4, 0],
    [3e-4, 0, 0, 2e-4, 1e-4, 1e-4],
    [2e-4, 0, 0, 3e-4, 2e-4, 0],
)


@pytest.mark.parametrize("nominal", ARMS.values(), ids=ARMS)
def test_the_writers_count_from_the_arm_of_the_source(nominal, tmp_path):
    conf = write_deltas(tmp_path / "c.conf", SMALL)
    source = read_ur(conf, urcontrol=urcontrol_rows(nominal, tmp_path / "u.conf"))
    assert isinstance(source.model, UrModel)
    assert not source.model.known
    again = write_ur_conf(
        source.robot, source.nominal, tmp_path / "d.conf", like=SMALL, model=source.model
    )
    assert again.path.read_bytes() == conf.read_bytes()
    assert again.remarks == ()
    written = write_ur_yaml(
        source.robot, source.nominal, tmp_path / "k.yaml", hash=source.hash, model=source.model
    )
    assert written.remarks == ()
    assert "Kinematics of one Universal Robots arm:" in written.path.read_text()
    found = read_ur(written.path, model=source.model).robot
    q = [0.3, -1.0, 1.2, 0.4, 0.5, -0.6]
    assert abs(found.poses(q) - (nominal + SMALL).poses(q)).max() < 1e-12

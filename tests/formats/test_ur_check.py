"""Of which arm a file is: files of another one are refused, and those that fit several are said to."""

from __future__ import annotations

import pytest

from calib.errors import FileError
from calib.formats.universal_robots import (
    read_ur_conf,
    read_ur_hash,
    read_ur_yaml,
    write_ur_conf,
    write_ur_yaml,
)
from calib.formats.ur_dh import FullDH
from calib.formats.ur_files import write_deltas
from calib.formats.ur_models import UrModel, ur_model, ur_robot
from tests.formats.ur_cases import WITH_DELTAS, rows


@pytest.fixture
def conf_of(tmp_path):
    """A function that writes the calibration.conf of a robot."""

    def write(name: str):
        case = next(case for case in WITH_DELTAS if case["robot"] == name)
        return write_deltas(tmp_path / f"{name}.conf", rows(case["delta"]), overwrite=True)

    return write


@pytest.fixture
def yaml_of(tmp_path, conf_of):
    """A function that writes the kinematics.yaml of a robot."""

    def write(name: str, hash: str = "calib_4711"):
        source = read_ur_conf(conf_of(name), model=name)
        return write_ur_yaml(
            source.robot, source.nominal, tmp_path / f"{name}.yaml", hash=hash
        ).path

    return write


def urcontrol_of(nominal: FullDH, path):
    lines = [f"{name} = {getattr(nominal, name).tolist()}" for name in ("theta", "a", "d", "alpha")]
    path.write_text("\n".join(["[DH]", *lines]))
    return path


# Deltas that fit several arms


def test_deltas_that_fit_several_arms_are_said_to(conf_of):
    conf = conf_of("UR3")
    said = "fit 'UR3', 'UR3e' alike: that it is a UR3e is taken from "
    (remark,) = read_ur_conf(conf, model="UR3e").remarks
    assert f"{said}--ur-model. Taken for the wrong one of these, the flange is up to " in remark
    (remark,) = read_ur_conf(conf, robot=ur_robot("UR3e")).remarks
    assert f"{said}--robot. " in remark
    (remark,) = read_ur_conf(conf, robot=ur_robot("UR3e"), model="UR3e").remarks
    assert f"{said}--robot and --ur-model. " in remark


def test_the_controller_s_own_rows_say_which_arm_it_is(conf_of, tmp_path):
    urcontrol = urcontrol_of(ur_model("UR3").nominal, tmp_path / "urcontrol.conf")
    assert read_ur_conf(conf_of("UR3"), urcontrol=urcontrol).remarks == ()


# Files of another arm


def test_a_hash_of_another_arm_is_refused(conf_of, yaml_of):
    for path in (conf_of("UR3"), conf_of("UR10e"), yaml_of("UR3"), yaml_of("UR10e")):
        with pytest.raises(FileError, match=r"mm only.*Give the file of this robot's own contr"):
            read_ur_hash(path, model="UR5e")
        with pytest.raises(FileError, match="the file is of another arm"):
            read_ur_hash(path, robot=ur_robot("UR5e"))
        (own,) = [name for name in ("UR3", "UR10e") if path.stem == name]
        assert read_ur_hash(path, model=own).hash.startswith("calib_")


def test_a_hash_that_is_of_no_particular_robot_is_said(yaml_of):
    path = yaml_of("UR3", ur_model("UR5e").default_hash)
    remark = "has the hash of the nominal UR5e or UR7e: it is of no particular robot"
    assert remark in read_ur_hash(path, model="UR3").remarks[0]
    assert any(remark in said for said in read_ur_yaml(path).remarks)


def test_a_calibration_that_is_far_off_is_said_of_its_hash(tmp_path):
    conf = write_deltas(
        tmp_path / "c.conf", FullDH([0] * 6, [0, 0.05, 0, 0, 0, 0], [0] * 6, [0] * 6)
    )
    assert "by up to 50 mm from the nominal UR10" in read_ur_hash(conf, model="UR10").remarks[0]


def test_another_arm_s_conf_is_not_updated(conf_of, tmp_path):
    robot = ur_robot("UR5e")
    for name in ("UR3", "UR10e"):
        with pytest.raises(FileError, match=rf"{name}\.conf: .*Give the calibration\.conf of this"):
            write_ur_conf(robot, robot, tmp_path / "new.conf", update=conf_of(name), model="UR5e")
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
    source = read_ur_conf(conf, urcontrol=urcontrol_of(nominal, tmp_path / "u.conf"))
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
    found = read_ur_yaml(written.path, model=source.model).robot
    q = [0.3, -1.0, 1.2, 0.4, 0.5, -0.6]
    assert abs(found.poses(q) - (nominal + SMALL).poses(q)).max() < 1e-12

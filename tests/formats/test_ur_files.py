"""The files of Universal Robots: what is written reads back, other bytes stay, damage is said."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from calib.errors import FileError
from calib.formats.universal_robots import (
    Conf,
    conf_bytes,
    kinematics_bytes,
    read_kinematics,
    read_nominal,
)
from calib.formats.ur_arms import chain_of_rows, ur_model
from tests.formats.ur_cases import WITH_DELTAS, rows

DELTAS = rows(WITH_DELTAS[0]["delta"])

CONF = """\
# written by the factory
[mounting]
delta_theta = [ 2.5e-08, -0.25, 6.50, 0.0125, -6.5e-08, -7.0e-07] # rad
delta_a = [ 0.00014, 0.0111, -7.2e-05, 0.00019, 1.5e-06, 0]
delta_d = [ 0.00022, -204.07, 203.39, # of joint 3
   0.68, -0.00012, -0.00013]   ; a list may go on
delta_alpha=[0.00026,0.00047,0.0073,0.00025,0.0018,0]
joint_checksum = [ 0xb84e3393, 0xb858ac7b, 0x3948d4db, 0xa6e947f5, 0xa6e1a65c, 0xa6fdfb5d]
calibration_status = 2 # 0 == notInitialized / 2 == Linearised
"""

URCONTROL = """\
[DH]
a = [0.00000, -0.42500, -0.39220, 0.00000, 0.00000, 0.0000] # m
d = [0.1625, 0.00000, 0.00000, 0.1333, 0.0997, 0.0996]
alpha = [ 1.570796327, 0, 0, 1.570796327, -1.570796327, 0 ]
joint_direction = [1, 1, -1, 1, 1, 1]
[Tool]
tcp_pose = [0, 0, 0, 0, 0, 0]
[DH]
mass = [3.7, 8.3, 2.2, 1.2, 1.2, 0.2]
"""


@pytest.fixture
def conf(tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(CONF)
    return path


def test_deltas_and_nominal_rows(conf, tmp_path):
    found = Conf.read(conf)
    assert found.deltas[:, 0].tolist() == [2.5e-08, -0.25, 6.5, 0.0125, -6.5e-08, -7e-07]
    assert found.deltas[:, 2].tolist() == [0.00022, -204.07, 203.39, 0.68, -0.00012, -0.00013]
    assert found.others == ("joint_checksum", "calibration_status")
    assert (Conf.read("new.conf", conf_bytes(DELTAS)).deltas == DELTAS).all()
    path = tmp_path / "urcontrol.conf"
    path.write_text(URCONTROL)
    np.testing.assert_allclose(read_nominal(path), ur_model("UR5e").rows, rtol=0, atol=1e-12)


def test_an_update_keeps_every_other_byte(conf):
    conf.write_bytes(CONF.replace("\n", "\r\n").encode() + b"name = caf\xe9\r\n")
    before = conf.read_bytes()
    after = Conf.read(conf).with_deltas(DELTAS)
    assert (Conf.read(conf, after).deltas == DELTAS).all()
    kept = [line for line in before.splitlines() if not line.startswith((b"delta_", b"   0.68"))]
    assert [line for line in after.splitlines() if not line.startswith(b"delta_")] == kept
    assert b"] # rad\r\n" in after
    assert b"]   ; a list may go on\r\n" in after


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("delta_alpha", "delta_alfa", "delta_alpha is no list of six numbers"),
        ("[mounting]", "[mount]", "delta_theta is no list of six numbers"),
        ("[mounting]", "mounting", "cannot be read as sections"),
        ("1.5e-06, 0]", "1.5e-06]", "delta_a is no list of six numbers"),
        ("0.0111", "zero", "delta_a: 'zero' is no number"),
        ("0.0111", "11.1", "delta_a: '11.1' is no number up to 10. Lengths are in metres"),
    ],
)
def test_damaged_files(old, new, message, conf):
    conf.write_text(CONF.replace(old, new))
    with pytest.raises(FileError, match=message) as error:
        Conf.read(conf)
    assert str(conf) in str(error.value)


@pytest.mark.parametrize(("line", "status"), [("status = 2 # 0", "2"), ("status = 1 # 0", "1")])
def test_whether_a_calibration_is_linearised(conf, line, status):
    conf.write_text(CONF.replace("status = 2 # 0", line))
    assert Conf.read(conf).status == status


# kinematics.yaml


CHAIN = chain_of_rows(rows(WITH_DELTAS[1]["full_dh"]))
HASH = "calib_4455573973530731233"


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "kinematics.yaml"
    path.write_bytes(kinematics_bytes(CHAIN, HASH))
    return path


def test_what_is_written_reads_back(written):
    chain, hash = read_kinematics(written)
    np.testing.assert_allclose(chain[:6], CHAIN[:6], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(chain[6], np.eye(4))
    assert hash == HASH


def test_small_numbers_are_numbers_to_every_reader(tmp_path):
    small = np.array(ur_model("UR3").rows)
    small[0, 1] = 1e-5
    path = tmp_path / "k.yaml"
    path.write_bytes(kinematics_bytes(chain_of_rows(small), HASH))
    assert yaml.safe_load(path.read_text())["kinematics"]["upper_arm"]["x"] == pytest.approx(1e-5)
    # A file by another program may have them without the point, and is understood.
    path.write_text(path.read_text().replace("1.0e-05", "1e-05"))
    assert read_kinematics(path)[0][1, 0, 3] == pytest.approx(1e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kinematics:", "kinematic:", "no 'shoulder'"),
        ("forearm", "fore_arm", "no 'forearm'"),
        ("z: 0.152", "z: true #", "z of 'shoulder': 'True' is no number"),
        ("z: 0.152", "z: 152.2 #", "z of 'shoulder': '152.2' is no number up to 10"),
        ("roll: 1.57", "roll: 90 #", "roll of 'upper_arm': '90' is no number up to 12.57"),
    ],
)
def test_damaged_yaml_files(old, new, message, written):
    written.write_text(written.read_text().replace(old, new))
    with pytest.raises(FileError, match=message):
        read_kinematics(written)


def test_a_hash_that_is_none():
    with pytest.raises(FileError, match="The hash is"):
        kinematics_bytes(CHAIN, "a b")
    data = kinematics_bytes(CHAIN, "null")
    assert read_kinematics("k.yaml", data)[1] == "null"

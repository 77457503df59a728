"""Files of Universal Robots: read, rewritten byte for byte or digit for digit, and refused if damaged."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import FileError
from calib.robot.ur_models import chain_of_rows, ur_model
from calib.verbs.convert.ur_arms import at_flange
from calib.verbs.convert.ur_files import (
    LINEARISED,
    Conf,
    KinematicsYaml,
    conf_bytes,
    kinematics_bytes,
    read_nominal,
)
from tests.verbs.convert.ur_cases import WITH_DELTAS, rows

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
def factory(tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(CONF)
    return path


def test_deltas_and_nominal_rows(factory, tmp_path):
    found = Conf.read(factory)
    assert found.deltas[:, 0].tolist() == [2.5e-08, -0.25, 6.5, 0.0125, -6.5e-08, -7e-07]
    assert found.deltas[:, 2].tolist() == [0.00022, -204.07, 203.39, 0.68, -0.00012, -0.00013]
    assert found.others == ("joint_checksum", "calibration_status")
    assert (Conf.read("new.conf", conf_bytes(DELTAS)).deltas == DELTAS).all()
    path = tmp_path / "urcontrol.conf"
    path.write_text(URCONTROL)
    np.testing.assert_allclose(read_nominal(path), ur_model("UR5e").rows, rtol=0, atol=1e-12)


def test_an_update_keeps_every_other_byte(factory):
    factory.write_bytes(CONF.replace("\n", "\r\n").encode() + b"name = caf\xe9\r\n")
    before = factory.read_bytes()
    after = Conf.read(factory).with_deltas(DELTAS)
    assert (Conf.read(factory, after).deltas == DELTAS).all()
    kept = [line for line in before.splitlines() if not line.startswith((b"delta_", b"   0.68"))]
    assert [line for line in after.splitlines() if not line.startswith(b"delta_")] == kept
    assert b"] # rad\r\n" in after
    assert b"]   ; a list may go on\r\n" in after


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("delta_alpha", "delta_alfa", "delta_alpha is not a list of six numbers"),
        ("[mounting]", "mounting", "cannot be read as sections"),
        ("0.0111", "zero", "delta_a: 'zero' is not a number"),
        ("0.0111", "11.1", "delta_a: '11.1' is not a number up to 10. Lengths are in metres"),
    ],
)
def test_damaged_files(old, new, message, factory):
    factory.write_text(CONF.replace(old, new))
    with pytest.raises(FileError, match=message) as error:
        Conf.read(factory)
    assert str(factory) in str(error.value)


def test_the_status_and_the_numbers(factory):
    assert Conf.read(factory).status == LINEARISED
    factory.write_text(CONF.replace("calibration_status = 2", "calibration_status = 1"))
    assert Conf.read(factory).status == "1"


# kinematics.yaml


CHAIN = chain_of_rows(rows(WITH_DELTAS[1]["full_dh"]))


OWN_HASH = "calib_4455573973530731233"


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "kinematics.yaml"
    path.write_bytes(kinematics_bytes(CHAIN, OWN_HASH))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("forearm", "fore_arm", "no 'forearm'"),
        ("z: 0.152", "z: 152.2 #", "z of 'shoulder': '152.2' is not a number up to 10"),
    ],
)
def test_damaged_yaml_files(old, new, message, written):
    written.write_text(written.read_text().replace(old, new))
    with pytest.raises(FileError, match=message):
        KinematicsYaml.read(written)


def test_a_hash_that_is_none():
    with pytest.raises(FileError, match="The hash is"):
        kinematics_bytes(CHAIN, "a b")
    data = kinematics_bytes(CHAIN, "null")
    assert KinematicsYaml.read("k.yaml", data).hash == "null"


def test_numbers_that_are_rounding_are_zero_and_those_that_did_not_change_stay():
    file = KinematicsYaml.read("k.yaml", kinematics_bytes(CHAIN, OWN_HASH))
    numbers = file.numbers
    assert not np.any((numbers != 0.0) & (np.abs(numbers) < 1e-12))
    own = numbers + 3e-13  # the same numbers, as another program wrote them
    moved = np.array(CHAIN)
    moved[2, 0, 3] += 1e-6
    like = file._replace(numbers=own)
    found = KinematicsYaml.read("k.yaml", kinematics_bytes(moved, OWN_HASH, like)).numbers
    changed = np.argwhere(found != own).tolist()
    assert changed == [[2, 0]]
    assert found[2, 0] == pytest.approx(numbers[2, 0] + 1e-6, abs=1e-15)


def test_the_chain_reads_back(written):
    chain = at_flange(CHAIN)
    file = KinematicsYaml.read(written, kinematics_bytes(chain, OWN_HASH))
    found = file.chain
    np.testing.assert_allclose(found[:6], chain[:6], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[6], np.eye(4))
    assert file.hash == OWN_HASH

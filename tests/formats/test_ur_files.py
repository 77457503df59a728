"""The files of Universal Robots: what is written reads back, other bytes stay, damage is said."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from calib.errors import FileError
from calib.formats.ur_arms import COLUMNS, FullDH, ur_model
from calib.formats.ur_files import (
    Conf,
    conf_bytes,
    kinematics_bytes,
    read_kinematics,
    read_nominal,
)
from tests.formats.ur_cases import WITH_DELTAS, rows

DELTAS = rows(WITH_DELTAS[0]["delta"])

CONF = """\
# written by the factory
[mounting]
delta_theta = [ 2.5e-08, -0.25, 6.50, 0.0125, -6.5e-08, -7.0e-07] # rad
delta_a = [ 0.00014, 0.0111, -7.2e-05, 0.00019, 1.5e-06, 0]
delta_d = [ 0.00022, -204.07, 203.39,
   0.68, -0.00012, -0.00013]   ; a list may go on
delta_alpha=[0.00026,0.00047,0.0073,0.00025,0.0018,0]
joint_checksum = [ 0xb84e3393, 0xb858ac7b, 0x3948d4db, 0xa6e947f5, 0xa6e1a65c, 0xa6fdfb5d]
calibration_status = 2 # 0 == notInitialized / 2 == Linearised
"""

URCONTROL = """\
[Hardware]
controller = 5
[DH]
a = [0.00000, -0.42500, -0.39220, 0.00000, 0.00000, 0.0000] # m
d = [0.1625, 0.00000, 0.00000, 0.1333, 0.0997, 0.0996]
alpha = [ 1.570796327, 0, 0, 1.570796327, -1.570796327, 0 ]
q_home_offset = [0, -1.570796327, 0, -1.570796327, 0, 0]
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


def test_the_deltas(conf):
    deltas = Conf.read(conf).deltas
    assert deltas.theta.tolist() == [2.5e-08, -0.25, 6.5, 0.0125, -6.5e-08, -7e-07]
    assert deltas.d.tolist() == [0.00022, -204.07, 203.39, 0.68, -0.00012, -0.00013]
    assert deltas.alpha.tolist() == [0.00026, 0.00047, 0.0073, 0.00025, 0.0018, 0.0]
    assert Conf.read(conf).others == ("joint_checksum", "calibration_status")


def test_the_nominal_rows_whatever_else_is_there(tmp_path):
    path = tmp_path / "urcontrol.conf"
    path.write_bytes(URCONTROL.replace("\n", "\r\n").encode() + b"; caf\xe9\r\n")
    nominal = read_nominal(path)
    assert nominal.a.tolist() == [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    assert nominal.d[3] == 0.1333
    assert nominal.theta.tolist() == [0.0] * 6
    path.write_text(URCONTROL + "theta = [0, 0, 0, 0, 0, 0.5]\n")
    assert read_nominal(path).theta[5] == 0.5


def test_what_an_editor_may_have_done_to_it(conf):
    # A byte order mark, and a comment with a letter whose second byte is a line's end elsewhere.
    text = CONF.removeprefix("# written by the factory\n") + "# \xc5 delta_a = 1\n"
    conf.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert Conf.read(conf).deltas.a[1] == 0.0111
    conf.write_text(CONF.replace("[mounting]", "  [ mounting ]  # of the arm"))
    assert Conf.read(conf).deltas.a[1] == 0.0111


def test_written_deltas_read_back_exactly():
    back = Conf.read("new.conf", conf_bytes(DELTAS)).deltas
    for name in COLUMNS:
        assert (getattr(back, name) == getattr(DELTAS, name)).all()


def test_a_list_over_several_lines_with_comments_between(conf):
    text = CONF.replace("203.39,\n", "203.39, # of ] joint 3\n # [ 1, 2 ]\n")
    conf.write_text(text)
    assert Conf.read(conf).deltas.d[2] == 203.39
    conf.write_bytes(Conf.read(conf).with_deltas(DELTAS))
    assert (Conf.read(conf).deltas.d == DELTAS.d).all()


def test_an_update_keeps_every_other_byte(conf):
    conf.write_bytes(CONF.replace("\n", "\r\n").encode() + b"name = caf\xe9\r\n")
    before = conf.read_bytes()
    after = Conf.read(conf).with_deltas(DELTAS)
    back = Conf.read(conf, after).deltas
    for name in COLUMNS:
        assert (getattr(back, name) == getattr(DELTAS, name)).all()
    kept = [line for line in before.splitlines() if not line.startswith((b"delta_", b"   0.68"))]
    assert [line for line in after.splitlines() if not line.startswith(b"delta_")] == kept
    assert b"] # rad\r\n" in after
    assert b"]   ; a list may go on\r\n" in after


def test_a_section_that_comes_again(conf):
    again = "[mounting]\ndelta_a = [ 0.00014, 0.0111, -7.2e-05, 0.00019, 1.5e-06, 0]\n"
    conf.write_text(CONF + "[other]\ndelta_a = 3\n" + again)
    assert Conf.read(conf).deltas.a[1] == 0.0111
    new = FullDH(DELTAS.theta, np.full(6, 0.5), DELTAS.d, DELTAS.alpha)
    conf.write_bytes(Conf.read(conf).with_deltas(new))
    assert conf.read_text().count("delta_a = [ 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]") == 2
    assert (Conf.read(conf).deltas.a == 0.5).all()
    assert "[other]\ndelta_a = 3\n" in conf.read_text()


DAMAGED = {
    "section": (CONF.replace("[mounting]", "[mount]"), r"no \[mounting\] .* 'mount'"),
    "key": (
        CONF.replace("delta_alpha", "delta_alfa"),
        r"has no delta_alpha \(did you mean 'delta_alfa'\?",
    ),
    "five": (
        CONF.replace("1.5e-06, 0]", "1.5e-06]"),
        r"line 4: delta_a is .* six numbers in brackets",
    ),
    "text": (CONF.replace("0.0111", "zero"), r"line 4: delta_a of joint 2 is 'zero'; .* \[m\]"),
    "nan": (CONF.replace("-0.25", "nan"), r"line 3: delta_theta of joint 2 is 'nan'; .* \[rad\]"),
    "hole": (CONF.replace("0.0111,", ","), r"delta_a of joint 2 is ''"),
    "open": (
        CONF.replace("1.5e-06, 0]", "1.5e-06, 0"),
        r"line 4: delta_a is '\[ 0.00014.*brackets",
    ),
    "mm": (CONF.replace("0.0111", "11.1"), r"joint 2 is 11.1, more than 10 m: .* metres"),
    "twice": (CONF + "delta_a = [1, 0, 0, 0, 0, 0]\n", r"two values, in line 4 and in line 10"),
    "binary": (CONF + "\0", r"not a calibration.conf: it has bytes that no text has"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_files(damage, conf):
    text, message = DAMAGED[damage]
    conf.write_bytes(text.encode())
    with pytest.raises(FileError, match=message) as error:
        Conf.read(conf)
    assert str(conf) in str(error.value)


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("calibration_status = 2 # 0", ""),
        ("calibration_status = 1 # 0", "1"),
        ("calibration_status=0;", "0"),
        ("# calibration_status = 1 0", ""),
    ],
)
def test_whether_a_calibration_is_linearised(conf, line, status):
    conf.write_text(CONF.replace("calibration_status = 2 # 0", line))
    assert Conf.read(conf).status == status


# kinematics.yaml


CHAIN = rows(WITH_DELTAS[1]["full_dh"]).chain()
HASH = "calib_4455573973530731233"


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "kinematics.yaml"
    path.write_bytes(kinematics_bytes(CHAIN, HASH, "One arm."))
    return path


def test_what_is_written_reads_back(written):
    back = read_kinematics(written)
    np.testing.assert_allclose(back.chain[:6], CHAIN[:6], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(back.chain[6], np.eye(4))
    assert back.hash == HASH


def test_small_numbers_are_numbers_to_every_reader(tmp_path):
    nominal = ur_model("UR3").nominal
    small = FullDH([1e-5] * 6, [1e-5, *nominal.a[1:]], nominal.d, nominal.alpha)
    path = tmp_path / "k.yaml"
    path.write_bytes(kinematics_bytes(small.chain(), HASH))
    assert "1.0e-05" in path.read_text()
    assert yaml.safe_load(path.read_text())["kinematics"]["upper_arm"]["x"] == pytest.approx(1e-5)
    # A file by another program may have them without the point, and is understood.
    path.write_text(path.read_text().replace("1.0e-05", "1e-05"))
    assert read_kinematics(path).chain[1, 0, 3] == pytest.approx(1e-5)


def test_universal_robots_own_spelling(tmp_path):
    path = tmp_path / "default_kinematics.yaml"
    text = "kinematics:\n"
    values = {
        "shoulder": (0, 0, "0.23630000000000001", "-0", 0, "-0"),
        "upper_arm": (0, 0, 0, 1.570796327, 0, "-0"),
        "forearm": (-0.637, 0, 0, "-0", 0, "-0"),
        "wrist_1": (-0.5037, 0, "0.20100000000000001", "-0", 0, "-0"),
        "wrist_2": (0, -0.1593, 0, 1.570796327, 0, "-0"),
        "wrist_3": (0, 0.1543, "-3.1647459019915597e-11", *["3.1415926535897931"] * 3),
    }
    values["wrist_3"] = (*values["wrist_3"][:3], "1.5707963265897931", *values["wrist_3"][4:])
    for link, numbers in values.items():
        text += f"  {link}:\n"
        for key, number in zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True):
            text += f"    {key}: {number}\n"
    path.write_text(text + "  hash: calib_12001109639981648826")
    content = read_kinematics(path)
    np.testing.assert_allclose(content.chain, ur_model("UR30").nominal.chain(), rtol=0, atol=1e-9)
    assert content.hash == ur_model("UR30").default_hash
    turned = text.replace("roll: 1.570796327", "roll: !degrees 90")
    path.write_text(turned.replace("roll: 1.5707963265897931", "roll: !radians 1.5707963265897931"))
    assert "!radians" in path.read_text()
    content = read_kinematics(path)
    np.testing.assert_allclose(content.chain, ur_model("UR30").nominal.chain(), rtol=0, atol=1e-9)
    assert content.hash is None


def damaged(old: str, new: str, count: int = -1):
    return lambda text: text.replace(old, new, count)


DAMAGED_YAML = {
    "other": (lambda _: "kinematic: {}\n", r"no 'kinematics' in it \(did you mean 'kinematic'\?\)"),
    "null": (lambda _: "kinematics:\n", r"kinematics has no keys with values"),
    "link": (damaged("forearm", "fore_arm"), r"no forearm \(did you mean 'fore_arm'\?\)"),
    "number": (damaged("z: 0.152", "z: 0,152"), r"z of 'shoulder' is '0,152.*\[m\] is"),
    "nan": (damaged("z: 0.152", "z: .nan #"), r"z of 'shoulder' is 'nan'; a finite number"),
    "truth": (damaged("z: 0.152", "z: true #"), r"z of 'shoulder' is 'True'"),
    "mm": (damaged("z: 0.152", "z: 152.2 #"), r"z of 'shoulder' is 152.2, more than 10 m"),
    "deg": (damaged("roll: 1.57", "roll: 90 #", 1), r"roll of 'upper_arm' is 90, more than 12.57"),
    "twice": (damaged("  forearm:", "  shoulder:"), r"line 17, .*'shoulder' stands twice"),
    "hash": (damaged(HASH, "a b"), r"the hash is 'a b', not one word of text such as 'calib_"),
}


@pytest.mark.parametrize("damage", DAMAGED_YAML)
def test_damaged_yaml_files(damage, written):
    change, message = DAMAGED_YAML[damage]
    written.write_text(change(written.read_text()))
    with pytest.raises(FileError, match=message) as error:
        read_kinematics(written)
    assert str(written) in str(error.value)


@pytest.mark.parametrize("hash", ["null", "~", "", "''"])
def test_a_hash_that_is_nothing_is_none(hash, written):
    written.write_text(written.read_text().replace(HASH, hash))
    assert read_kinematics(written).hash is None


@pytest.mark.parametrize("hash_", ["", "a b", "x\ny", "calib_1 # 2", "null", "true", "-1", "1.5"])
def test_a_hash_that_is_none(hash_):
    with pytest.raises(FileError, match=r"is none of a calibration: one such as"):
        kinematics_bytes(CHAIN, hash_)

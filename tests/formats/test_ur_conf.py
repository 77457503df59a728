from __future__ import annotations

import numpy as np
import pytest

from calib.errors import FileError
from calib.formats.ur_conf import (
    not_linearised,
    other_keys,
    read_deltas,
    read_nominal,
    update_deltas,
    write_deltas,
)
from calib.formats.ur_dh import COLUMNS, FullDH
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
    deltas = read_deltas(conf)
    assert deltas.theta.tolist() == [2.5e-08, -0.25, 6.5, 0.0125, -6.5e-08, -7e-07]
    assert deltas.d.tolist() == [0.00022, -204.07, 203.39, 0.68, -0.00012, -0.00013]
    assert deltas.alpha.tolist() == [0.00026, 0.00047, 0.0073, 0.00025, 0.0018, 0.0]
    assert other_keys(conf) == ("joint_checksum", "calibration_status")


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
    assert read_deltas(conf).a[1] == 0.0111
    conf.write_text(CONF.replace("[mounting]", "  [ mounting ]  # of the arm"))
    assert read_deltas(conf).a[1] == 0.0111


def test_written_deltas_read_back_exactly(tmp_path):
    path = write_deltas(tmp_path / "new.conf", DELTAS)
    back = read_deltas(path)
    for name in COLUMNS:
        assert (getattr(back, name) == getattr(DELTAS, name)).all()
    with pytest.raises(FileError, match="exists already"):
        write_deltas(path, DELTAS)


def test_what_could_not_be_read_again_is_not_written(conf, tmp_path):
    far = FullDH(DELTAS.theta, DELTAS.a, np.full(6, 2e9), DELTAS.alpha)
    with pytest.raises(FileError, match=r"delta_d of joint 1 is 2e\+09, more than 1e\+09 m"):
        write_deltas(tmp_path / "new.conf", far)
    with pytest.raises(FileError, match=r"delta_d of joint 1 is 2e\+09, more than 1e\+09 m"):
        update_deltas(conf, tmp_path / "new.conf", far)
    assert not (tmp_path / "new.conf").exists()


def test_a_list_over_several_lines_with_comments_between(conf):
    text = CONF.replace("203.39,\n", "203.39, # of ] joint 3\n # [ 1, 2 ]\n")
    conf.write_text(text)
    assert read_deltas(conf).d[2] == 203.39
    update_deltas(conf, conf, DELTAS, overwrite=True)
    assert (read_deltas(conf).d == DELTAS.d).all()


def test_an_update_keeps_every_other_byte(conf, tmp_path):
    conf.write_bytes(CONF.replace("\n", "\r\n").encode() + b"name = caf\xe9\r\n")
    before = conf.read_bytes()
    path = update_deltas(conf, tmp_path / "new.conf", DELTAS)
    after = path.read_bytes()
    back = read_deltas(path)
    for name in COLUMNS:
        assert (getattr(back, name) == getattr(DELTAS, name)).all()
    kept = [line for line in before.splitlines() if not line.startswith((b"delta_", b"   0.68"))]
    assert [line for line in after.splitlines() if not line.startswith(b"delta_")] == kept
    assert b"] # rad\r\n" in after
    assert b"]   ; a list may go on\r\n" in after
    assert conf.read_bytes() == before


def test_a_section_that_comes_again(conf):
    again = "[mounting]\ndelta_a = [ 0.00014, 0.0111, -7.2e-05, 0.00019, 1.5e-06, 0]\n"
    conf.write_text(CONF + "[other]\ndelta_a = 3\n" + again)
    assert read_deltas(conf).a[1] == 0.0111
    new = FullDH(DELTAS.theta, np.full(6, 0.5), DELTAS.d, DELTAS.alpha)
    update_deltas(conf, conf, new, overwrite=True)
    assert conf.read_text().count("delta_a = [ 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]") == 2
    assert (read_deltas(conf).a == 0.5).all()
    assert "[other]\ndelta_a = 3\n" in conf.read_text()


DAMAGED = {
    "empty": ("", r"there is no \[mounting\] in it, it has no section"),
    "section": (CONF.replace("[mounting]", "[mount]"), r"no \[mounting\] .* 'mount'"),
    "key": (
        CONF.replace("delta_alpha", "delta_alfa"),
        r"has no delta_alpha \(did you mean 'delta_alfa'\?",
    ),
    "equals": (CONF.replace("delta_a =", "delta_a"), r"has no delta_a"),
    "five": (
        CONF.replace("1.5e-06, 0]", "1.5e-06]"),
        r"line 4: delta_a is .* six numbers in brackets",
    ),
    "text": (CONF.replace("0.0111", "zero"), r"line 4: delta_a of joint 2 is 'zero'; .* \[m\]"),
    "nan": (CONF.replace("-0.25", "nan"), r"line 3: delta_theta of joint 2 is 'nan'; .* \[rad\]"),
    "inf": (CONF.replace("0.0073", "inf"), r"delta_alpha of joint 3 is 'inf'"),
    "huge": (CONF.replace("0.0111", "1e999"), r"delta_a of joint 2 is '1e999'; a finite"),
    "hole": (CONF.replace("0.0111,", ","), r"delta_a of joint 2 is ''"),
    "no list": (
        CONF.replace("[ 0.00014, 0.0111, -7.2e-05, 0.00019, 1.5e-06, 0]", "1"),
        r"'1'; a l",
    ),
    "open": (
        CONF.replace("1.5e-06, 0]", "1.5e-06, 0"),
        r"line 4: delta_a is '\[ 0.00014.*brackets",
    ),
    "open, the first": (
        CONF.replace("-7.0e-07] # rad", "-7.0e-07 # rad"),
        r"line 3: delta_theta is '\[ 2.5e-08.*a list of six numbers in brackets, one",
    ),
    "mm": (CONF.replace("0.0111", "11.1"), r"joint 2 is 11.1, more than 10 m: .* metres"),
    "deg": (CONF.replace("0.0073", "0.73"), r"alpha of joint 3 is 0.73, more than 0.5 rad"),
    "twice": (CONF + "delta_a = [1, 0, 0, 0, 0, 0]\n", r"two values, in line 4 and in line 10"),
    "binary": (CONF + "\0", r"not a calibration.conf: it has bytes that no text has"),
    "cut": (CONF[: CONF.index("-204")], r"\[mounting\] has no delta_alpha; a calibration"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_files(damage, conf, tmp_path):
    text, message = DAMAGED[damage]
    conf.write_bytes(text.encode())
    with pytest.raises(FileError, match=message) as error:
        read_deltas(conf)
    assert str(conf) in str(error.value)
    with pytest.raises(FileError, match=message):
        update_deltas(conf, tmp_path / "new.conf", DELTAS)
    assert not (tmp_path / "new.conf").exists()


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
    assert not_linearised(conf) == status

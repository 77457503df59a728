from __future__ import annotations

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calib.errors import FileError
from calib.formats.ur_dh import FullDH
from calib.formats.ur_models import LINKS, ur_model
from calib.formats.ur_yaml import read_yaml, write_yaml
from tests.formats.ur_cases import WITH_DELTAS, rows

CHAIN = rows(WITH_DELTAS[1]["full_dh"]).chain()
HASH = "calib_4455573973530731233"


@pytest.fixture
def written(tmp_path):
    return write_yaml(tmp_path / "kinematics.yaml", CHAIN, HASH, ["One arm."])


def test_what_is_written_reads_back(written):
    back = read_yaml(written)
    np.testing.assert_allclose(back.chain[:6], CHAIN[:6], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(back.chain[6], np.eye(4))
    assert back.hash == HASH
    with pytest.raises(FileError, match="exists already"):
        write_yaml(written, CHAIN, HASH)


def test_another_reader_finds_the_same_placements_in_urdf_order(written):
    table = yaml.safe_load(written.read_text())["kinematics"]
    assert list(table) == [*LINKS, "hash"]
    for link, T in zip(LINKS, CHAIN, strict=False):
        values = table[link]
        assert all(type(value) is float for value in values.values())
        R = Rotation.from_euler("xyz", [values[k] for k in ("roll", "pitch", "yaw")]).as_matrix()
        np.testing.assert_allclose(R, T[:3, :3], rtol=0, atol=1e-9)
        np.testing.assert_array_equal([values[k] for k in "xyz"], T[:3, 3] + 0.0)


def test_small_numbers_are_numbers_to_every_reader(tmp_path):
    nominal = ur_model("UR3").nominal
    small = FullDH([1e-5] * 6, [1e-5, *nominal.a[1:]], nominal.d, nominal.alpha)
    path = write_yaml(tmp_path / "k.yaml", small.chain(), HASH)
    assert "1.0e-05" in path.read_text()
    assert yaml.safe_load(path.read_text())["kinematics"]["upper_arm"]["x"] == pytest.approx(1e-5)
    # A file by another program may have them without the point, and is understood.
    path.write_text(path.read_text().replace("1.0e-05", "1e-05"))
    assert read_yaml(path).chain[1, 0, 3] == pytest.approx(1e-5)


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
    content = read_yaml(path)
    np.testing.assert_allclose(content.chain, ur_model("UR30").nominal.chain(), rtol=0, atol=1e-9)
    assert content.hash == ur_model("UR30").default_hash
    turned = text.replace("roll: 1.570796327", "roll: !degrees 90")
    path.write_text(turned.replace("roll: 1.5707963265897931", "roll: !radians 1.5707963265897931"))
    assert "!radians" in path.read_text()
    content = read_yaml(path)
    np.testing.assert_allclose(content.chain, ur_model("UR30").nominal.chain(), rtol=0, atol=1e-9)
    assert content.hash is None


def damaged(old: str, new: str, count: int = -1):
    return lambda text: text.replace(old, new, count)


DAMAGED = {
    "tabs": (damaged("  forearm", "\tforearm"), r"line 17, .*cannot be read as YAML"),
    "empty": (lambda _: "", r"no 'kinematics' in it"),
    "other": (lambda _: "kinematic: {}\n", r"no 'kinematics' in it \(did you mean 'kinematic'\?\)"),
    "null": (lambda _: "kinematics:\n", r"kinematics has no keys with values"),
    "link": (damaged("forearm", "fore_arm"), r"no 'forearm' \(did you mean 'fore_arm'\?\)"),
    "key": (damaged("yaw", "yow", 1), r"'shoulder' has no 'yaw' \(did you mean 'yow'"),
    "number": (damaged("z: 0.152", "z: 0,152"), r"z of 'shoulder' is '0,152.*\[m\] is"),
    "nan": (damaged("z: 0.152", "z: .nan #"), r"z of 'shoulder' is 'nan'; a finite number"),
    "unit": (damaged("z: 0.152", "z: 0.152 m #"), r"z of 'shoulder' is '0.152 m'"),
    "truth": (damaged("z: 0.152", "z: true #"), r"z of 'shoulder' is 'True'"),
    "mm": (damaged("z: 0.152", "z: 152.2 #"), r"z of 'shoulder' is 152.2, more than 10 m"),
    "deg": (damaged("roll: 1.57", "roll: 90 #", 1), r"roll of 'upper_arm' is 90, more than 12.57"),
    "twice": (damaged("  forearm:", "  shoulder:"), r"line 17, .*'shoulder' stands twice"),
    "hash": (damaged(HASH, "a b"), r"the hash is 'a b', not one word of text such as 'calib_"),
    "hash number": (damaged(HASH, "-1"), r"the hash is '-1', not one word of text"),
    "tag": (damaged("yaw: ", "yaw: !grad "), r"line 9, .*tag '!grad'"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_files(damage, written):
    change, message = DAMAGED[damage]
    written.write_text(change(written.read_text()))
    with pytest.raises(FileError, match=message) as error:
        read_yaml(written)
    assert str(written) in str(error.value)


@pytest.mark.parametrize("hash", ["null", "~", "", "''"])
def test_a_hash_that_is_nothing_is_none(hash, written):
    written.write_text(written.read_text().replace(HASH, hash))
    assert read_yaml(written).hash is None


@pytest.mark.parametrize("hash_", ["", "a b", "x\ny", "calib_1 # 2", "null", "true", "-1", "1.5"])
def test_a_hash_that_is_none(hash_, tmp_path):
    with pytest.raises(FileError, match=r"is none of a calibration: one such as"):
        write_yaml(tmp_path / "k.yaml", CHAIN, hash_)
    assert not (tmp_path / "k.yaml").exists()


def test_a_chain_that_does_not_read_back_is_not_written(tmp_path):
    chain = np.array(CHAIN)
    chain[2, :3, :3] *= 1.001  # no rotation
    with pytest.raises(FileError, match=r"read back, the kinematics differ by .* not written"):
        write_yaml(tmp_path / "k.yaml", chain, HASH)
    assert not (tmp_path / "k.yaml").exists()

"""kinematics.yaml: its numbers are the chain's, and those that did not change stay digit for digit."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import FileError
from calib.robot.generated.universal_robots import chain_of_rows
from calib.verbs.convert.ur_arms import at_flange
from calib.verbs.convert.ur_yaml import kinematics_bytes, read_kinematics, read_numbers
from tests.verbs.convert.ur_cases import WITH_DELTAS, rows

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
        ("z: 0.152", "z: 152.2 #", "z of 'shoulder': '152.2' is no number up to 10"),
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


def test_numbers_that_are_rounding_are_zero_and_those_that_did_not_change_stay():
    numbers, _ = read_numbers("k.yaml", kinematics_bytes(CHAIN, OWN_HASH))
    assert not np.any((numbers != 0.0) & (np.abs(numbers) < 1e-12))
    own = numbers + 3e-13  # the same numbers, as another program wrote them
    moved = np.array(CHAIN)
    moved[2, 0, 3] += 1e-6
    found, _ = read_numbers("k.yaml", kinematics_bytes(moved, OWN_HASH, own))
    changed = np.argwhere(found != own).tolist()
    assert changed == [[2, 0]]
    assert found[2, 0] == pytest.approx(numbers[2, 0] + 1e-6, abs=1e-15)


def test_the_chain_reads_back(written):
    chain = at_flange(CHAIN)
    found, hash = read_kinematics(written, kinematics_bytes(chain, OWN_HASH))
    np.testing.assert_allclose(found[:6], chain[:6], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[6], np.eye(4))
    assert hash == OWN_HASH

"""The arms of Universal Robots by name: their rows, and their URDFs as others read them."""

from __future__ import annotations

import io

import numpy as np
import pytest
import yourdfpy

from calib.errors import ModelError
from calib.robot.ur_models import (
    MODELS,
    chain_of_rows,
    ur_model,
    ur_urdf,
)


def test_names_whatever_their_capitals():
    assert ur_model("ur_5 E").name == "UR5e"
    with pytest.raises(ModelError, match="'UR6' is not an arm"):
        ur_model("UR6")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_flange_of_the_urdf_is_that_of_the_rows(model):
    urdf = yourdfpy.URDF.load(io.BytesIO(ur_urdf(model)), load_meshes=False)
    at_flange = urdf.get_transform("tool0", "base")
    by_rows = np.eye(4)
    for T in chain_of_rows(model.rows):
        by_rows = by_rows @ T
    np.testing.assert_allclose(at_flange, by_rows, rtol=0, atol=1e-12)

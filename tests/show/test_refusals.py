"""What views and figures refuse, in full: what was given, what is allowed, the fix."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import CalibError, FileError, ModelError
from calib.show.figure_base import check_kind
from calib.show.view import View
from calib.show.viewer import Viewer


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def test_a_kind_of_figure_that_is_not_written():
    with refused(
        FileError, "Figures cannot be written as 'gif'; choose one of 'png', 'svg', 'pdf'."
    ):
        check_kind("gif")


def test_a_view_that_starts_behind_its_last_pose(ur3_view):
    with refused(ModelError, "start is 35, and there are 35 poses; give a number from 0 to 34."):
        replace(ur3_view, start=35)


def test_a_pose_of_too_few_joints(gantry):
    with (
        Viewer(View(gantry, None, np.zeros((1, 3)))) as viewer,
        refused(
            ModelError,
            "q has shape (2,); give a finite value for each joint, [rad] or [m]: 'x', 'y', 'c'.",
        ),
    ):
        viewer.display([0.0, 0.0])

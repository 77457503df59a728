"""Evaluations of the tests' images by a camera on the hand, with residuals of known sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.channels import Channels
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.verbs.evaluate.evaluation import Evaluation
from tests.images import BOARD, arm, cell, poses, table

#: Corners of an image.
CORNERS = len(BOARD.corners)


def evaluation(images=4, size=0.0, robot=None):
    """Residuals of (size, 0) px in the first image, twice that in the second, and so on."""
    m = table(poses(images))
    rows, setup = rows_and_setup(arm(), m, cell())
    registered = register(arm().poses(rows.joints), setup, rows)
    residual = np.zeros((len(m), 2))
    residual[:, 0] = size * (1 + np.arange(len(m)) // CORNERS)
    channels = Channels.of_unit(residual > -1, "px")
    return Evaluation(robot or arm(), m, registered, (), residual, channels)


def without_images(e):
    """The same corners without names of images."""
    return replace(e, measurements=replace(e.measurements, images=()))

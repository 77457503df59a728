"""Sentences of reasons of verdicts on calibrations with a camera."""

from __future__ import annotations

from collections.abc import Mapping

from calib.diagnosis.reasons import Why

#: The sentence of each code; see `calib.show.verdict.SENTENCES`.
OF_IMAGES: Mapping[Why, str] = {
    Why.CAMERA_ON_OTHER_LINK: "The nominal robot is {given_m:mm.0f} mm rms off, far more than an uncalibrated arm, but "
    "only {error_m:mm.1f} mm if '{tip}' carries the camera and '{base}' the board: exchange --camera-on and --board-on"
    ".",
    Why.SENSE_REVERSED: "The images fit far better if '{joint}' counts the other way ({error_m:mm.1f} mm "
    "instead of {given_m:mm.1f} mm): check its positive direction in the table and in the URDF.",
    Why.SENSE_UNKNOWN: "These poses do not tell in which direction a joint counts: with the sign of "
    "{joints} reversed the images fit as well. Check it by hand, and turn this joint by 60 deg or more while "
    "others are elsewhere.",
    Why.FOCAL_LENGTH_OFF: "The focal length seems to be {share:%+.2f} % off what was stated (standard "
    "deviation {std:%.2f} %): {if_exact}are the intrinsics of this camera, resolution and focus?",
    Why.BOARD_SCALE_OFF: "The board seems to be {share:%+.2f} % off its stated size (standard deviation "
    "{std:%.2f} %), and all lengths of the arm with it: {if_exact}measure the printed squares, many of them at once, "
    "correct square_mm, and run calib detect again.",
    Why.COVARIANCES_IDLE: "The stated covariances tell nothing of the errors of the poses (their scale is "
    "{scale:.2g}): are they of these rows, in the order x, y, z, turns about x, y, z, in m and rad, along the axes of "
    "the measurement frame? Or does the robot miss its stops by far more?",
    Why.BOARD_HEAD_ON: "The board was always seen head on, tilted by {tilt_rad:deg.0f} deg at most: such "
    "images hardly tell focal length from distance. Add images with the board tilted by 30 to 45 deg, to all sides.",
    Why.FEW_CORNERS: "{images} of {all} images show fewer than {corners} corners: their poses are rough, "
    "however well they fit. Bring the whole board into view, near enough to fill the image.",
    Why.ONE_AXIS: "The hand turned about one axis only, by {across_rad:deg.1f} deg about others: the camera's "
    "place along that axis stays open. Turn it about two axes, by 30 deg or more.",
    Why.CAMERA_TOO_ROUGH: "This camera cannot tell: what it can improve is less than what it cannot see. "
    "Come nearer with the camera, take more images, or borrow a laser tracker.",
}

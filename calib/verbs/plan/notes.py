"""Notes of a plan: codes and values of what a person must know of it."""

from __future__ import annotations

from typing import Literal, NamedTuple

Code = Literal[
    "generic_target",  # no target was given: planned for one at a general place, x y z [m]
    "orientation_noise",  # the noise of an orientation was assumed [rad]
    "camera_assumed",  # nothing is known of the lens: planned for one with this focal length [px]
    "image_noise",  # the noise of an image coordinate was assumed [px]
    "board_scale",  # most of the error is from the scale of the print: its std, and the rms without it [m]
    "one_side_hides",  # poses are approached from one side, and the model has lost motion
    "reflector_not_checked",  # a reflector, and no tracker that it must face
    "collisions_not_checked",
    "images_checked",  # camera and board were checked with the robot: the names of boxes and plane around
    "collisions_checked",  # the holder's radius [m], and the names of boxes and plane around
    "no_geometry",  # links that were not checked, or not all of them
    "always_close",  # pairs that are always closer than the clearance, and refused only where they touch
    "always_touching",  # pairs that were not checked
]


class Note(NamedTuple):
    """Remark on a plan; `calib.verbs.plan.text` makes a sentence of it."""

    #: Word for what is remarked.
    code: Code
    #: In SI units, as listed at the code.
    values: tuple[str | float, ...] = ()

"""What a person must know of a plan: codes and values, which `calib.text.plan` makes sentences of."""

from __future__ import annotations

from typing import Literal, NamedTuple

Code = Literal[
    "generic_target",  # no target was given: planned for one at a general place, x y z [m]
    "orientation_noise",  # the noise of an orientation was assumed [rad]
    "reflector_not_checked",  # a reflector, and no tracker that it must face
    "collisions_not_checked",
    "collisions_checked",  # the holder's radius [m], and what stands around
    "floor_not_checked",
    "no_geometry",  # links that were not checked, or not all of them
    "visual_geometry",  # links that were checked by their visuals
    "always_close",  # pairs that are always closer than the clearance, and refused only where they touch
    "always_touching",  # pairs that were not checked
]


class Note(NamedTuple):
    """A code and its values."""

    code: Code
    values: tuple[str | float, ...] = ()

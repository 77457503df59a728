"""The kinds of measurement: what a row of each kind measures, and what its text says."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from calib.errors import MeasurementError, choices

#: ``point``: the target's position. ``pose``: its position and orientation. ``distance``: its distance to an
#: anchor, one unknown point of the group. ``pair``: the distance between the targets of two rows. ``fixed``: the
#: target sits at one unknown point of the group. ``plane``: the target touches one unknown plane of the group.
KINDS = ("point", "pose", "distance", "pair", "fixed", "plane")

#: The kinds that measure a position, those that measure a length.
POSITIONS = ("point", "pose")
LENGTHS = ("distance", "pair")

#: The blocks of number columns, see `calib.measure.layout`, that a row of each kind uses beside those of every row.
USES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "point": ("points",),
        "pose": ("points", "orientation", "sigma_angle"),
        "distance": ("distance",),
        "pair": ("distance",),
        "fixed": (),
        "plane": (),
    }
)

#: With fewer rows in a group the unknown point, or plane, fits whatever the robot does.
FEWEST: Mapping[str, int] = MappingProxyType({"fixed": 2, "plane": 4})


def check_kind(kind: str) -> None:
    """Refuse the name of a kind that there is not.

    Raises:
        MeasurementError: the text names those there are.
    """
    if kind not in KINDS:
        message = f"'{kind}' is not a kind of measurement; allowed are {choices(KINDS)}"
        raise MeasurementError(message)

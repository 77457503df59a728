"""Dictionaries of square markers: how many each has and of how many bits, named as OpenCV names them.

The markers themselves are in OpenCV; their number is enough to check the description of a board. OpenCV also makes
dictionaries of any size from a seed (``extendDictionary``, ``generateCustomDictionary``). Their names say how:

    DICT_5X5_30_SEED_7                        30 markers of 5 x 5 bits, randomSeed 7
    DICT_5X5_80_SEED_7_FROM_DICT_5X5_50       the same after the 50 markers of another dictionary: 80 in all
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

from calib.boards.opencv import opencv
from calib.errors import CalibError, choices, did_you_mean


@dataclass(frozen=True, slots=True)
class Dictionary:
    """A dictionary of markers."""

    #: Bits along a side, without the black border of one bit.
    bits: int
    #: Number of markers; their ids are 0 to one less than this.
    markers: int


#: All dictionaries that OpenCV has, by name, the common ones first.
DICTIONARIES: Mapping[str, Dictionary] = MappingProxyType(
    {
        "DICT_4X4_50": Dictionary(4, 50),
        "DICT_4X4_100": Dictionary(4, 100),
        "DICT_4X4_250": Dictionary(4, 250),
        "DICT_4X4_1000": Dictionary(4, 1000),
        "DICT_5X5_50": Dictionary(5, 50),
        "DICT_5X5_100": Dictionary(5, 100),
        "DICT_5X5_250": Dictionary(5, 250),
        "DICT_5X5_1000": Dictionary(5, 1000),
        "DICT_6X6_50": Dictionary(6, 50),
        "DICT_6X6_100": Dictionary(6, 100),
        "DICT_6X6_250": Dictionary(6, 250),
        "DICT_6X6_1000": Dictionary(6, 1000),
        "DICT_7X7_50": Dictionary(7, 50),
        "DICT_7X7_100": Dictionary(7, 100),
        "DICT_7X7_250": Dictionary(7, 250),
        "DICT_7X7_1000": Dictionary(7, 1000),
        "DICT_APRILTAG_16h5": Dictionary(4, 30),
        "DICT_APRILTAG_25h9": Dictionary(5, 35),
        "DICT_APRILTAG_36h11": Dictionary(6, 587),
        "DICT_APRILTAG_36h10": Dictionary(6, 2320),
        "DICT_ARUCO_ORIGINAL": Dictionary(5, 1024),
        "DICT_ARUCO_MIP_36h12": Dictionary(6, 250),
    }
)

#: The dictionaries of each kind, the smallest first. A large one begins with the markers of the smaller ones: the first
#: 50 of DICT_5X5_1000 are those of DICT_5X5_50.
KINDS: tuple[tuple[str, ...], ...] = (
    ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000"),
    ("DICT_5X5_50", "DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000"),
    ("DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250", "DICT_6X6_1000"),
    ("DICT_7X7_50", "DICT_7X7_100", "DICT_7X7_250", "DICT_7X7_1000"),
    ("DICT_ARUCO_ORIGINAL",),
    ("DICT_APRILTAG_36h11",),
    ("DICT_APRILTAG_36h10",),
    ("DICT_APRILTAG_25h9",),
    ("DICT_APRILTAG_16h5",),
    ("DICT_ARUCO_MIP_36h12",),
)


#: The name of a dictionary made by OpenCV.
_MADE = re.compile(r"DICT_([0-9]+)X\1_([0-9]+)_SEED_([0-9]+)(?:_FROM_(DICT_\w+))?")

#: Fewest and most bits along a side of a marker that is made, and the most markers.
_BITS = (3, 8)
_MOST_MARKERS = 2000


def dictionary_of(name: str) -> Dictionary | None:
    """Return a dictionary by its name, or by that of one that OpenCV makes; None if there is none of this name."""
    if name in DICTIONARIES:
        return DICTIONARIES[name]
    made = _MADE.fullmatch(name)
    if made is None:
        return None
    bits, markers = int(made[1]), int(made[2])
    base = DICTIONARIES.get(made[4]) if made[4] else Dictionary(bits, 0)
    is_possible = _BITS[0] <= bits <= _BITS[1] and 1 <= markers <= _MOST_MARKERS
    if base is None or base.bits != bits or base.markers >= markers or not is_possible:
        return None
    return Dictionary(bits, markers)


@cache
def opencv_dictionary(name: str) -> Any:  # noqa: ANN401  a value without types
    """Return OpenCV's dictionary of markers by its name.

    Args:
        name: A name of `DICTIONARIES`, or of a dictionary that OpenCV makes.

    Raises:
        CalibError: There is no such dictionary, or this version of OpenCV does not have it, or is not installed.
    """
    cv2 = opencv()
    made = _MADE.fullmatch(name)
    if dictionary_of(name) is None or not (made or hasattr(cv2.aruco, name)):
        raise CalibError(
            f"OpenCV {cv2.__version__} has no dictionary of markers '{name}'; a newer one may: pip install "
            "--upgrade opencv-python-headless"
        )
    if made is None:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    bits, markers, seed = (int(made[k]) for k in (1, 2, 3))
    base = opencv_dictionary(made[4]) if made[4] else cv2.aruco.Dictionary()
    return cv2.aruco.extendDictionary(markers, bits, base, seed)


def kind_of(dictionary: str) -> tuple[str, ...]:
    """Return the dictionaries whose first markers are those of a dictionary, itself included, the smallest first."""
    return next((kind for kind in KINDS if dictionary in kind), (dictionary,))


def smallest_dictionary(kind: tuple[str, ...], largest_id: int) -> str:
    """Return the smallest dictionary of a kind that has a marker with this id; the largest if none has."""
    for name in kind:
        if largest_id < DICTIONARIES[name].markers:
            return name
    return kind[-1]


def check_markers(name: str, first: int, count: int, where: str) -> None:
    """Refuse markers that a dictionary does not have.

    Args:
        name: Name of the dictionary.
        first: Id of the first marker.
        count: Number of markers, with ids in sequence.
        where: Begins the message of an error: what needs the markers.

    Raises:
        CalibError: There is no such dictionary, or it is too small.
    """
    dictionary = dictionary_of(name)
    if dictionary is None:
        raise CalibError(
            f"{where} has markers of '{name}'; the dictionaries are "
            f"{choices(DICTIONARIES, len(DICTIONARIES))}{did_you_mean(name, DICTIONARIES)}, and those that OpenCV "
            "makes by size and seed, such as DICT_5X5_30_SEED_7, or DICT_5X5_80_SEED_7_FROM_DICT_5X5_50."
        )
    if first >= 0 and first + count <= dictionary.markers:
        return
    message = (
        f"{where} needs {count} markers, the first with the id {first}; {name} has {dictionary.markers}, "
        "the first with the id 0."
    )
    enough = [row for row, other in DICTIONARIES.items() if other.markers >= first + count]
    alike = [row for row in enough if DICTIONARIES[row].bits == dictionary.bits]
    if first >= 0 and enough:
        message += f" Large enough are {choices(alike or enough)}."
    raise CalibError(message)

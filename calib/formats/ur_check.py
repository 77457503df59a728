"""Of which arm a file of Universal Robots is: what says so, and whether its numbers agree with it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import FileError, ModelError, choices
from calib.formats.ur_files import read_nominal
from calib.formats.ur_models import MODELS, NAMES, TOLERANCE, UrModel, ur_model
from calib.formats.ur_mount import FARTHEST, distance_from, the_mount
from calib.model.robot import Robot

PathLike = str | os.PathLike[str]
Array = NDArray[np.float64]

ChainOf = Callable[[UrModel], Array]
"""The chain that a file makes of an arm, shape (7, 4, 4), [m]; of a yaml it is the same for every arm."""

#: A calibration that moves the flange further is odd, and beyond the other it is worth looking whether the file fits
#: another arm [m].
_ODD, _SUSPECT = 0.02, 0.01

#: Hashes as the ROS driver makes them.
_HASH = re.compile(r"calib_[0-9]+")


@dataclass(frozen=True, slots=True)
class Given:
    """What was given beside a file to say of which arm it is.

    Attributes:
        urcontrol: The controller's ``urcontrol.conf``.
        model: The arm, or its name.
        robot: The nominal robot.
    """

    urcontrol: PathLike | None
    model: UrModel | str | None
    robot: Robot | None

    @property
    def nothing(self) -> bool:
        """Whether nothing was."""
        return self.urcontrol is None and self.model is None and self.robot is None

    @property
    def named(self) -> str:
        """The options that said it."""
        options = [("--robot", self.robot), ("--ur-model", self.model)]
        return " and ".join(option for option, value in options if value is not None)

    @property
    def advice(self) -> str:
        """What to do about a file of another arm."""
        if self.urcontrol is not None:
            return f"Give the urcontrol.conf of the same controller; {self.urcontrol} is another one's."
        if self.robot is not None:
            return f"Give the URDF of the right one; {self.robot.urdf.source} is another one's."
        return "Name the right one with --ur-model, or give its URDF."

    def arm(self, path: PathLike) -> UrModel:
        """The arm that a file is of.

        Raises:
            FileError: The ``urcontrol.conf`` cannot be read.
            ModelError: Nothing was given, the model is not known, or two of them do not agree.
        """
        given = None if self.model is None else ur_model(self.model)
        if self.urcontrol is not None:
            rows = read_nominal(self.urcontrol)
            named = [one.name for one in MODELS if one.same(rows)]
            if given is not None and not given.same(rows):
                is_what = (
                    f"those of the {' or '.join(named)}" if named else "no arm's that is known"
                )
                raise ModelError(
                    f"The rows in [DH] of {self.urcontrol} are {is_what}, not those of the {given.name}. Leave the "
                    "name of the arm out, or give the urcontrol.conf of this robot's own controller."
                )
            name = (
                given.name
                if given
                else named[0]
                if named
                else f"arm of {Path(self.urcontrol).name}"
            )
            return UrModel(name, rows)
        if self.robot is not None:
            return the_mount(self.robot, given)[0]
        if given is None:
            raise ModelError(
                f"{path}: a calibration.conf has only what is added to the nominal rows. Say of which arm it is "
                f"({choices(NAMES, limit=40)}), or give its urcontrol.conf or its URDF."
            )
        return given


def nearest(chain: Array) -> UrModel:
    """The arm whose nominal kinematics are nearest to a chain."""
    return min(MODELS, key=lambda one: distance_from(chain, one))


def checked_distance(path: PathLike, arm: UrModel, chain_of: ChainOf, advice: str) -> float:
    """How far a calibration moves the flange [m], which tells arms of other sizes.

    The deltas of an arm move its own flange by some millimetres, and that of another one by centimetres: what nearly
    parallel axes 2 and 3 do to each other cancels for the right length of the upper arm only.

    Args:
        path: The file.
        arm: The arm that it is said to be of.
        chain_of: What it makes of an arm.
        advice: What to do if it is of another one, as a sentence.

    Raises:
        FileError: It fits another arm, or moves the flange so far that it is of none.
    """
    moved = distance_from(chain_of(arm), arm)
    if moved > _SUSPECT:
        by_arm = {one: distance_from(chain_of(one), one) for one in MODELS}
        least = min(by_arm.values())
        if 3.0 * least < moved:
            names = [one.name for one, distance in by_arm.items() if distance <= 1.5 * least]
            raise FileError(
                f"{path}: this calibration moves the flange of {arm.said} by up to {1e3 * moved:.0f} mm, and that of "
                f"{choices(names)} by {1e3 * least:.1f} mm only. A calibration moves it by millimetres: the file is "
                f"of another arm. {advice}"
            )
    if moved > FARTHEST:
        raise FileError(
            f"{path}: these kinematics put the flange up to {moved:.2f} m from where that of a nominal {arm.name} is; "
            f"a calibration moves it by millimetres. Check that the file is of {arm.said}, in metres and radians."
        )
    return moved


def odd(path: PathLike, moved: float, arm: UrModel) -> tuple[str, ...]:
    """A sentence about a calibration that moves the flange further than one does."""
    if moved < _ODD:
        return ()
    return (
        f"{path} moves the flange by up to {1e3 * moved:.0f} mm from the nominal {arm.name}, more than calibrations "
        "do: check that it is of this arm.",
    )


def fits_others(
    path: PathLike, arm: UrModel, chain_of: ChainOf, moved: float, taken_from: str
) -> tuple[str, ...]:
    """A sentence about the other arms that deltas fit as well, which nothing in them tells apart.

    Args:
        path: The file.
        arm: The arm that it is taken to be of.
        chain_of: What it makes of an arm.
        moved: How far it moves the flange of that arm [m].
        taken_from: What said which arm it is.
    """
    most = max(_SUSPECT, 3.0 * moved)
    fitting = [one for one in MODELS if distance_from(chain_of(one), one) <= most]
    apart = max((distance_from(one.nominal.chain(), arm) for one in fitting), default=0.0)
    if apart < TOLERANCE:
        return ()
    return (
        f"The deltas in {path} fit {choices(one.name for one in fitting)} alike: that it is {arm.said} is taken from "
        f"{taken_from}. Taken for the wrong one of these, the flange is up to {1e3 * apart:.0f} mm off. The "
        "controller's urcontrol.conf (--urcontrol) has the rows that are right.",
    )


def hash_remarks(path: PathLike, hash: str) -> tuple[str, ...]:
    """Sentences about a hash that is no robot's own, or of another form than the ROS driver's."""
    names = [one.name for one in MODELS if one.default_hash == hash]
    if names:
        return (
            f"{path} has the hash of the nominal {' or '.join(names)}: it is of no particular robot.",
        )
    if not _HASH.fullmatch(hash):
        return (
            f"The hash '{hash}' in {path} is not of the driver's form, such as 'calib_12788084448423163542': the "
            "driver will not find it equal to the controller's.",
        )
    return ()

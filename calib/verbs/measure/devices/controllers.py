"""Controllers: how a session learns where the robot stands; yours is one more.

A controller is named on the command line with its address, ``--controller rtde:192.168.0.5``. Its entry opens a robot:
an object that is asked for the joint values. calib reads only; it does not move a robot.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

import calib.basics.plugins as plugins
from calib.basics.arrays import Array
from calib.errors import DeviceError, choices
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.devices.rtde import RtdeController
from calib.verbs.measure.devices.typed import TypedController
from calib.verbs.measure.devices.virtual import virtual_robot

__all__ = [
    "CONTROLLERS",
    "Context",
    "Controller",
    "JointSource",
    "joints_at_rest",
    "open_controller",
    "register",
]

#: A robot stands still if no joint moves by more within `_APART` [rad or m]: 0.001 deg.
_STILL = math.radians(0.001)

#: Time between two looks at a robot that should stand still [s].
_APART = 0.2


class JointSource(Protocol):
    """A robot that is connected."""

    def joints(self) -> Array:
        """Return the joint values now, shape (m,), [rad] or [m], in the order of the chain; DeviceError without any."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...


@dataclass(frozen=True, slots=True)
class Controller:
    """A way to connect a robot."""

    #: What it is, for help texts: ``"robots of Universal Robots"``.
    words: str
    #: Opens it: from what stands after the name on the command line, perhaps empty, and from the context.
    open: Callable[[str, Context], JointSource]


#: The controllers by name.
CONTROLLERS: dict[str, Controller] = {
    "typed": Controller("joint values of the proposed pose, or as typed", TypedController),
    "virtual": Controller("a robot that stands where it is proposed, to rehearse", virtual_robot),
    "rtde": Controller("a robot of Universal Robots, rtde:192.168.0.5", RtdeController),
}

plugins.watch("controllers", CONTROLLERS)


def register(name: str, controller: Controller) -> None:
    """Add a controller, which sessions can then name.

    Args:
        name: Its name, which no other controller has, without a colon.
        controller: What it is, and how it is opened.

    Raises:
        DeviceError: The name is taken or has a colon.
    """
    if name in CONTROLLERS or ":" in name or not name:
        raise DeviceError(
            f"The controller '{name}' needs a name without a colon, other than {choices(CONTROLLERS, 60)}."
        )
    CONTROLLERS[name] = controller


def open_controller(text: str, context: Context) -> JointSource:
    """Connect to a robot.

    Args:
        text: Name of a controller and its address, ``"rtde:192.168.0.5"``.
        context: What it may need to know of the session.

    Returns:
        The robot, to be closed by the caller.

    Raises:
        DeviceError: There is no such controller, or the robot does not answer.
    """
    name, _, argument = text.partition(":")
    if name not in CONTROLLERS:
        raise DeviceError(plugins.unknown("controllers", name, CONTROLLERS))
    return CONTROLLERS[name].open(argument, context)


def joints_at_rest(source: JointSource, timeout: float = 0.0) -> Array | None:
    """Return the joint values of a robot that stands still: twice the same within 0.001 deg, 0.2 s apart.

    Args:
        source: The robot.
        timeout: How long to wait for it to stand still [s]; 0: two looks.

    Returns:
        Joint values, shape (m,), [rad] or [m]; None if it moves.

    Raises:
        DeviceError: It does not answer.
    """
    deadline = time.monotonic() + timeout
    before = source.joints()
    while True:
        time.sleep(_APART)
        now = source.joints()
        if np.abs(now - before).max(initial=0.0) <= _STILL:
            return now
        if time.monotonic() >= deadline:
            return None
        before = now

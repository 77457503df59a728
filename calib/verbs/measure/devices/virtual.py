"""The virtual instrument and the virtual robot: simulations use sessions, so that these are imported when opened."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from calib.verbs.measure.devices.reading import Context

#: The module of both.
_MODULE = "calib.verbs.simulate.virtual_devices"


def virtual_instrument(argument: str, context: Context) -> Any:  # noqa: ANN401  of a module named here alone
    """Open the virtual instrument; see `calib.verbs.simulate.virtual_devices.VirtualReader`."""
    return import_module(_MODULE).VirtualReader(argument, context)


def virtual_robot(argument: str, context: Context) -> Any:  # noqa: ANN401  as above
    """Connect to the virtual robot; see `calib.verbs.simulate.virtual_devices.VirtualController`."""
    return import_module(_MODULE).VirtualController(argument, context)

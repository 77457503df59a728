"""Cameras and boards of a result: intrinsics and prints as estimated, with their uncertainty, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.arrays import Array
from calib.model.parameters import BOARD, CAMERA, Parameter
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.show.lines import number, plural

#: Decimals of a number of a lens, by its unit.
_DECIMALS = {"px": 1, "1": 4}

#: An internal of camera or board that was estimated, and its estimate.
_Estimated = tuple[Parameter, ParameterEstimate]


def optics_sentences(c: Calibration) -> list[str]:
    """Word the numbers of each camera, and the errors of each printed board, that were estimated.

    Args:
        c: The result.

    Returns:
        The sentences; none without cameras.
    """
    pairs = list(zip(c.model.parameters, c.parameters, strict=True))
    internal = [
        (parameter, estimate) for parameter, estimate in pairs if parameter.internal is not None
    ]
    sentences = []
    for family, word in ((CAMERA, _camera), (BOARD, _board)):
        of_family = [pair for pair in internal if pair[0].family == family]
        owners = dict.fromkeys(parameter.samples[0] for parameter, _ in of_family)
        for owner in owners:
            estimated = [pair for pair in of_family if pair[0].samples[0] == owner]
            sentences.append(word(estimated))
    return sentences


def _camera(estimated: Sequence[_Estimated]) -> str:
    """Word the numbers of one camera: the value, half its 95 % interval, and the change from what was given."""
    parts = []
    for parameter, p in estimated:
        decimals = _DECIMALS[parameter.unit]
        name = parameter.name.partition("[")[0]
        parts.append(f"{name} {number(p.value, decimals)} ± {_half(p, decimals)}")
    return f"Intrinsics{_owner(estimated[0][0])} (95 %): {', '.join(parts)}; fx, fy, cx, cy in px."


def _board(estimated: Sequence[_Estimated]) -> str:
    """Word the errors of one print: scale and sag along x and y, and how far its corners are from their places."""
    whole = [(parameter, p) for parameter, p in estimated if not parameter.of_one_point]
    parts = []
    for name, factor, unit, decimals in (("scale", 100.0, "%", 2), ("sag", 1e3, "mm", 2)):
        values = []
        for parameter, p in whole:
            if parameter.name.startswith(f"board_{name}"):
                axis = parameter.name.partition("[")[0][-1]
                change = number(factor * p.delta, decimals, "+")
                values.append(f"{axis} {change} ± {_half(p, decimals, factor)} {unit}")
        if values:
            parts.append(f"{name} {', '.join(values)}")
    offsets = _offsets(estimated)
    if len(offsets):
        rms = float(np.sqrt(np.mean(offsets**2)))
        parts.append(f"corners {number(1e3 * rms, 3)} mm rms from their places along x and y")
    return f"Board{_owner(estimated[0][0])} (95 %): {'; '.join(parts)}."


def _offsets(estimated: Sequence[_Estimated]) -> Array:
    """Return the errors of all corners of a print along x and y [m]."""
    return np.array([p.delta for parameter, p in estimated if parameter.of_one_point])


def _half(p: ParameterEstimate, decimals: int, factor: float = 1.0) -> str:
    """Format half the 95 % interval of a parameter."""
    return number(0.5 * factor * (p.high - p.low), decimals)


def _owner(parameter: Parameter) -> str:
    """Return the name of the camera or board of a parameter with a space before it; empty for the only one."""
    _, bracket, name = parameter.name.partition("[")
    return f" of '{name.rstrip(']')}'" if bracket else ""


def counted_rows(c: Calibration) -> str:
    """Count the rows of each set, or the images and their corners."""
    estimation, validation = (int(np.sum(s)) for s in (c.rows.estimation, c.rows.validation))
    images = c.rows.images_of(c.rows.estimation)
    if not images:
        return f"{estimation} rows for estimation and {validation} for validation"
    fresh = f"{c.rows.images_of(c.rows.validation)} with {validation}" if validation else "none"
    counted = f"{plural(images, 'image')} with {estimation} corners"
    return f"{counted} for estimation and {fresh} for validation"

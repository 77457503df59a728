"""Options of an estimation as a cell states them: priors, bounds and priors of single parameters.

A change counts from the nominal value. That of a target or a frame is where the cell says it is, which is not where
registration puts it and where the estimation starts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import ModelError
from calib.identify.estimate import Options
from calib.identify.setup import Setup
from calib.measure.cell import Cell
from calib.model.parameters import TARGET, ErrorModel, frame_place, target_place
from calib.model.robot import rigid_inverse

Array = NDArray[np.float64]


def options_of(
    cell: Cell, model: ErrorModel, setups: tuple[Setup, Setup], *, robust: bool, lenient: bool
) -> Options:
    """How to estimate, from the cell.

    Args:
        cell: With priors, bounds and what repeats count for.
        model: The parameters.
        setups: Frames and targets as given, and as registered, where x = 0.
        robust: Whether outliers lose their weight.
        lenient: Whether the cell may name parameters that this model lacks.

    Raises:
        ModelError: A bound or a prior for a parameter that the model lacks, or for that of a target or frame that was
            not said to be anywhere.
    """
    bounds = None
    wanted = {
        name: ends for name, ends in cell.bounds.items() if _has(model, name, lenient=lenient)
    }
    single = {n: std for n, std in cell.parameter_priors.items() if _has(model, n, lenient=lenient)}
    nominal = _nominal(setups, model, {*wanted, *single})
    if wanted:
        bounds = np.tile([-np.inf, np.inf], (len(model), 1))
        for name, ends in wanted.items():
            k = model.index(name)
            bounds[k] = nominal[k] + np.array(ends)
    return Options(
        priors=cell.priors,
        robust=robust,
        single=single,
        bounds=bounds,
        nominal=nominal,
        repeats=cell.repeats,
    )


def _nominal(setups: tuple[Setup, Setup], model: ErrorModel, names: set[str]) -> Array:
    """Where the changes of parameters count from, shape (p,): 0, but for targets and frames, which registration moved.

    A displacement by x, y, z, rx, ry, rz in this order has these translations and these angles about moving axes.

    Args:
        setups: Frames and targets as given, and as registered.
        model: The parameters.
        names: Those with a bound or a prior of their own; the others do not matter.

    Raises:
        ModelError: One of these is of a target or frame that was not given.
    """
    places = {}
    given, started = setups
    for f, group in enumerate(given.frame_unknowns):
        places[frame_place(group)] = (
            given.frame_given[f],
            started.T_frame_base[f],
            given.T_frame_base[f],
        )
    for t, target in enumerate(given.target_names):
        places[target_place(target)] = (
            given.target_given[t],
            started.T_tip_target[t],
            given.T_tip_target[t],
        )
    result = np.zeros(len(model))
    for k, parameter in enumerate(model.parameters):
        if parameter.name not in names or parameter.place not in places:
            continue
        known, start, wanted = places[parameter.place]
        if not known:
            what = "target" if parameter.family == TARGET else "frame"
            message = (
                f"'{parameter.name}' has a bound or a prior on its change, but it is not said from where: give the "
                f"{what} in the cell file, or drop the bound."
            )
            raise ModelError(message)
        moved = rigid_inverse(start) @ wanted
        angles = Rotation.from_matrix(moved[:3, :3]).as_euler("XYZ")
        result[k] = parameter.direction @ np.concatenate([moved[:3, 3], angles])
    return result


def _has(model: ErrorModel, name: str, *, lenient: bool) -> bool:
    """Whether the model has a parameter; where it must, and has not, `ErrorModel.index` says so.

    Raises:
        ModelError: It has not, and must.
    """
    return name in model.names if lenient else model.index(name) >= 0

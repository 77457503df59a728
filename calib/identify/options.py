"""Options of an estimation as a cell states them: priors, bounds and priors of single parameters.

A change counts from the nominal value. That of a target or a frame is where the cell says it is, which is not where
registration puts it and where the estimation starts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import ModelError
from calib.identify.setup import Setup
from calib.identify.stage import Holds
from calib.measure.cell import Cell
from calib.model.parameters import TARGET, ErrorModel, frame_place, target_place
from calib.model.robot import rigid_inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """What an estimation is to do.

    Attributes:
        holds: Priors of families and of single parameters.
        robust: Whether rows may lose their weight; outliers are named either way.
        bounds: shape (p, 2), lowest and highest value of each parameter; None without.
        repeats: What repeats of a pose count for: ``"weighted"``, ``"average"`` or ``"independent"``.
        weights: shape (N,), weights that stay, repeats shared out, of an estimation before; None to find them.
    """

    holds: Holds
    robust: bool = True
    bounds: Array | None = None
    repeats: str = "weighted"
    weights: Array | None = None

    @classmethod
    def of(
        cls,
        cell: Cell,
        model: ErrorModel,
        setups: tuple[Setup, Setup],
        *,
        robust: bool,
        lenient: bool,
    ) -> Options:
        """How to estimate, from the cell.

        Args:
            cell: With priors, bounds and what repeats count for.
            model: The parameters.
            setups: Frames and targets as given, and as registered, where x = 0.
            robust: Whether outliers lose their weight.
            lenient: Whether the cell may name parameters that this model lacks.

        Raises:
            ModelError: A bound or a prior for a parameter that the model lacks, or for that of a target or frame that
                was not said to be anywhere.
        """
        wanted = {n: ends for n, ends in cell.bounds.items() if _has(model, n, lenient=lenient)}
        single = {
            n: std for n, std in cell.parameter_priors.items() if _has(model, n, lenient=lenient)
        }
        nominal = _nominal(setups, model, {*wanted, *single})
        bounds = np.tile([-np.inf, np.inf], (len(model), 1)) if wanted else None
        for name, ends in wanted.items():
            assert bounds is not None
            k = model.index(name)
            bounds[k] = nominal[k] + np.array(ends)
        holds = Holds.of(model, cell.priors, single, nominal)
        return cls(holds, robust, bounds, cell.repeats)


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
            raise ModelError(
                f"'{parameter.name}' has a bound or a prior on its change, but it is not said from where: give the "
                f"{what} in the cell file, or drop the bound."
            )
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

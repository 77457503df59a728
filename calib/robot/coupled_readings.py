"""Coupled joint readings: the value of a joint that a controller shows, and the value of the URDF's joint.

    theta_i = q_i + sum_j c_ij q_j,    theta = C q

q are the readings, the columns of a table, and theta the values of the joints that move freely. Many arms show joint 3
relative to the horizontal, whatever joint 2 is at: theta_3 = q_3 + q_2 or q_3 - q_2, as the axes point. C is regular,
so that there are readings for any values.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.units import is_number
from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.chain import MOVING
from calib.robot.urdf import Urdf

ReadingCoupling: TypeAlias = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""The factors c of other joints' readings for each coupled joint, by name, sorted; [rad/rad], [m/m], or mixed."""

#: A coupling with a greater condition number counts as singular.
_SINGULAR = 1e6


def checked_coupling(
    urdf: Urdf,
    coupling: Mapping[str, Mapping[str, float]] | None,
    held: Mapping[str, float],
) -> ReadingCoupling:
    """Return which joints' readings are coupled, sorted by name; factors of 0 are left out.

    Args:
        urdf: The robot.
        coupling: For each coupled joint the factors of other joints' readings, by name; None for none.
        held: Values of joints that stay where they are, by name, which have no readings.

    Raises:
        UrdfError: A joint has no reading of its own, does not exist, or is coupled to itself; or a factor is not a
            finite number.
    """
    result = []
    for name, factors in sorted((coupling or {}).items()):
        where = f"{urdf.source}: the coupling of the readings of '{name}'"
        _check_has_reading(urdf, name, held, where)
        for other, factor in factors.items():
            _check_has_reading(urdf, other, held, where)
            if other == name:
                raise UrdfError(
                    f"{where} names '{name}' itself. Name the other joints whose readings are added to its own, "
                    f"such as [coupling] {name} = {{ joint_2 = 1.0 }}."
                )
            if not is_number(factor):
                raise UrdfError(
                    f"{where} has the factor {factor!r} at '{other}'; give a finite number, such as 1.0 or -1.0."
                )
        coupled = sorted((other, float(factor)) for other, factor in factors.items() if factor)
        if coupled:
            result.append((name, tuple(coupled)))
    return tuple(result)


def _check_has_reading(urdf: Urdf, name: str, held: Mapping[str, float], where: str) -> None:
    """Refuse by UrdfError a joint without its own reading: it does not exist, is fixed or held, or mimics another."""
    moving = {joint.name: joint for joint in urdf.joints if joint.type in MOVING}
    fault = ""
    if name not in moving:
        fault = f"'{name}' is not a joint that moves{did_you_mean(name, moving)}"
    elif name in held:
        fault = f"'{name}' is held at {held[name]:.6g}, so that it has no reading"
    elif moving[name].mimic is not None:
        fault = f"'{name}' mimics '{moving[name].mimic}', so that it has no reading of its own"
    if fault:
        free = [
            other for other, joint in moving.items() if other not in held and joint.mimic is None
        ]
        raise UrdfError(
            f"{where}: {fault}. Joints whose readings can be coupled: {choices(free, limit=30)}."
        )


def reading_matrix(urdf: Urdf, columns: Sequence[str], coupling: ReadingCoupling) -> Array:
    """Return C of theta = C q, shape (m, m), read-only; the identity if no readings are coupled.

    Args:
        urdf: The robot.
        columns: Names of the m joints of a chain that have a reading.
        coupling: From `checked_coupling`; couplings of joints beside the chain are ignored.

    Raises:
        UrdfError: A reading of a joint beside the chain is needed, or C is singular.
    """
    C = np.eye(len(columns))
    for name, factors in coupling:
        if name not in columns:
            continue
        for other, factor in factors:
            if other not in columns:
                raise UrdfError(
                    f"{urdf.source}: the readings of '{name}' are coupled to those of '{other}', which is not a joint "
                    f"of the chain: its joints are {choices(columns, limit=30)}. Choose --base and --tip so that both "
                    "are between them."
                )
            C[columns.index(name), columns.index(other)] = factor
    if np.linalg.cond(C) > _SINGULAR:
        names = choices(name for name, _ in coupling)
        raise UrdfError(
            f"{urdf.source}: the couplings of the readings of {names} are singular: different joint angles have the "
            "same readings. Correct the factors; two joints are seldom coupled to each other."
        )
    return read_only(C)


def coupling_lines(coupling: Mapping[str, Mapping[str, float]]) -> str:
    """Return coupled readings as a cell file has them, in one line: ``[coupling] joint_3 = { joint_2 = 1 }``."""
    entries = []
    for name, factors in coupling.items():
        terms = ", ".join(f"{_key(other)} = {factor:.12g}" for other, factor in factors.items())
        entries.append(f"{_key(name)} = {{ {terms} }}")
    return "[coupling] " + "; ".join(entries)


def _key(name: str) -> str:
    """Return a name as a key of TOML, in quotes if it needs them."""
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else json.dumps(name)


def coupling_table(coupling: Mapping[str, Mapping[str, float]]) -> list[dict[str, Any]]:
    """Return coupled readings as a list for files, with a row ``{"joint", "reading", "factor"}`` for each factor.

    Args:
        coupling: For each coupled joint the factors of other joints' readings, by name.
    """
    return [
        {"joint": name, "reading": other, "factor": factor}
        for name, factors in coupling.items()
        for other, factor in factors.items()
    ]


def coupling_of_table(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Return coupled readings from a file's list, see `coupling_table`."""
    coupling: dict[str, dict[str, float]] = {}
    for row in rows:
        coupling.setdefault(row["joint"], {})[row["reading"]] = float(row["factor"])
    return coupling

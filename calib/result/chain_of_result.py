"""The cell of rows that a result is applied to: its chain, held joints, coupled readings, frames and targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from calib.data.cell import Cell
from calib.errors import CalibError, choices
from calib.result.calibration import Calibration


def with_chain_of_result(cell: Cell, result: Calibration, name: str) -> Cell:
    """Return the cell with the chain of a result, its held joints and coupled readings; held values of the cell win.

    Args:
        cell: As given.
        result: A calibration.
        name: Its file, for messages.

    Raises:
        CalibError: The cell names another base or tip: frame and target of the result would mean another pose; or it
            couples other readings.
    """
    chain = result.nominal
    cell = _with_links_of_result(cell, result, name)
    for option, given, required in (
        ("base", cell.base, chain.base),
        ("tip", cell.tip, chain.tip),
    ):
        if given is not None and given != required:
            raise CalibError(
                f"{name} is the result for --{option} {required}, but '{given}' was given."
            )
    held = {**chain.held, **cell.held}
    coupling = coupling_of_result(cell, result, name)
    return replace(cell, base=chain.base, tip=chain.tip, held=held, coupling=coupling)


def _with_links_of_result(cell: Cell, result: Calibration, name: str) -> Cell:
    """Return the cell with the links of a result's frames and targets; CalibError if it names another for one.

    A target that the result lacks may be on a link that a target of the result is on.
    """
    of_result = result.setup.in_cell(cell)
    links = of_result.tips
    new = {
        key: link for key, link in cell.tips.items() if key not in links and link in links.values()
    }
    of_result = replace(of_result, tips={**links, **new})
    pairs = (("base", cell.bases, of_result.bases), ("tip", cell.tips, of_result.tips))
    for option, given, required in pairs:
        for key, link in given.items():
            if required.get(key) != link:
                raise CalibError(
                    f"{name} is the result for --{option} '{key}={required.get(key, 'another link')}', but "
                    f"'{key}={link}' was given. Leave it out: the result contains it."
                )
    return of_result


def coupling_of_result(cell: Cell, result: Calibration, name: str) -> Mapping[str, Any]:
    """Return the coupled readings of a result, by name; CalibError if the cell couples others.

    Args:
        cell: As given.
        result: A calibration.
        name: Its file, for messages.
    """
    of_result = result.nominal.reading_coupling
    if cell.coupling and cell.coupling != of_result:
        coupled = choices(of_result) or "no joint"
        raise CalibError(
            f"{name} is the result for coupled readings of {coupled}, but the cell file couples those of "
            f"{choices(cell.coupling)} differently. Leave out [coupling]: the result contains it."
        )
    return of_result

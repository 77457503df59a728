"""The tables of a fleet: ``fleet.csv`` for a spreadsheet, ``fleet.json`` for a program; see docs/fleet.md."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.fleets.outliers import Odd
from calib.fleets.record import FleetRow
from calib.model.files import json_bytes, plain, write_atomically

CSV, JSON = "fleet.csv", "fleet.json"
SCHEMA = "fleet 1"

#: Keys with a unit.
_UNITS = {
    "nominal_rms": "_m",
    "calibrated_rms": "_m",
    "unseen_rms": "_m",
    "left_out_rms": "_m",
    "sigma": "_m",
    "sigma_angle": "_rad",
}

_HEADER = (
    "name",
    "status",
    "verdict",
    "nominal rms [mm]",
    "calibrated rms [mm]",
    "unseen rms [mm]",
    "unseen by",
    "cross-validated rms [mm]",
    "noise [mm]",
    "noise [mrad]",
    "model",
    "larger model",
    "rows",
    "outliers",
    "odd",
    "message",
)


def fleet_table(
    rows: Sequence[FleetRow], odd: Sequence[Odd], notes: Sequence[str]
) -> dict[str, Any]:
    """A fleet as nested tables of plain values, SI units, the unit in the keys."""
    found: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "robots": [
                {key + _UNITS.get(key, ""): value for key, value in asdict(row).items()}
                for row in rows
            ],
            "odd": [asdict(one) for one in odd],
            "notes": list(notes),
        }
    )
    return found


def write_tables(
    folder: Path, rows: Sequence[FleetRow], odd: Sequence[Odd], notes: Sequence[str]
) -> None:
    """Write both, in the place of those of an earlier run.

    Raises:
        FileError: They cannot be written.
    """
    data = json_bytes(fleet_table(rows, odd, notes))
    # First the one that says whose the other is.
    write_atomically(folder / JSON, data, overwrite=True)
    write_atomically(folder / CSV, csv_bytes(rows, odd), overwrite=True)


def csv_bytes(rows: Sequence[FleetRow], odd: Sequence[Odd]) -> bytes:
    """The table for a spreadsheet, UTF-8, one line a robot."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADER)
    reasons: dict[str, list[str]] = {}
    for one in odd:
        reasons.setdefault(one.name, []).append(one.text)
    for r in rows:
        errors = (r.nominal_rms, r.calibrated_rms, r.unseen_rms)
        noise = (r.sigma, r.sigma_angle)
        writer.writerow(
            (
                r.name,
                r.status,
                r.verdict,
                *map(_thousandths, errors),
                r.unseen,
                _thousandths(r.left_out_rms),
                *map(_thousandths, noise),
                r.model,
                r.larger,
                r.rows or "",
                r.outliers if r.rows else "",
                "; ".join(reasons.get(r.name, ())),
                " ".join(r.message.split()),
            )
        )
    return text.getvalue().encode("utf-8", "backslashreplace")


def _thousandths(value: float) -> str:
    """A number in mm or mrad, empty where there is none."""
    return f"{1e3 * value:.6g}" if value == value else ""

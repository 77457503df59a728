"""A scenario from words: what the command line says, and the table ``[simulation]`` of the cell file."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.data.cell import Cell
from calib.data.surroundings import TrackerNoise, parse_noise
from calib.errors import CalibError, choices, did_you_mean
from calib.files import read_bytes
from calib.model.error_model import error_model
from calib.model.families import FAMILIES, Unit, unit_of
from calib.robot.robot import Robot
from calib.simulation.scenario import DEFAULT_MODEL, Scenario
from calib.simulation.truth import Encoder, MovedTarget, Outliers
from calib.units import is_number, parse_quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_NONE = "none"

#: Noise of an orientation about each axis, of a tracker's 6D probe [rad].
_PROBE = float(np.radians(0.01))

#: The keys of ``[simulation]``: how many of their unit are one in SI, and of how many numbers they are.
KEYS: dict[str, tuple[float, int]] = {
    "visits": (1.0, 1),
    "encoder_deg": (180.0 / np.pi, 1),
    "encoder_mm": (1e3, 1),
    "outlier_size_mm": (1e3, 1),
    "drift_mm": (1e3, 3),
    "moved_row": (1.0, 1),
    "moved_mm": (1e3, 3),
}


@dataclass(frozen=True, slots=True)
class Words:
    """What the command line says of a scenario, as it is written; None: nothing."""

    sizes: str | None = None
    error: tuple[str, ...] = ()
    noise: str | None = None
    outliers: str | None = None
    truth_robot: Path | None = None
    target_error: str | None = None


def read_simulation(path: Path | None) -> dict[str, Any]:
    """The table ``[simulation]`` of a cell file, in SI units, by the keys without their units."""
    if path is None:
        return {}
    table = tomllib.loads(read_bytes(path, "cell file").decode("utf-8-sig")).get("simulation", {})
    found: dict[str, Any] = {}
    for key, value in table.items():
        where = f"{path}: '{key}' in [simulation]"
        if key == "moved_target":
            found[key] = str(value)
            continue
        if key not in KEYS:
            known = [*KEYS, "moved_target"]
            raise CalibError(
                f"{where} is unknown{did_you_mean(key, known)}. It may have {choices(known)}."
            )
        per_si, count = KEYS[key]
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) != count or not all(map(is_number, numbers)):
            raise CalibError(
                f"{where} is {value!r}; it must be {'three numbers' if count == 3 else 'a number'}."
            )
        scaled = np.array(numbers, dtype=np.float64) / per_si
        found[re.sub("_(mm|deg)$", "_m" if key == "encoder_mm" else "", key)] = (
            scaled if count == 3 else float(scaled[0])
        )
    return found


def read_scenario(robot: Robot, cell: Cell, words: Words, path: Path | None = None) -> Scenario:
    """The scenario of a robot and a cell, with what the command line and the cell file at ``path`` add."""
    more = read_simulation(path)
    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    units = {p.name: p.unit for p in error_model(robot, model, target=False).parameters}
    errors = tuple(_named_errors(words.error, units))
    noise = noise_of(cell, words.noise)
    moved = None
    if "moved_row" in more or "moved" in more:
        by = more.get("moved", np.zeros(3))
        moved = MovedTarget(int(more.get("moved_row", 1)), by, more.get("moved_target"))
    sigma_angle = _PROBE if cell.sigma_angle is None else cell.sigma_angle
    scenario = Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=sizes_of(cell, words.sizes, named=bool(errors)),
        errors=errors,
        noise=noise,
        sigma_angle=0.0 if noise is None else sigma_angle,
        encoder=Encoder(more.get("encoder", 0.0), more.get("encoder_m", 0.0)),
        outliers=parse_outliers(words.outliers, more.get("outlier_size", Outliers().size)),
        moved=moved,
        drift=more.get("drift", np.zeros(3)),
        visits=int(more.get("visits", 1)),
    )
    if words.target_error is not None:
        size = abs(_amount(words.target_error, "--target-error", FAMILIES["length"].unit))
        scenario = replace(scenario, target_error=size)
    if words.truth_robot is not None:
        true = Robot.load(words.truth_robot, robot.base, robot.tip, held=robot.held)
        scenario = replace(scenario, true_robot=true)
    return scenario


def sizes_of(cell: Cell, text: str | None, *, named: bool) -> Mapping[str, float] | None:
    """``length 0.5 mm, angle 3 mrad`` or ``none``; by default none beside named errors, else the cell's, or typical."""
    if text is None and not named:
        return {f: cell.priors.of(f) for f in FAMILIES} if cell.priors.sizes == "given" else {}
    if text is None or text.strip() == _NONE:
        return None
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.strip().partition(" ")
        if name not in FAMILIES or name in found:
            raise CalibError(
                f"--sizes was given as \"{text}\"; it must be '{_NONE}', or sizes with commas between them such as "
                f'"length 0.5 mm, angle 3 mrad", each once of {choices(FAMILIES)}.'
            )
        found[name] = _amount(value, f"--sizes, {name}", FAMILIES[name].unit)
        if found[name] < 0.0:
            raise CalibError(f"--sizes, {name}: '{value.strip()}' must not be below 0.")
    return found


def _named_errors(pairs: Iterable[str], units: Mapping[str, str]) -> Iterable[tuple[str, float]]:
    """Single errors, ``elbow_joint.rx=2 mrad`` each, in the units of the parameters."""
    for pair in dict.fromkeys(pairs):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        if name not in units:
            raise CalibError(
                f"--error '{pair}': the robot has no error '{name}' in this model{did_you_mean(name, units)}. Write "
                f"such as 'elbow_joint.rx=2 mrad'; it has {choices(units)}."
            )
        yield name, _amount(value, "--error", unit_of(units[name]))


def _amount(text: str, option: str, unit: Unit) -> float:
    """A number with its unit, in SI; 0 needs none."""
    try:
        value, kind = parse_quantity(text.strip())
    except CalibError as error:
        raise CalibError(f'{option} "{text}": {error}. Write "{unit.example}".') from error
    if kind != unit.quantity and value != 0.0:
        raise CalibError(
            f'{option} "{text}": that is {kind}, {unit.quantity} is wanted: "{unit.example}".'
        )
    return value


def noise_of(cell: Cell, text: str | None) -> TrackerNoise | None:
    """The noise as said, ``15 um + 6 um/m``, ``0.05 mm`` or ``none``, else the cell's; None: none at all."""
    if text is not None:
        if text.strip() in (_NONE, "0"):
            return None
        # Read beside a repeatability, so that a noise of "0 mm" is not refused as such.
        read = parse_noise(text, "--noise", repeatability=1.0)
        return replace(read, repeatability=0.0) if read.constant or read.per_length else None
    found = TrackerNoise() if cell.tracker is None else cell.tracker.noise
    return found if cell.sigma is None else TrackerNoise(cell.sigma, 0.0, 0.0)


def parse_outliers(text: str | None, size: float) -> Outliers | None:
    """A number of rows, ``3``, or a share of them, ``5 %``."""
    if text is None:
        return None
    number = re.fullmatch(r"\s*(\d{1,9}|\d*\.?\d+(?=\s*%))\s*(%?)\s*", text)
    if number is None:
        raise CalibError(
            f'--outliers was given as "{text}"; it must be a number of rows, such as "3", or a share of those to '
            'estimate from, such as "5 %".'
        )
    if number[2]:
        return Outliers(share=float(number[1]) / 100.0, size=size)
    return Outliers(count=int(number[1]), size=size)

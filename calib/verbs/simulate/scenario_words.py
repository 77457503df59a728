"""A scenario from the words of a command line, and from the table ``[simulation]`` of a cell file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import LENGTH, parse_amount, parse_noise, quantity_name
from calib.data.cell import Cell, TrackerNoise
from calib.data.cell_file import DEGREES, MM, POINT, TEXT, Field, numbers, read_table, read_toml
from calib.data.inputs import chain_of, robot_of
from calib.instruments.camera import is_image
from calib.instruments.tracker import noise_of_lengths
from calib.model.error_model import error_model
from calib.model.families import unit_of
from calib.model.parameters import ErrorModel
from calib.robot.robot import Robot
from calib.verbs.simulate.disturbances import Encoder, MovedTarget, Outliers
from calib.verbs.simulate.scenario import DEFAULT_MODEL, Scenario
from calib.verbs.simulate.truth import NONE, TARGET_ERROR, parse_error_sizes

#: Keys of ``[simulation]`` in a cell file.
FIELDS: Mapping[str, Field] = {
    "visits": Field("visits", numbers(1)),
    "encoder_deg": Field("angle", DEGREES),
    "encoder_mm": Field("length", MM),
    "outlier_size_mm": Field("size", MM),
    "drift_mm": Field("drift", POINT),
    "moved_row": Field("row", numbers(1)),
    "moved_mm": Field("by", POINT),
    "moved_target": Field("target", TEXT),
}

#: Noise of an orientation about each axis, of a tracker's 6D probe [rad].
_PROBE = float(np.radians(0.01))


@dataclass(frozen=True, slots=True)
class ScenarioWords:
    """Options of a scenario, as typed on the command line; None: not given."""

    #: Standard deviations of errors, see `parse_error_sizes`.
    sizes: str | None = None
    #: Single errors, ``elbow_joint.rx=2 mrad`` each.
    error: Iterable[str] | None = None
    #: See `parse_tracker_noise`.
    noise: str | None = None
    #: A number of rows or a share, see `Outliers.parse`.
    outliers: str | None = None
    #: URDF of the true robot.
    truth_robot: Path | None = None
    #: Standard deviation of the targets' positions, a length.
    target_error: str | None = None


def read_scenario(
    robot: Robot,
    cell: Cell,
    path: Path | None = None,
    words: ScenarioWords | None = None,
) -> Scenario:
    """Read a scenario.

    Args:
        robot: The nominal robot.
        cell: The cell.
        path: Its file, whose table ``[simulation]`` counts too; None: there is none.
        words: Options of the command line; None: none are given.

    Returns:
        The scenario.

    Raises:
        CalibError: A text that an option does not take, or a fault of the file.
    """
    words = words or ScenarioWords()
    events = _simulation_table(path)
    model = DEFAULT_MODEL if cell.model == "auto" else cell.model
    all_errors = error_model(robot, model, target=False, gravity=cell.gravity)
    errors = tuple(_named_errors(words.error or (), all_errors))
    noise, sigma = _noise(cell, words.noise)
    return Scenario(
        robot=robot,
        cell=cell,
        model=model,
        sizes=parse_error_sizes(cell, words.sizes, named=bool(errors)),
        errors=errors,
        true_robot=_true_robot(robot, words.truth_robot),
        target_error=_target_error(words.target_error),
        noise=noise,
        sigma=sigma,
        encoder=Encoder(events.get("angle", 0.0), events.get("length", 0.0)),
        outliers=_outliers(words.outliers, events),
        moved=_moved_target(events),
        drift=events.get("drift", np.zeros(3)),
        visits=int(events.get("visits", 1)),
    )


def _simulation_table(path: Path | None) -> dict[str, Any]:
    """Read the table ``[simulation]`` of a cell file, SI units, by the names of `FIELDS`."""
    if path is None:
        return {}
    table = read_toml(path).get("simulation", {})
    return read_table(table, FIELDS, f"[simulation] of {path}")


def _true_robot(robot: Robot, path: Path | None) -> Robot | None:
    """Load the true robot, with the chain of the nominal one; None without a file."""
    if path is None:
        return None
    return robot_of(path, chain_of(robot))


def _target_error(text: str | None) -> float:
    """Parse ``--target-error`` [m]; the default without one."""
    if text is None:
        return TARGET_ERROR
    return parse_amount(text, "--target-error", LENGTH, "1 mm")


def _noise(cell: Cell, text: str | None) -> tuple[TrackerNoise | None, dict[str, float]]:
    """Parse ``--noise``: of the images of corners [px], of anything else that of lengths.

    Args:
        cell: Has the kind, and the noise where nothing is typed.
        text: As typed; None: not given.

    Returns:
        The noise of lengths, and that of one scalar in the other units by their symbols.
    """
    of_images = cell.kind is not None and is_image(registry.get(cell.kind))
    if not of_images or text is None or text == NONE:
        noise = parse_tracker_noise(cell, text)
        return noise, _further_noise(cell, noise)
    pixels = parse_amount(text, "--noise", quantity_name("pixel"), "0.3 px")
    noise = noise_of_lengths(cell)
    return noise, {**_further_noise(cell, noise), "px": pixels}


def _further_noise(cell: Cell, noise: TrackerNoise | None) -> dict[str, float]:
    """Return the noise of one scalar in units other than of length: the cell's, or a usual one; none without noise."""
    if noise is None:
        return {}
    usual = {symbol: unit.assumed_sigma for symbol, unit in RESIDUAL_UNITS.items()}
    del usual["m"]
    of_cell = {unit: std for unit, std in cell.sigma.items() if unit != "m"}
    return usual | {"rad": _PROBE} | of_cell


def _outliers(text: str | None, events: Mapping[str, Any]) -> Outliers | None:
    """Parse ``--outliers``, with their size from ``[simulation]``; None without it."""
    if text is None:
        return None
    return Outliers.parse(text, events.get("size", Outliers().size))


def _moved_target(events: Mapping[str, Any]) -> MovedTarget | None:
    """Return the target that moves, from ``[simulation]``; None if none does."""
    if "row" not in events and "by" not in events:
        return None
    displacement = events.get("by", np.zeros(3))
    return MovedTarget(int(events.get("row", 1)), displacement, events.get("target"))


def _named_errors(pairs: Iterable[str], model: ErrorModel) -> Iterator[tuple[str, float]]:
    """Parse single errors, ``elbow_joint.rx=2 mrad`` each, in the units of the parameters."""
    for pair in dict.fromkeys(pairs):
        name, _, value = (part.strip() for part in pair.rpartition("="))
        unit = unit_of(model.parameters[model.index(name)].unit)
        yield name, parse_amount(value, "--error", unit.quantity, unit.example, signed=True)


def parse_tracker_noise(cell: Cell, text: str | None) -> TrackerNoise | None:
    """Parse ``--noise``: ``15 um + 6 um/m``, ``0.05 mm`` or ``none``.

    Args:
        cell: Has the noise where nothing is typed: its own sigma, its tracker's, or a usual tracker's.
        text: As typed; None: not given.

    Returns:
        The noise; None: none at all.

    Raises:
        CalibError: It is no such text.
    """
    if text is not None:
        constant, per_length = (0.0, 0.0) if text == NONE else parse_noise(text, "--noise")
        return TrackerNoise(constant, per_length, 0.0) if constant or per_length else None
    return noise_of_lengths(cell)

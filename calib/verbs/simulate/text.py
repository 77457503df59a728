"""A simulation as `calib simulate` prints it: a row for each thing simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.basics.arrays import Array
from calib.model.families import FAMILIES, unit_of
from calib.numerics.errors import rms
from calib.show.lines import fill, row_ranges
from calib.show.tables import labelled
from calib.verbs.simulate.scenario import Scenario, Simulated
from calib.verbs.simulate.truth import Truth

#: Columns from a label to its text.
_LABEL = 26

#: A frame whose pose differs by less from the identity is the base frame.
_ROUNDING = 1e-12


def simulated_text(scenario: Scenario, simulated: Simulated) -> str:
    """Write what was simulated.

    Args:
        scenario: The scenario as it was given.
        simulated: The robot with its true errors, and its measurements.

    Returns:
        Errors of the robot, places of targets and frames, disturbances of the measurements, in lines of 100 columns.
    """
    table, robot, truth = simulated.measurements, scenario.robot, simulated.truth
    rows = f"{len(table)} rows"
    validation = int(table.validation.sum())
    if validation:
        rows += f" ({len(table) - validation} for estimation, {validation} for validation)"
    title = f"Simulated: robot '{robot.name}', {robot.base} to {robot.tip}, {rows}."
    labels_and_texts = [
        ("Each row measures", f"the {scenario.kind.words}"),
        ("Targets at each pose", ", ".join(truth.targets)),
        ("Stations in turn", ", ".join(truth.groups)),
        ("Visits of each pose", str(scenario.visits)),
        *error_lines(simulated.truth, simulated.q),
        *_places(scenario, simulated),
        *_disturbances(scenario, simulated),
    ]
    lines = [fill(title), ""]
    for label, text in labels_and_texts:
        if text:
            lines.append(labelled(label, text, _LABEL))
    return "\n".join(lines)


def error_lines(truth: Truth, q: Array) -> Iterator[tuple[str, str]]:
    """Yield label and text of the true errors of each family, and of the nominal robot's position error.

    Args:
        truth: The robot with its errors, and its target.
        q: True joint values that were measured at, shape (N, m), [rad] or [m].
    """
    families = _errors_by_family(truth)
    model = f"model {truth.model.name}"
    if not families:
        model += "; all errors are zero"
    yield "True errors", model
    for (family, unit), errors in families.items():
        yield f"  {family}", _family_text(errors, unit)
    distances = truth.nominal_errors(q)
    text = f"{_mm(rms(distances))} mm rms, {_mm(distances.max())} mm at most"
    yield "  of the nominal robot", text


def _errors_by_family(truth: Truth) -> dict[tuple[str, str], dict[str, float]]:
    """Collect the true errors that are not zero.

    Args:
        truth: The robot's error model, and the true values of its parameters.

    Returns:
        From family and unit, in the order of `FAMILIES`, to the value in that unit by the parameter's name.
    """
    families: dict[tuple[str, str], dict[str, float]] = {}
    for parameter, value in zip(truth.model.parameters, truth.x, strict=True):
        if value:
            errors = families.setdefault((parameter.family, parameter.unit), {})
            errors[parameter.name] = float(value)
    order = list(FAMILIES)
    keys = sorted(families, key=lambda key: (order.index(key[0]), key[1]))
    return {key: families[key] for key in keys}


def _family_text(errors: Mapping[str, float], unit: str) -> str:
    """Word the errors of one family, by the parameter's name, in a unit of parameters: number, rms, the largest."""
    factor, symbol = unit_of(unit).shown
    name = max(errors, key=lambda name: abs(errors[name]))
    size = factor * rms(np.array(list(errors.values())))
    largest = f"{name} {factor * errors[name]:.3g} {symbol}"
    return f"{len(errors)}, rms {size:.3g} {symbol}, largest {largest}"


def _places(scenario: Scenario, simulated: Simulated) -> Iterator[tuple[str, str]]:
    """Label and text of the true places of targets and frames."""
    truth = simulated.truth
    targets = zip(truth.targets, truth.T_tip_target, truth.stated_T_tip_target, strict=True)
    for name, T, given in targets:
        place = f"{point_mm(T[:3, 3])} mm in the tip, given as {point_mm(given[:3, 3])} mm"
        yield f"Target '{name}'", place
    if not scenario.kind.directions:
        return  # No row depends on a frame.
    for name, T in zip(truth.groups, truth.T_frame_base, strict=True):
        place = f"the base is at {point_mm(T[:3, 3])} mm in it"
        if np.abs(T - np.eye(4)).max() < _ROUNDING:
            place = "the base frame"
        label = f"Frame of '{name}'" if name else "Measurement frame"
        yield label, place


def _disturbances(scenario: Scenario, simulated: Simulated) -> Iterator[tuple[str, str]]:
    """Label and text of noise, encoder steps, outliers, a moved target and drift; the text is empty without one."""
    kind = scenario.kind
    if "m" in kind.units:
        noisy = "coordinate" if "m" in kind.vector_units else "length"
        yield f"Noise of a {noisy}", _noise(scenario, simulated)
    if "rad" in kind.units:
        angle = np.degrees(scenario.sigma.get("rad", 0.0))
        yield "Noise of an orientation", f"{angle:g} deg about each axis"
    if "px" in kind.units:
        yield "Noise of an image coordinate", f"{scenario.sigma.get('px', 0.0):g} px"
    yield "Encoder steps", encoder_steps(scenario)
    if simulated.outlier_rows and scenario.outliers is not None:
        size = _mm(scenario.outliers.size)
        yield f"Outliers of {size} mm", f"rows {row_ranges(simulated.outlier_rows)}"
    moved = scenario.moved
    if moved is not None:
        targets = "all targets" if moved.target is None else f"'{moved.target}'"
        by = f"{point_mm(moved.by)} mm in the tip before row {moved.row}"
        yield "Moved target", f"{targets} by {by}: {int(simulated.moved.sum())} rows"
    if scenario.drift.any():
        yield "Drift, first to last row", f"{point_mm(scenario.drift)} mm in the measurement frame"


def encoder_steps(scenario: Scenario) -> str:
    """Word the steps of the encoders; empty: they have none."""
    encoder = scenario.encoder
    steps = (f"{np.degrees(encoder.angle):g} deg", f"{1e3 * encoder.length:g} mm")
    nonzero_steps = [step for step in steps if not step.startswith("0 ")]
    return ", ".join(nonzero_steps)


def _noise(scenario: Scenario, simulated: Simulated) -> str:
    """Word the standard deviation of the noise of a length, and its parts."""
    noise = scenario.noise
    if noise is None:
        return "none"
    low, high = _mm(simulated.sigma.min()), _mm(simulated.sigma.max())
    std = low if low == high else f"{low} to {high}"
    text = f"{std} mm std: instrument {1e6 * noise.constant:g} um"
    if noise.per_length:
        text += f" + {1e6 * noise.per_length:g} um/m"
    if noise.repeatability:
        text += f", robot {1e6 * noise.repeatability:g} um"
    return text


def _mm(value: float) -> str:
    """Format a length [m] in mm with three significant digits."""
    return f"{1e3 * float(value):.3g}"


def point_mm(values: Array) -> str:
    """Format three lengths [m] in mm."""
    coordinates = [f"{1e3 * v + 0.0:.3f}".rstrip("0").rstrip(".") for v in values]
    return f"({', '.join(coordinates)})"

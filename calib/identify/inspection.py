"""inspect: what a robot is made of, and which parameters can be identified from poses, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

import calib.kinds as registry
from calib.errors import ModelError
from calib.identify.fitting import Task, model_of
from calib.identify.problem import Problem
from calib.identify.registration import register
from calib.identify.setup import (
    along_own_axes,
    known_distances,
    rows_of,
    targets_along_tip,
)
from calib.identify.summary import wrap
from calib.measure.cell import AUTO, Cell
from calib.measure.measurements import Measurements
from calib.model.dh import dh_table
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.model.parameters import ErrorModel
from calib.model.readback import spread_poses
from calib.model.robot import Robot

#: A target where none is given: off every axis of the tip [m].
GENERIC_TARGET = (0.05, 0.07, 0.03)

#: An anchor where none is known: off the first axis, which its distance would not tell of [m].
_GENERIC_ANCHOR = (0.7, -0.5, 0.3)


@dataclass(frozen=True, slots=True)
class Inspection:
    """What poses can tell.

    Attributes:
        model: The error model.
        observability: Rank and combinations at the nominal robot.
        poses: Which poses, in words.
    """

    model: ErrorModel
    observability: Observability
    poses: str


def inspect(robot: Robot, cell: Cell, measurements: Measurements | None = None) -> Inspection:
    """Rank of the cell's model at the nominal robot.

    Args:
        robot: The nominal robot.
        cell: Model, targets and frames; ``"auto"`` is looked at as ``"dh"``. A target that is not given is registered
            to the measurements, or, without any, taken 50, 70, 30 mm off the tip; likewise the anchor of distances.
        measurements: Whose estimation poses to judge; None: 200 poses of a Sobol sequence over the joint limits, of the
            cell's kind of measurement.

    Raises:
        ModelError: Unknown parameter set or parameter; or the cell's kind says which poses can be, and only a table
            can tell them.
        MeasurementError: A joint's column is missing, or too few rows.
    """
    if measurements is None:
        rows, setup = rows_of(robot, _everywhere(robot, cell), cell)
        words = "200 poses spread over the joint limits"
        frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
        if not np.all(setup.target_given):
            targets[:, :3, 3] = GENERIC_TARGET
            words += ", target 50, 70, 30 mm off the tip"
        if any(kind.name == "distance" for kind in rows.present) and not np.all(setup.frame_given):
            frames[:, :3, 3] = np.negative(_GENERIC_ANCHOR)
            words += ", anchor 700, -500, 300 mm from the base"
        setup = setup.placed(frames, targets)
        rows = rows.as_measured_at(setup.seen(robot.poses(rows.joints), rows.samples))
    else:
        rows, setup = rows_of(robot, measurements, cell)
        rows = rows.select(measurements.estimation)
        words = f"the {measurements.estimation.sum()} estimation rows of {measurements.source}"
        setup = register(robot, setup, rows)
    name = cell.model if cell.model != AUTO else "dh"
    seen = set(rows.samples.frame.tolist())
    distances = tuple(d for d in known_distances(cell, setup) if {d.first, d.second} <= seen)
    model = along_own_axes(model_of(Task(robot, cell, setup, name, distances)), setup)
    model = targets_along_tip(model, setup)
    kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
    x = np.zeros(len(model))
    jacobian = rows.derivative(*kinematics.twists(x, rows.samples))
    jacobian = jacobian * (rows.scales[:, :1] / rows.scales)[:, :, None]
    known = Problem.first(kinematics, rows, distances).known_slopes(x)
    jacobian = np.concatenate([jacobian[rows.used], known])
    return Inspection(model, analyse(jacobian, model.names, model.units), words)


def _everywhere(robot: Robot, cell: Cell) -> Measurements:
    """Poses spread over the joint limits as a table of the cell's kind."""
    kind = registry.get(cell.kind or "point")
    if not kind.free:
        raise ModelError(
            f"Poses spread over the joint limits say nothing of kind '{kind.name}'. Give a table of such rows."
        )
    joints = spread_poses(robot)
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(kind.name,) * len(joints),
        **any_measurement(kind.name, len(joints)),
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )


def any_measurement(name: str, count: int) -> dict[str, Any]:
    """The arguments of `Measurements` for rows of a kind of free poses, of which only poses and targets count."""
    kind, somewhere = registry.get(name), np.tile(np.eye(4), (count, 1, 1))
    somewhere[:, :3, 3] = 1.0
    assert kind.measure is not None
    return Measurements.columns_of(kind, kind.measure(somewhere))


def inspection_text(robot: Robot, found: Inspection) -> str:
    """The chain, its DH rows, and what the poses can tell, as text of 100 columns."""
    return "\n\n".join("\n".join(part) for part in (_chain(robot), _dh(robot), _parameters(found)))


def _chain(robot: Robot) -> Iterator[str]:
    """The chain's joints with their limits; those without a column of their own, and a base that moves."""
    yield f"Robot '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}:"
    yield f"  {'joint':<32}{'type':<12}{'axis':<24}limits"
    for joint in robot.joints:
        axis = " ".join(f"{v + 0.0:.4g}" for v in joint.axis)
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        limits = "none"
        if joint.lower is not None and joint.upper is not None:
            limits = f"{scale * joint.lower:.1f} to {scale * joint.upper:.1f} {unit}"
        yield from _row(joint.name, f"{joint.type:<12}{axis:<24}{limits}")
    offsets = robot.chain_values(np.zeros(len(robot.inputs)))[0]
    for joint, row, offset in zip(robot.joints, robot.coupling, offsets, strict=True):
        slides = joint.type == "prismatic"
        rest = f"{1e3 * offset:g} mm" if slides else f"{np.degrees(offset):g} deg"
        k = int(np.argmax(np.abs(row)))
        if not np.any(row):
            yield wrap(f"'{joint.name}' is held at {rest}.", "  ")
        elif robot.inputs[k].name != joint.name:
            more = "" if offset == 0 else f", plus {rest}"
            driver = robot.inputs[k].name
            yield wrap(f"'{joint.name}' follows '{driver}', times {row[k]:g}{more}.", "  ")
    if robot.base_moves:
        text = (
            f"Joints move the base '{robot.base}' itself; they are passed from the base outwards."
        )
        yield wrap(text, "  ")


def _row(name: str, cells: str) -> list[str]:
    """A row of a table that begins with a joint's name; a long name gets a line of its own."""
    return [f"  {name:<32}{cells}"] if len(name) < 32 else [f"  {name}", f"  {'':<32}{cells}"]


def _four(value: float, scale: float) -> str:
    """A number with four digits, and no minus before a zero."""
    return f"{round(scale * value, 4) + 0.0:.4f}"


def _dh(robot: Robot) -> Iterator[str]:
    """The DH rows."""
    table, mm, deg = dh_table(robot), 1e3, float(np.degrees(1.0))
    yield "Standard DH rows, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta):"
    columns = "{:>12}{:>13}{:>12}{:>13}{:>12}"
    head = columns.format("a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    yield f"  {'joint':<32}{head}"
    for row in table.rows:
        pairs = ((row.a, mm), (row.alpha, deg), (row.d, mm), (row.theta, deg))
        beta = _four(row.beta, deg) if row.near_parallel else "-"
        yield from _row(row.joint, columns.format(*(_four(*pair) for pair in pairs), beta))
    yield "  beta stands only where axes are nearly parallel (Hayati); there d is set to 0 by convention."
    for label, T in (("base to DH frame 0", table.T_base_0), ("DH frame n to tip", table.T_n_tip)):
        place = "identity"
        if np.abs(T - np.eye(4)).max() >= 1e-9:
            xyz = " ".join(_four(v, mm) for v in T[:3, 3])
            rpy = " ".join(_four(v, deg) for v in pin.rpy.matrixToRpy(T[:3, :3]))
            place = f"xyz {xyz} mm, rpy {rpy} deg"
        yield f"  {label}: {place}"


def _parameters(found: Inspection) -> Iterator[str]:
    """Parameters of the model, and what the poses can tell of them."""
    o, names = found.observability, found.model.names
    marks = ("" if alone else "*" for alone in o.identifiable)
    marked = "" if all(o.identifiable) else ", * known in combination with others only"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in o.indices.items())
    yield f"Parameters of the model '{found.model.name}' ({len(names)}{marked}):"
    yield wrap(", ".join(map("".join, zip(names, marks, strict=True))), "  ")
    yield ""
    yield wrap(
        f"Identifiable from {found.poses}: rank {o.rank} of {o.columns}, condition {o.condition:.1f}"
    )
    yield wrap(f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)")
    if o.unidentifiable:
        yield "These changes move nothing that is measured:"
        yield from (wrap(str(combination), "  ") for combination in o.unidentifiable)

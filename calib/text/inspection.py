"""Moved from calib.result.inspection."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib.model.dh import dh_table
from calib.result.inspection import Inspection
from calib.robot.robot import Robot
from calib.text.lines import wrap


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

"""What inspect finds as text: the chain, its DH rows, what poses can tell, and what a fit to them can reach."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib.design.forecast import Forecast
from calib.estimate.inspection import GENERIC_ANCHOR, GENERIC_TARGET, Inspection
from calib.model.dh import dh_table
from calib.robot.robot import Robot
from calib.text.lines import fill, wrap
from calib.text.summary import combination_text

_DEG = float(np.degrees(1.0))


def inspection_text(robot: Robot, found: Inspection, foreseen: Forecast | None = None) -> str:
    """The chain, its DH rows, what the poses can tell, and the forecast of a fit to them, in 100 columns."""
    parts = ["\n".join(part) for part in (_chain(robot), _dh(robot), _parameters(found))]
    if foreseen is not None:
        bound = foreseen.sigma * (foreseen.workspace_rank / foreseen.poses) ** 0.5
        numbers = (foreseen.sigma, foreseen.rms, foreseen.rms_low, foreseen.rms_high, foreseen.max)
        sigma, rms, low, high, most, best = (f"{1e3 * value:.3f}" for value in (*numbers, bound))
        parts.append(
            fill(
                f"Forecast for a fit of these {foreseen.poses} poses with a noise of {sigma} mm a coordinate: position "
                f"error {rms} mm rms over the joint limits (90 % of calibrations: {low} to {high}), {most} mm where it "
                f"is worst. The best {foreseen.poses} poses would give about {best} mm rms; calib plan finds such.",
                hang="  ",
            )
        )
    return "\n\n".join(parts)


def _chain(robot: Robot) -> Iterator[str]:
    """The chain's joints with their limits; those without a column of their own, and a base that moves."""
    yield f"Robot '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}:"
    yield f"  {'joint':<32}{'type':<12}{'axis':<24}limits"
    offsets = robot.chain_values(np.zeros(len(robot.inputs)))[0]
    followers = []
    for joint, row, offset in zip(robot.joints, robot.coupling, offsets, strict=True):
        axis = " ".join(f"{v + 0.0:.4g}" for v in joint.axis)
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (_DEG, "deg")
        limits = "none"
        if joint.lower is not None and joint.upper is not None:
            limits = f"{scale * joint.lower:.1f} to {scale * joint.upper:.1f} {unit}"
        yield from _row(joint.name, f"{joint.type:<12}{axis:<24}{limits}")
        rest, driver = f"{scale * offset:g} {unit}", robot.inputs[int(np.argmax(np.abs(row)))].name
        if not np.any(row):
            followers.append(f"'{joint.name}' is held at {rest}.")
        elif driver != joint.name:
            more = "" if offset == 0 else f", plus {rest}"
            factor = row[int(np.argmax(np.abs(row)))]
            followers.append(f"'{joint.name}' follows '{driver}', times {factor:g}{more}.")
    if robot.base_moves:
        followers.append(
            f"Joints move the base '{robot.base}' itself; they are passed from the base outwards."
        )
    yield from (wrap(text, "  ") for text in followers)


def _row(name: str, cells: str) -> list[str]:
    """A row of a table that begins with a joint's name; a long name gets a line of its own."""
    return [f"  {name:<32}{cells}"] if len(name) < 32 else [f"  {name}", f"  {'':<32}{cells}"]


def _four(value: float, scale: float) -> str:
    """A number with four digits, and no minus before a zero."""
    return f"{round(scale * value, 4) + 0.0:.4f}"


def _dh(robot: Robot) -> Iterator[str]:
    """The DH rows."""
    table, columns = dh_table(robot), "{:>12}{:>13}{:>12}{:>13}{:>12}"
    yield "Standard DH rows, T = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta):"
    head = columns.format("a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "beta [deg]")
    yield f"  {'joint':<32}{head}"
    for row in table.rows:
        pairs = ((row.a, 1e3), (row.alpha, _DEG), (row.d, 1e3), (row.theta, _DEG))
        beta = _four(row.beta, _DEG) if row.near_parallel else "-"
        yield from _row(row.joint, columns.format(*(_four(*pair) for pair in pairs), beta))
    yield "  beta is given only where axes are nearly parallel (Hayati); there d is set to 0 by convention."
    for label, T in (("base to DH frame 0", table.T_base_0), ("DH frame n to tip", table.T_n_tip)):
        place = "identity"
        if np.abs(T - np.eye(4)).max() >= 1e-9:
            xyz = " ".join(_four(v, 1e3) for v in T[:3, 3])
            rpy = " ".join(_four(v, _DEG) for v in pin.rpy.matrixToRpy(T[:3, :3]))
            place = f"xyz {xyz} mm, rpy {rpy} deg"
        yield f"  {label}: {place}"


def _parameters(found: Inspection) -> Iterator[str]:
    """Parameters of the model, and what the poses can tell of them."""
    o, names = found.observability, found.model.names
    marks = ("" if alone else "*" for alone in o.identifiable)
    marked = "" if all(o.identifiable) else ", * known in combination with others only"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in o.indices.items())
    poses = f"the {found.poses} estimation rows of {found.source}"
    if found.source is None:
        poses = f"{found.poses} poses spread over the joint limits"
    for name, place, frame in (
        ("target", GENERIC_TARGET, "off the tip"),
        ("anchor", GENERIC_ANCHOR, "from the base"),
    ):
        if name in found.assumed:
            poses += f", {name} {', '.join(f'{1e3 * v:.0f}' for v in place)} mm {frame}"
    yield f"Parameters of the model '{found.model.name}' ({len(names)}{marked}):"
    yield wrap(", ".join(map("".join, zip(names, marks, strict=True))), "  ")
    yield ""
    yield wrap(
        f"Identifiable from {poses}: rank {o.rank} of {o.columns}, condition {o.condition:.1f}"
    )
    yield wrap(f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)")
    if o.unidentifiable:
        yield "Unidentifiable combinations, which move nothing that is measured:"
        yield from (wrap(combination_text(one), "  ") for one in o.unidentifiable)

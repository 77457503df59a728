"""A result as a corrected MJCF: of the robot's own MJCF, or of one that has the same robot with frames of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.errors import CalibError, ModelError, choices
from calib.robot.default_tip import farthest_link
from calib.robot.mjcf import Mjcf
from calib.robot.mjcf_write import check_one_robot, model_of, write_mjcf
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.transfer import transferred
from calib.robot.urdf import Urdf, read_urdf
from calib.show.mjcf_text import mjcf_sentences
from calib.show.verdict_text import do_not_use_text
from calib.verbs.convert.format import Format, Note, Notes, Options, Source


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write the corrected MJCF of a result, after reading it back; see `calib.robot.mjcf_write`."""
    result = source.require_calibration()
    nominal, corrected = result.nominal, result.robot
    check_one_robot(nominal)
    q = random_joint_values(nominal)
    poses = np.concatenate([chain.poses(q) for chain in corrected.chains])
    notes: list[Note] = []
    given = options.robot
    urdf = None if given is None else _mjcf_urdf(given)
    if urdf is None or urdf.data == nominal.urdf.data:
        model = model_of(nominal.urdf, str(path)) if urdf is None else Mjcf.read(_path(urdf))
        robot = corrected
    else:
        model = Mjcf.read(_path(urdf))
        other, matched = _same_chain(nominal, urdf, options)
        transfer = transferred(nominal, corrected, other)
        robot = transfer.robot
        poses = transfer.T_base_base @ poses @ transfer.T_tip_tip
        sentence = (
            "The axes of '{0}' and '{1}' agree to {2:.2g} mm and {3:.2g} mrad before the correction; the tip is '{4}' "
            "in '{5}'."
        )
        values = (nominal.urdf.source, urdf.source, *transfer.off, other.tip, other.base)
        notes.append(Note("axes agree", sentence, values))
        if matched:
            notes.append(Note("joints by their order", f"Joints by their order: {matched}."))
    written = write_mjcf(
        model,
        robot,
        q,
        poses,
        path,
        overwrite=options.overwrite,
        verdict=do_not_use_text(result.verdict),
    )
    notes += [Note("corrected MJCF", sentence) for sentence in mjcf_sentences(written)]
    return tuple(notes)


def _mjcf_urdf(given: object) -> Urdf:
    """Return the URDF of the MJCF that was given as a robot; `CalibError` if it is none."""
    urdf = given.urdf if isinstance(given, Robot) else read_urdf(str(given))
    if urdf.mjcf is None:
        raise CalibError(
            f"'{urdf.source}' is no MuJoCo model; --to mjcf takes as --robot the MJCF that is to be corrected."
        )
    return urdf


def _path(urdf: Urdf) -> Path:
    """Return the file of an MJCF that has been read."""
    assert urdf.path is not None, "an MJCF is read from a file"
    return urdf.path


def _same_chain(nominal: Robot, urdf: Urdf, options: Options) -> tuple[Robot, str]:
    """Return the chain of an MJCF with the joints of a nominal robot, and which ones were matched by their order.

    Joints have the same names, or else are as many. Base and tip are those that the options name; by default the world,
    and the tip of the robot's name or the farthest link.
    """
    names = [joint.name for joint in nominal.joints]
    own = {joint.name for joint in urdf.joints}
    base = options.base or urdf.root
    by_name = set(names) <= own
    tip = options.tip
    if tip is None and nominal.tip in urdf.links and by_name:
        tip = nominal.tip
    if tip is None:
        tip = farthest_link(urdf, base, names if by_name else None)
    other = Robot.from_urdf(urdf, base, tip)
    others = [joint.name for joint in other.joints]
    matched = ""
    new_names = dict(zip(names, others, strict=False))
    if names != others:
        if by_name:
            raise ModelError(
                f"'{urdf.source}' has the joints {choices(others)} between '{base}' and '{tip}', and the result's are "
                f"{choices(names)}. Name the links of the MJCF by --base and --tip."
            )
        matched = ", ".join(f"{name} = {new}" for name, new in new_names.items())
    held = {new_names.get(name, name): value for name, value in nominal.held.items()}
    held = {name: value for name, value in held.items() if name in own}
    coupling = {
        new_names.get(name, name): {new_names.get(of, of): factor for of, factor in row.items()}
        for name, row in nominal.reading_coupling.items()
    }
    if held or coupling:
        other = Robot.from_urdf(urdf, base, tip, held=held, coupling=coupling)
    return other, matched


def of_source(options: Options) -> Options:
    """Return the options with which the result is read: robot, base and tip are those of the MJCF to be written."""
    return replace(options, robot=None, base=None, tip=None)


FORMATS = {
    "mjcf": Format(
        "the MuJoCo model with corrected bodies",
        (".xml", ".mjcf"),
        _write,
        options_of_source=of_source,
    )
}

"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because the arm is found in it. What a file has no place for is
returned as a note; what is written is read back before it appears.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import FileError, ModelError, choices
from calib.files import write_atomically
from calib.formats.notes import Note, Source, displaced
from calib.formats.ur_arms import (
    MODELS,
    TOLERANCE,
    UrModel,
    at_flange,
    chain_of_rows,
    chain_poses,
    kinematics_hash,
    ur_model,
    ur_robot,
)
from calib.formats.ur_files import (
    Conf,
    UrYaml,
    conf_bytes,
    kinematics_bytes,
    read_kinematics,
    read_nominal,
)
from calib.formats.ur_mount import SPREAD, Mount, distance_from, the_mount
from calib.model.anchoring import anchored_placements, check_same_joints
from calib.model.dh import dh_table
from calib.model.dh_table import STANDARD
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

#: Written rows may differ from the robot by this [m and rad]; and where axes are almost parallel, which is said.
_EXACT, _LESS_EXACT = 1e-9, 1e-6

#: A displacement below this is rounding [m and rad].
_ROUNDING = 1e-12

#: A number this near to the one that it replaces is that one: theta, a, d, alpha [rad], [m].
_SAME = np.array([1e-14, 1e-13, 1e-12, 1e-14])

#: A calibration that moves the flange further may be of another arm [m]; none moves it further than the second.
_SUSPECT, _FARTHEST = 0.01, 0.2


@dataclass(frozen=True, slots=True, eq=False)
class UrWritten:
    """What was written, and displacements of base and flange (4, 4) [m] that the file cannot hold.

    With the file's own kinematics K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool.
    """

    path: Path
    T_base: Array
    T_tool: Array
    notes: tuple[Note, ...]


def read_ur(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> Source:
    """The arm that a ``calibration.conf`` or a ``kinematics.yaml`` of the ROS driver describes.

    A ``.conf`` needs one of: ``urcontrol``, a file with the nominal rows; ``model``, such as ``"UR5e"``; ``robot``, the
    nominal robot whose URDF is corrected, by default a bare one. A yaml is of the arm that it is nearest to.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    conf = Conf.read(path) if Path(path).suffix.lower() == ".conf" else None
    content = read_kinematics(path) if conf is None else None

    def chain_of(one: UrModel) -> Array:
        """The chain that the file makes of an arm; a yaml has the same for each."""
        if conf is not None:
            return chain_of_rows(one.rows + conf.deltas)
        assert content is not None  # it is one of the two
        return content.chain

    given = None if model is None else ur_model(model)
    if urcontrol is not None:
        arm = _of_rows(read_nominal(urcontrol), urcontrol, given)
    elif robot is not None:
        arm = the_mount(robot, given).model
    else:
        arm = given or _nearest(path, content)
    nominal = ur_robot(arm) if robot is None else robot
    mounted = the_mount(nominal, arm)
    moved = _checked_distance(path, arm, chain_of)
    placements = mounted.placements_of(chain_of(arm), nominal)
    notes = list(_name_note(nominal, mounted))
    if conf is not None:
        hash: str | None = kinematics_hash(arm.rows + conf.deltas)
        placements = anchored_placements(placements, nominal.placements, nominal.joints)
        notes += _not_certain(path, arm, chain_of, moved) if urcontrol is None else ()
        notes += [Note("not linearised", (str(path), conf.status))] if conf.status else []
    else:
        hash = content.hash if content else None
        if robot is None and model is None:
            names = " or ".join(one.name for one in MODELS if one.same(arm.rows))
            notes.append(Note("arm by kinematics", (str(path), names)))
        notes += [Note("no hash", (str(path),))] if hash is None else []
    if any(one.default_hash == hash for one in MODELS):
        notes.append(Note("nominal hash", (str(path),)))
    kind = "ur-yaml" if conf is None else "ur-conf"
    calibrated = nominal.with_placements(placements)
    return Source(kind, calibrated, nominal, hash, arm, conf, tuple(notes))


def write_ur_yaml(
    robot: Robot,
    nominal: Robot,
    path: PathLike,
    *,
    hash: str,
    model: UrModel | str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    ``nominal`` is what the robot was corrected from; ``hash`` is that of the robot's own file; ``model`` is the arm,
    default what the nominal robot is recognised as. The file is read back and compared before it appears.

    Raises:
        ModelError: No Universal Robots arm, no correction of it, or a file that does not read back.
        FileError: The file cannot be written, or the hash is none.
    """
    mounted, chain = _chain_of(robot, nominal, model)
    chain = at_flange(chain)
    T_tool = np.eye(4) if np.abs(chain[6] - np.eye(4)).max() < _ROUNDING else chain[6]
    kind = mounted.model.name if mounted.model.known else "arm"
    comment = f"Kinematics of one Universal Robots {kind}: lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll)."
    data = kinematics_bytes(chain, hash, comment)
    back = read_kinematics(path, data).chain
    _check(robot, mounted, path, lambda q: chain_poses(back, q) @ T_tool, _EXACT)
    written = write_atomically(path, data, overwrite=overwrite)
    notes = (*_name_note(nominal, mounted), *displaced("flange displaced", T_tool))
    return UrWritten(written, read_only(np.eye(4)), read_only(T_tool), notes)


def write_ur_conf(
    robot: Robot,
    nominal: Robot,
    path: PathLike,
    *,
    update: Conf | None = None,
    like: Array | None = None,
    model: UrModel | str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    As `write_ur_yaml`; ``update`` is a file of this arm whose other lines are kept, ``like`` are deltas (6, 4) whose
    signs and whole turns are kept, so that what did not change is the same number; default: those of ``update``.
    """
    mounted, chain = _chain_of(robot, nominal, model)
    arm = mounted.model
    if update is not None:
        _checked_distance("--update", arm, lambda one: chain_of_rows(one.rows + update.deltas))
        like = update.deltas
    bare = ur_robot(arm)
    same = bare.with_placements(the_mount(bare, arm).placements_of(chain, bare))
    table = dh_table(same, STANDARD, like=bare)
    found = np.array([[row.theta, row.a, row.d, row.alpha] for row in table.rows])
    wished = np.zeros((6, 4)) if like is None else like
    deltas = _in_the_sense_of(found, arm.rows + wished) - arm.rows
    deltas = read_only(np.where(np.abs(deltas - wished) < _SAME, wished, deltas))
    T_base, T_tool = (
        np.eye(4) if np.abs(T - np.eye(4)).max() < _ROUNDING else T
        for T in (table.T_base_0, table.T_n_tip)
    )
    data = conf_bytes(deltas) if update is None else update.with_deltas(deltas)
    back = chain_of_rows(arm.rows + Conf.read(path, data).deltas)
    missed = np.abs(T_base @ chain_poses(back, SPREAD) @ T_tool - chain_poses(chain, SPREAD)).max()
    notes = list(_name_note(nominal, mounted))
    if missed > _EXACT:
        notes.append(Note("digits lost", (float(missed),)))
    exact = _LESS_EXACT if missed > _EXACT else _EXACT
    _check(robot, mounted, path, lambda q: T_base @ chain_poses(back, q) @ T_tool, exact)
    written = write_atomically(path, data, overwrite=overwrite)
    if update is not None and update.others:
        notes.append(Note("other lines kept", (", ".join(update.others),)))
    notes += [*displaced("base displaced", T_base), *displaced("flange displaced", T_tool)]
    return UrWritten(written, read_only(T_base), read_only(T_tool), tuple(notes))


def _in_the_sense_of(rows: Array, wished: Array) -> Array:
    """The same rows (6, 4) with common normals of the wished senses, and angles in the turns of the wished ones.

    Of the two senses of a normal that with the sign of alpha; between parallel axes that with the nearer theta.
    """
    result = np.array(rows)
    for i in range(5):
        theta, alpha = result[i, 0] - wished[i, 0], np.sin([result[i, 3], wished[i, 3]])
        if alpha[0] * alpha[1] < 0.0 if abs(alpha[1]) > 0.5 else np.cos(theta) < 0.0:
            result[i] = result[i, 0] + np.pi, -result[i, 1], result[i, 2], -result[i, 3]
            result[i + 1, 0] += np.pi
    turns = np.round((wished - result)[:, [0, 3]] / (2.0 * np.pi))
    result[:, [0, 3]] += 2.0 * np.pi * turns
    return result


def _chain_of(robot: Robot, nominal: Robot, model: UrModel | str | None) -> tuple[Mount, Array]:
    """How the arm is mounted, and its placements when calibrated, shape (7, 4, 4), [m]."""
    mounted = the_mount(nominal, None if model is None else ur_model(model))
    check_same_joints(robot, nominal)
    chain = mounted.chain_of(robot)
    _checked_distance(robot.urdf.source, mounted.model, lambda _: chain)
    return mounted, chain


def _check(
    robot: Robot, mounted: Mount, path: PathLike, flange: Callable[[Array], Array], exact: float
) -> None:
    """Compare a file that was read back, what it has no place for put back, with the robot."""
    q = random_joint_values(robot)
    made = mounted.T_base_arm @ flange(q) @ mounted.T_flange_tip
    off = float(np.abs(made - robot.poses(q)).max())
    if not off <= exact:
        raise ModelError(
            f"{Path(path).name}: read back, it puts the tip of '{robot.name}' {off:.1e} m or rad off; {exact:g} is "
            "allowed, so it is not written. Please report this with what was converted."
        )


def _nearest(path: PathLike, content: UrYaml | None) -> UrModel:
    """The arm that the kinematics of a yaml are nearest to."""
    if content is None:
        raise ModelError(
            f"{path}: a calibration.conf has only what is added to an arm's nominal rows. Say of which arm it is, as "
            "in --ur-model UR5e, or give its --urcontrol, or its nominal URDF as --robot."
        )
    return min(MODELS, key=lambda one: distance_from(content.chain, one))


def _not_certain(
    path: PathLike, arm: UrModel, chain_of: Callable[[UrModel], Array], moved: float
) -> tuple[Note, ...]:
    """A note about other arms that deltas fit as well, which nothing in them tells apart."""
    most = max(_SUSPECT, 3.0 * moved)
    fitting = [one for one in MODELS if distance_from(chain_of(one), one) <= most]
    apart = max((distance_from(chain_of_rows(o.rows), arm) for o in fitting), default=0.0)
    alike = choices(one.name for one in fitting)
    return (
        (Note("arm not certain", (str(path), alike, arm.name, apart)),) if apart > TOLERANCE else ()
    )


def _of_rows(rows: Array, path: PathLike, given: UrModel | None) -> UrModel:
    """The arm that has the rows of a urcontrol.conf; it must be the one given."""
    if given is not None and not given.same(rows):
        raise ModelError(
            f"The rows in [DH] of {path} are not those of the {given.name}. Leave the name of the arm out, or give the "
            "urcontrol.conf of this robot's own controller."
        )
    names = [given.name] if given else [one.name for one in MODELS if one.same(rows)]
    return UrModel((names or [f"arm of {Path(path).name}"])[0], rows)


def _checked_distance(path: PathLike, arm: UrModel, chain_of: Callable[[UrModel], Array]) -> float:
    """How far a calibration moves the flange [m]: some millimetres, and centimetres that of an arm of another size."""
    moved = distance_from(chain_of(arm), arm)
    if moved > _SUSPECT:
        by_arm = {one.name: distance_from(chain_of(one), one) for one in MODELS}
        least = min(by_arm.values())
        if 3.0 * least < moved or moved > _FARTHEST:
            fitting = [name for name, distance in by_arm.items() if distance <= 3.0 * least]
            raise FileError(
                f"{path} moves the flange of a {arm.name} by up to {1e3 * moved:.0f} mm, and that of "
                f"{choices(fitting)} by {1e3 * least:.0f} mm; a calibration moves it by millimetres. Give the right "
                "--ur-model, --urcontrol or URDF, and numbers in metres and radians."
            )
    return moved


def _name_note(robot: Robot, mounted: Mount) -> tuple[Note, ...]:
    """A note about a robot that is not nominal, whose base and flange were found by name."""
    values = (robot.name, mounted.model.name, mounted.off, mounted.turned)
    return () if mounted.nominal else (Note("arm by name", values),)

"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because the arm is found in it. What a file has no place for is
returned as a note; what is written is read back before it appears.

``calibration.conf`` has the deltas of an arm in ``[mounting]``, ``urcontrol.conf`` its nominal rows in ``[DH]``: lists
``key = [six numbers]``, in metres and radians. ``kinematics.yaml`` has under ``kinematics`` x, y, z, roll, pitch, yaw
of six links and the calibration's hash: each the pose of a link's joint in the link before it, the first in the
controller's base, ``base_link_inertia``; joints turn about z, ``tool0`` is the last one's frame.
R = Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import configparser
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import yaml

from calib.compensation.nominal_actual import check_same_joints
from calib.diagnosis.reasons import Verdict
from calib.errors import FileError, ModelError, choices
from calib.files import read_bytes, write_atomically
from calib.formats.dh_files import Code, Note
from calib.formats.origins import parse_yaml
from calib.formats.ur_arms import (
    COLUMNS,
    LINKS,
    MODELS,
    Mount,
    UrModel,
    anchored_placements,
    at_flange,
    chain_of_rows,
    chain_poses,
    distance_from,
    kinematics_hash,
    the_mount,
    ur_model,
    ur_robot,
)
from calib.model.dh import STANDARD, dh_table
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot, read_only
from calib.units import NUMBER, Array

PathLike = str | os.PathLike[str]

_DELTAS = tuple(f"delta_{name}" for name in COLUMNS)

#: What is too large for a number [m, rad]: no delta in metres and radians, and no place on an arm. d runs away between
#: axes that are nearly parallel, theta with it.
_LARGEST_DELTA = dict(zip(_DELTAS, (8.0 * np.pi, 10.0, 1e9, 0.5), strict=True))
_LARGEST_NOMINAL = dict(zip(COLUMNS, (2.0 * np.pi, 10.0, 10.0, 2.0 * np.pi), strict=True))
_LARGEST_POSE = dict.fromkeys("xyz", 10.0) | dict.fromkeys(("roll", "pitch", "yaw"), 4.0 * np.pi)

#: What is written may differ from the robot by this [m and rad]; rows by the second, where axes are almost parallel.
_EXACT, _EXACT_ROWS = 1e-9, 1e-6

#: A displacement below this is rounding [m and rad].
_ROUNDING = 1e-12

#: A number this near to the one that it replaces is that one: theta, a, d, alpha [rad], [m].
_SAME = np.array([1e-14, 1e-13, 1e-12, 1e-14])

#: A calibration that moves the flange further may be of another arm [m]; none moves it further than the second. Arms
#: that differ by less than the third are one.
_SUSPECT, _FARTHEST, _ALIKE = 0.01, 0.2, 1e-6


class Conf(NamedTuple):
    """A ``calibration.conf``."""

    deltas: Array  #: shape (6, 4), ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` [rad], [m].
    others: tuple[str, ...]  #: The other keys of ``[mounting]``, such as ``joint_checksum``.
    status: str  #: Its ``calibration_status``; 2 is linearised.
    text: str  #: The whole file, a character for each byte.

    @classmethod
    def read(cls, path: PathLike, data: bytes | None = None) -> Conf:
        """What a file says, or will say that is to be written; `FileError` where it has not these numbers."""
        text = (read_bytes(path, "calibration.conf") if data is None else data).decode("latin-1")
        values = _section(path, text, "mounting")
        others = tuple(key for key in values if key not in _DELTAS)
        deltas = _columns(path, values, _LARGEST_DELTA)
        return cls(deltas, others, values.get("calibration_status", "2"), text)

    def with_deltas(self, deltas: Array) -> bytes:
        """The file with the lists of other deltas in place of its own, everything else as it was."""
        text = self.text
        for key, old, new in zip(_DELTAS, self.deltas.T, deltas.T, strict=True):
            if (old != new).any():  # else it stays, digit for digit
                text = re.sub(rf"(?m)^(\s*{key}\s*=\s*)\[[^\]]*\]", rf"\g<1>{_list(new)}", text)
        return text.encode("latin-1")


def conf_bytes(deltas: Array) -> bytes:
    """A ``calibration.conf`` with nothing but the deltas (6, 4)."""
    lines = [f"{key} = {_list(values)}" for key, values in zip(_DELTAS, deltas.T, strict=True)]
    return "\n".join(["[mounting]", *lines, ""]).encode()


def _list(values: Array) -> str:
    """Six numbers that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


def read_nominal(path: PathLike) -> Array:
    """The nominal rows (6, 4) of a ``urcontrol.conf``: ``a``, ``d``, ``alpha`` of ``[DH]``, and ``theta`` or zeros."""
    text = read_bytes(path, "urcontrol.conf").decode("latin-1")
    values = {"theta": "0, 0, 0, 0, 0, 0", **_section(path, text, "DH")}
    return _columns(path, values, _LARGEST_NOMINAL)


def _section(path: PathLike, text: str, name: str) -> dict[str, str]:
    """The keys of a section, which may come again further down, and their values."""
    parser = configparser.ConfigParser(
        strict=False, interpolation=None, inline_comment_prefixes=("#", ";"), default_section=""
    )
    try:
        parser.read_string(text)
    except configparser.Error as error:
        reason = " ".join(str(error).split())
        raise FileError(f"{path} cannot be read as sections of keys: {reason}") from error
    return dict(parser[name]) if parser.has_section(name) else {}


def _columns(path: PathLike, values: dict[str, str], largest: Mapping[str, float]) -> Array:
    """The six numbers of each of some keys, shape (6, 4)."""
    columns = []
    for key, most in largest.items():
        words = values.get(key, "").strip("[] ").split(",")
        if len(words) != 6:
            raise FileError(
                f"{path}: {key} is no list of six numbers in brackets, one a joint; {choices(largest)} are wanted."
            )
        columns.append([_number(f"{path}: {key}", word.strip(), most) for word in words])
    return read_only(np.transpose(columns))


def _number(where: str, word: str, largest: float) -> float:
    """A number in metres or radians, finite and not too large for what it is."""
    number = float(word) if NUMBER.fullmatch(word) else np.inf
    if not abs(number) <= largest:
        raise FileError(
            f"{where}: '{word[:40]}' is no number up to {largest:.4g}. Lengths are in metres, angles in radians."
        )
    return number


def read_kinematics(path: PathLike, data: bytes | None = None) -> tuple[Array, str | None]:
    """The chain of a ``kinematics.yaml``, or one to be written, shape (7, 4, 4) [m], and its hash; or `FileError`."""
    numbers, hash = read_numbers(path, data)
    chain = np.tile(np.eye(4), (7, 1, 1))
    for (*xyz, roll, pitch, yaw), T in zip(numbers, chain, strict=False):
        T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(roll, pitch, yaw), xyz
    return read_only(chain), hash


def read_numbers(path: PathLike, data: bytes | None = None) -> tuple[Array, str | None]:
    """The numbers of a ``kinematics.yaml`` as they stand in it, or will, and its hash.

    Args:
        path: The file.
        data: Its bytes, where it is not written yet.

    Returns:
        x, y, z [m], roll, pitch and yaw [rad] of the six links, shape (6, 6); the hash, None where there is none.

    Raises:
        FileError: It cannot be read, or has not these numbers.
    """
    what = "kinematics.yaml"
    top = parse_yaml(read_bytes(path, what) if data is None else data, str(path), what)
    links = top.get("kinematics")
    links = links if isinstance(links, dict) else {}
    numbers = []
    for link in LINKS:
        values = links.get(link)
        if not isinstance(values, dict) or not _LARGEST_POSE.keys() <= values.keys():
            raise FileError(
                f"{path}: under 'kinematics' there is no '{link}' with {choices(_LARGEST_POSE)}; a "
                f"kinematics.yaml has {choices(LINKS)}."
            )
        numbers.append(
            [
                _number(f"{path}: {key} of '{link}'", str(values[key]), most)
                for key, most in _LARGEST_POSE.items()
            ]
        )
    hash = links.get("hash")
    return read_only(numbers), str(hash) if hash else None


def kinematics_bytes(chain: Array, hash: str, like: Array | None = None) -> bytes:
    """A ``kinematics.yaml`` of a chain.

    Args:
        chain: shape (7, 4, 4), [m], of which the first six are written.
        hash: The hash of the robot's own calibration.
        like: shape (6, 6), numbers of the robot's own file [m], [rad], as of `read_numbers`; a number that differs from
            its own by rounding stays as it stands there.

    Returns:
        The bytes of the file; its numbers read back exactly, but for rounding, which is written as 0.

    Raises:
        FileError: The hash is none.
    """
    if not re.fullmatch(r"[\w.+-]+", hash):
        raise FileError(
            f"The hash is '{hash[:40]}', not one such as 'calib_12788084448423163542'. Take the line from the robot's "
            "own kinematics.yaml or calibration.conf."
        )
    table: dict[str, object] = {}
    for link, T in zip(LINKS, chain, strict=False):
        values = np.array([*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3])])
        values = np.where(np.abs(values) < _ROUNDING, 0.0, values)
        if like is not None:
            before = like[LINKS.index(link)]
            values = np.where(np.abs(values - before) < _ROUNDING, before, values)
        table[link] = dict(zip(_LARGEST_POSE, values.tolist(), strict=True))
    table["hash"] = hash
    text = yaml.safe_dump({"kinematics": table}, sort_keys=False)
    return f"# Lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).\n{text}".encode()


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A robot read from a file of some kind, and the same chain with nominal kinematics, if these are known.

    Of Universal Robots' files also the driver's name of the calibration, the arm, and a ``calibration.conf``.
    """

    kind: str
    robot: Robot
    nominal: Robot | None
    hash: str | None = None
    model: UrModel | None = None
    conf: Conf | None = None
    numbers: Array | None = None  #: Those of a ``kinematics.yaml``, see `read_numbers`.
    notes: tuple[Note, ...] = ()
    #: That of a result; None of any other file, and where nothing was judged.
    verdict: Verdict | None = None


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
    own, hash = read_kinematics(path) if conf is None else (None, None)
    numbers = read_numbers(path)[0] if conf is None else None

    def chain_of(one: UrModel) -> Array:
        """The chain that the file makes of an arm; a yaml has the same for each."""
        return own if conf is None else chain_of_rows(one.rows + conf.deltas)  # type: ignore[return-value]

    given = None if model is None else ur_model(model)
    if urcontrol is not None:
        arm = _of_rows(read_nominal(urcontrol), urcontrol, given)
    elif robot is not None:
        arm = the_mount(robot, given).model
    elif given is not None:
        arm = given
    elif conf is None:
        arm = min(MODELS, key=lambda one: distance_from(chain_of(one), one))
    else:
        raise ModelError(
            f"{path}: a calibration.conf has only what is added to an arm's nominal rows. Say of which arm it is, as "
            "in --ur-model UR5e, or give its --urcontrol, or its nominal URDF as --robot."
        )
    nominal = ur_robot(arm) if robot is None else robot
    moved = _checked_distance(path, arm, chain_of)
    placements = the_mount(nominal, arm).placements_of(chain_of(arm), nominal)
    notes = []
    if conf is not None:
        hash = kinematics_hash(arm.rows + conf.deltas)
        axes = [np.asarray(joint.axis) for joint in nominal.joints]
        placements = anchored_placements(placements, nominal.placements, axes)
        # Other arms that the deltas fit as well: nothing in them tells these apart.
        most = max(_SUSPECT, 3.0 * moved)
        fitting = [one for one in MODELS if distance_from(chain_of(one), one) <= most]
        apart = max((distance_from(one.chain, arm) for one in fitting), default=0.0)
        if urcontrol is None and apart > _ALIKE:
            alike = choices(one.name for one in fitting)
            notes.append(Note("arm not certain", (str(path), alike, arm.name, apart)))
        if conf.status != "2":
            notes.append(Note("not linearised", (str(path), conf.status[:40])))
    if any(kinematics_hash(one.rows) == hash for one in MODELS):
        notes.append(Note("nominal hash", (str(path),)))
    kind = "ur-yaml" if conf is None else "ur-conf"
    corrected = nominal.with_placements(placements)
    return Source(kind, corrected, nominal, hash, arm, conf, numbers, tuple(notes))


@dataclass(frozen=True, slots=True, eq=False)
class UrWritten:
    """What was written, and displacements of base and flange (4, 4) [m] that the file cannot hold.

    With the file's own kinematics K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool.
    """

    path: Path
    T_base: Array
    T_tool: Array
    notes: tuple[Note, ...]


def write_ur_yaml(
    source: Source,
    path: PathLike,
    hash: str,
    *,
    like: Array | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    The file is read back and compared before it appears.

    Args:
        source: What is written.
        path: The file.
        hash: That of the robot's own file.
        like: The numbers of that file, see `kinematics_bytes`; None: those of the source, if it is such a file.
        overwrite: Whether a file that exists is replaced.

    Returns:
        What was written, and what the file cannot hold.

    Raises:
        ModelError: No Universal Robots arm, no correction of it, or a file that does not read back.
        FileError: The file cannot be written, or the hash is none.
    """
    mounted, chain = _chain_of(source, path)
    chain = at_flange(chain)
    T_tool = _rounded(chain[6])
    data = kinematics_bytes(chain, hash, source.numbers if like is None else like)
    back, _ = read_kinematics(path, data)
    _check(source.robot, mounted, path, [np.eye(4), back, T_tool], _EXACT)
    written = write_atomically(path, data, overwrite=overwrite)
    return UrWritten(written, np.eye(4), T_tool, _displaced("flange displaced", T_tool))


def write_ur_conf(
    source: Source, path: PathLike, update: PathLike | None = None, *, overwrite: bool = False
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    As `write_ur_yaml`; ``update`` is a file of this arm whose other lines are kept. The deltas have the signs and whole
    turns of those of ``update``, or else of the source, so that what did not change is the same number.
    """
    mounted, chain = _chain_of(source, path)
    arm, own = mounted.model, None if update is None else Conf.read(update)
    like = own or source.conf
    notes: tuple[Note, ...] = ()
    if own is not None:
        _checked_distance("--update", arm, lambda one: chain_of_rows(one.rows + own.deltas))
        notes = (Note("other lines kept", (", ".join(own.others),)),) if own.others else ()
    elif like is not None and like.others:
        notes = (Note("other lines left out", (choices(like.others),)),)
    bare = ur_robot(arm)
    same = bare.with_placements(the_mount(bare, arm).placements_of(chain, bare))
    table = dh_table(same, STANDARD, like=bare)
    found = np.array([[row.theta, row.a, row.d, row.alpha] for row in table.rows])
    wished = np.zeros((6, 4)) if like is None else like.deltas
    deltas = _in_the_sense_of(found, arm.rows + wished) - arm.rows
    deltas = np.where(np.abs(deltas - wished) < _SAME, wished, deltas)
    T_base, T_tool = _rounded(table.T_base_0), _rounded(table.T_n_tip)
    data = conf_bytes(deltas) if own is None else own.with_deltas(deltas)
    back = chain_of_rows(arm.rows + Conf.read(path, data).deltas)
    _check(source.robot, mounted, path, [T_base, back, T_tool], _EXACT_ROWS)
    written = write_atomically(path, data, overwrite=overwrite)
    notes += _displaced("base displaced", T_base) + _displaced("flange displaced", T_tool)
    return UrWritten(written, T_base, T_tool, notes)


def _rounded(T: Array) -> Array:
    """A pose, the identity where it is that but for rounding."""
    return read_only(np.eye(4) if np.abs(T - np.eye(4)).max() < _ROUNDING else T)


def _displaced(code: Code, T: Array) -> tuple[Note, ...]:
    """A displacement T (4, 4) that a file has no place for: three lengths [m] and a rotation vector [rad]."""
    vector = np.round([*T[:3, 3], *pin.log3(T[:3, :3])], 9) + 0.0
    return (Note(code, tuple(vector.tolist())),) if np.any(vector) else ()


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


def _chain_of(source: Source, path: PathLike) -> tuple[Mount, Array]:
    """How the arm is mounted, and its placements when calibrated, shape (7, 4, 4), [m]."""
    if source.nominal is None or source.model is None:
        raise ModelError(
            f"{path}: this format is for arms of Universal Robots, and the nominal robot is none that is known. Name "
            "the arm with --ur-model, or give its nominal URDF as --robot."
        )
    mounted = the_mount(source.nominal, source.model)
    check_same_joints(source.robot, source.nominal)
    chain = mounted.chain_of(source.robot)
    _checked_distance(source.robot.urdf.source, mounted.model, lambda _: chain)
    return mounted, chain


def _check(robot: Robot, mounted: Mount, path: PathLike, made: list[Array], exact: float) -> None:
    """Compare a file that was read back, between displacements that it has no place for, with the robot."""
    T_base, chain, T_tool = made
    q = random_joint_values(robot)
    flange = T_base @ chain_poses(chain, q) @ T_tool
    poses = mounted.T_base_arm @ flange @ mounted.T_flange_tip
    off = float(np.abs(poses - robot.poses(q)).max())
    if not off <= exact:
        raise ModelError(
            f"{Path(path).name}: read back, it puts the tip of '{robot.name}' {off:.1e} m or rad off; {exact:g} is "
            "allowed, so it is not written. Please report this with what was converted."
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

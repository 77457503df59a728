"""A corrected MJCF: pos and orientation of bodies changed where they stand, every other byte as it was.

Of the placements O_i of a body's k joints and A of the body after them (`calib.robot.mjcf_urdf`):

    T_i = O_1 J_1(ref_1) ... O_i J_i(ref_i),    T_parent_B = T_k A

A body with one joint keeps the joint's pos and axis. Of several joints in one body those before the last change too,
because the last one's placement has no other place: they are T_parent_B^-1 T_i, seen from the body.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.files import check_writable, write_atomically
from calib.errors import FileError, ModelError, UrdfError
from calib.robot.mjcf import Mjcf, MjcfBody, Placed
from calib.robot.mjcf_elements import ORIENTATIONS
from calib.robot.mjcf_files import MjcfFile, Node
from calib.robot.mjcf_orientation import number_text, orientation_text
from calib.robot.mjcf_readback import check_by_mujoco
from calib.robot.mjcf_urdf import Names, mjcf_urdf, motion, shift, urdf_names
from calib.robot.readback import check_close
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: A change below this is rounding, and is not written [m; rotation matrices: 1].
_ROUNDING = 1e-13


@dataclass(frozen=True, slots=True)
class WrittenMjcf:
    """A corrected MJCF: its files and what changed in them."""

    #: The files, the main one first.
    paths: tuple[Path, ...]
    #: Elements whose orientation could not keep its form, as ``body 'link1'``, and now is a ``quat``.
    new_quats: tuple[str, ...]
    #: Joints whose pos or axis changed.
    changed_joints: tuple[str, ...]
    #: True if the model names meshes or other files that are looked for beside the main file, which lies elsewhere now.
    lacks_assets: bool
    #: True if MuJoCo has read it too.
    read_by_mujoco: bool


def is_mjcf_name(path: str | Path) -> bool:
    """Return True for the name of a file that is written as an MJCF, not as a URDF."""
    return Path(path).suffix.lower() in (".xml", ".mjcf")


def model_of(urdf: Urdf, name: str) -> Mjcf:
    """Return the MuJoCo model that a URDF was made from, read again from its file.

    Args:
        urdf: The URDF.
        name: The file to write, for messages.

    Raises:
        FileError: The URDF was made from no MJCF, or the file is not there any more.
        UrdfError: The file was changed since.
    """
    stated = urdf.mjcf
    # A corrected URDF still states the MJCF that it was made from.
    if stated is None or (urdf.path is not None and urdf.path.name != stated.file):
        raise FileError(
            f"'{name}' is the name of a MuJoCo model, and the robot was read from a URDF: name the corrected one "
            ".urdf. To put a result into the MJCF of the same robot: "
            "calib convert result.json --to mjcf --robot scene.xml"
        )
    if urdf.path is None or not urdf.path.is_file():
        raise FileError(
            f"'{name}': the MJCF '{urdf.path or stated.file}' that the result was made with is not there; name it: "
            "calib convert result.json --to mjcf --robot FILE"
        )
    model = Mjcf.read(urdf.path)
    read_again = Urdf.from_bytes(mjcf_urdf(model), urdf.source).mjcf
    if read_again is None or read_again.sha256 != stated.sha256:
        raise UrdfError(
            f"'{name}': the MJCF '{urdf.path}' was changed since the result was made. Use the file as it was, or "
            "name the changed one: calib convert result.json --to mjcf --robot FILE"
        )
    return model


def check_mjcf_output(robot: Robot, path: str | Path) -> None:
    """Refuse, before any work is done, a name under which a robot's corrected MJCF cannot be written.

    Args:
        robot: The nominal robot.
        path: The file to write; a name of no MJCF is no fault.

    Raises:
        FileError: It is the name of an MJCF, and the robot was read from none, or it is a file of the model.
        ModelError: There are several robots.
        UrdfError: The model was changed since it was read.
    """
    if is_mjcf_name(path):
        check_one_robot(robot)
        _check_no_source(model_of(robot.urdf, str(path)), Path(path))


def check_one_robot(robot: Robot) -> None:
    """Refuse several robots by `ModelError`: an MJCF is written for one."""
    if robot.parts:
        raise ModelError(
            "An MJCF is written for one robot, and these are several: write their URDFs (.urdf), or calibrate each by "
            "itself."
        )


def _check_no_source(model: Mjcf, path: Path) -> None:
    """Refuse by `FileError` to write over a file of the model itself."""
    if path.resolve() in {file.path.resolve() for file in model.files.files}:
        raise FileError(f"'{path}' is a file of the model itself; choose another name.")


def write_mjcf(
    model: Mjcf,
    robot: Robot,
    q: Array,
    expected: Array,
    path: str | Path,
    *,
    overwrite: bool,
    verdict: str = "",
) -> WrittenMjcf:
    """Write a corrected MJCF with the files that it includes, after calib and MuJoCo have read it back.

    An included file that changes is written beside the main one, as ``NAME_included.xml``, and the ``<include>`` names
    it. In another folder than the model's all included files are.

    Args:
        model: The model as it is.
        robot: The corrected robot, whose URDF was made from the model.
        q: Shape (N, m), joint readings at which it is checked [rad or m].
        expected: Shape (N, 4, 4), [m], T_base_tip at these; of several chains one after the other.
        path: The main file.
        overwrite: Whether files that exist are replaced.
        verdict: The verdict against it, which a comment before the outermost element states; empty for none.

    Raises:
        FileError: A file exists, is one of the model, or cannot be written.
        UrdfError: calib or MuJoCo reads it otherwise.
    """
    path = Path(path)
    edits = _Edits(model)
    edits.place(robot)
    files = edits.files(path, verdict)
    for new in files:
        _check_no_source(model, new)
        check_writable(new, overwrite=overwrite)

    corrected = Mjcf.read(path, files)
    again = robot.rebuilt(Urdf.from_bytes(mjcf_urdf(corrected), path.name))
    by_chain = expected.reshape(-1, len(q), 4, 4)
    for chain, poses in zip(again.chains, by_chain, strict=True):
        check_close("calib", chain.tip, chain.poses(q), poses)
    read_by_mujoco = all(
        check_by_mujoco(corrected, chain, q, poses)
        for chain, poses in zip(again.chains, by_chain, strict=True)
    )
    for new, data in reversed(files.items()):
        write_atomically(new, data, overwrite=overwrite)
    elsewhere = path.resolve().parent != model.files.files[0].path.resolve().parent
    return WrittenMjcf(
        tuple(files),
        tuple(edits.new_quats),
        tuple(edits.changed_joints),
        elsewhere and any("file" in node.attributes for node in model.files.root.walk()),
        read_by_mujoco,
    )


class _Edits:
    """The attributes that change, by element."""

    def __init__(self, model: Mjcf) -> None:
        self.model = model
        self.new_quats: list[str] = []
        self.changed_joints: list[str] = []
        #: File and element by the element's identity, with its new attributes and their new names.
        self._values: dict[int, tuple[Node, dict[str, str], dict[str, str]]] = {}

    def place(self, robot: Robot) -> None:
        """Note what the placements of a corrected robot change."""
        origins = dict(robot.origins())
        bodies, sites, _ = urdf_names(self.model)
        frames = {
            names.fixed: shift(-body.joints[-1].pos)
            for body in self.model.bodies
            if (names := bodies[body.name]).moving and names.fixed is not None
        }
        for limb in robot.limbs:
            _fold(limb, origins, frames)
        for body in self.model.bodies:
            names = bodies[body.name]
            if any(name in origins for name in (*names.moving, names.fixed)):
                self._place_body(body, names, origins, robot.urdf)
        for site in self.model.sites:
            name = sites[site.name].fixed
            if name in origins:
                self._place(site, origins[name])

    def _place_body(
        self, body: MjcfBody, names: Names, origins: Mapping[str, Array], urdf: Urdf
    ) -> None:
        """Note the new pos and orientation of a body, and of its joints where they change; see the module's text."""

        def origin(name: str) -> Array:
            """Return an origin of the URDF, corrected or as it is."""
            return np.asarray(origins.get(name, urdf.joint(name).T_parent_joint))

        T = np.eye(4)
        seen = []
        for joint in body.joints:
            T = T @ origin(joint.name) @ motion(joint, joint.ref)
            seen.append(T)
        if names.fixed is not None:
            T = T @ origin(names.fixed)
        self._place(body, T)
        for joint, T_parent_joint in zip(body.joints, seen, strict=True):
            in_body = rigid_inverse(T) @ T_parent_joint
            pos, axis = in_body[:3, 3], in_body[:3, :3] @ joint.axis
            into_frame = rigid_inverse(joint.T_body_frame)
            values = {}
            if joint.type != "slide" and np.abs(pos - joint.pos).max() > _ROUNDING:
                values["pos"] = number_text(into_frame[:3, :3] @ pos + into_frame[:3, 3])
            if np.abs(axis - joint.axis).max() > _ROUNDING:
                values["axis"] = number_text(into_frame[:3, :3] @ axis)
            if values:
                self.changed_joints.append(joint.name)
                self._values[id(joint.node)] = (joint.node, values, {})

    def _place(self, placed: Placed, T_parent_own: Array) -> None:
        """Note the new pos and orientation of a body or a site, if they change."""
        T = rigid_inverse(placed.T_parent_frame) @ T_parent_own
        differs = np.abs(T - placed.T_frame_own) > _ROUNDING
        values: dict[str, str] = {}
        renamed: dict[str, str] = {}
        by_ends = "fromto" in placed.attributes
        if differs[:3, 3].any() or (by_ends and differs.any()):
            values["pos"] = number_text(T[:3, 3])
        if differs[:3, :3].any() or (by_ends and differs.any()):
            key, text = orientation_text(
                placed.node, placed.attributes, self.model.compiler, T[:3, :3]
            )
            values[key] = text
            for form in ("fromto", *ORIENTATIONS):
                if form in placed.attributes and form != key:
                    self.new_quats.append(f"{placed.node.tag} '{placed.name}'")
                    renamed[form] = key
        if values:
            self._values[id(placed.node)] = (placed.node, values, renamed)

    def files(self, path: Path, verdict: str) -> dict[Path, bytes]:
        """Return the bytes of the files to write by their paths, the main one first."""
        files = self.model.files
        main = files.files[0]
        patches: dict[Path, list[tuple[int, int, bytes]]] = {file.path: [] for file in files.files}
        copied = {main.path}
        if path.resolve().parent != main.path.resolve().parent:
            copied |= set(patches)
        for node, values, renamed in self._values.values():
            tag = node.file.document.start_tag_with(node.element, values, renamed)
            patches[node.file.path].append((node.element.start, node.element.end, tag))
            copied |= set(self._ways_to(node.file))
        new_paths = {main.path: path}
        for file in files.files[1:]:
            if file.path not in copied:
                continue
            new_name = f"{path.stem}_{file.path.name}"
            while path.parent / new_name in new_paths.values():
                new_name = "_" + new_name
            new_paths[file.path] = path.parent / new_name
            by, element = files.includes[file.path]
            tag = by.document.start_tag_with(element, {"file": new_name})
            patches[by.path].append((element.start, element.end, tag))
        if verdict:
            first = main.document.root.start
            comment = main.document.comment(f"calib verdict: {verdict}")
            patches[main.path].append((first, first, comment))
        result = {}
        for file in files.files:
            if file.path in new_paths:
                result[new_paths[file.path]] = file.document.patched(patches[file.path])
        return result

    def _ways_to(self, file: MjcfFile) -> Iterator[Path]:
        """Yield the paths of a file and of those through which the main file includes it."""
        yield file.path
        while file.path in self.model.files.includes:
            file, _ = self.model.files.includes[file.path]
            yield file.path


def _fold(limb: Robot, origins: dict[str, Array], frames: Mapping[str, Array]) -> None:
    """Move the correction of a tip from the place behind a body's last joint to what fixes the tip to the body, if any.

    That place is no element of the MJCF: a correction there would move the joint's axis in the body. ``frames`` are
    these places as the model has them, by the names of their joints.
    """
    carrier = limb.carriers[-1]
    if carrier is None or carrier not in frames:
        return
    path = list(limb.path)
    after = path[path.index(carrier) + 1 :]
    if after:
        change = rigid_inverse(frames[carrier]) @ origins[carrier]
        origins[after[0]] = change @ limb.urdf.joint(after[0]).T_parent_joint
        origins[carrier] = frames[carrier]

"""URDF in, URDF out: new joint origins and links, with every other byte of the file kept."""

from __future__ import annotations

import hashlib
import importlib.metadata
import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element as AnyElement

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import UrdfError, choices, did_you_mean
from calib.files import check_no_xacro, read_bytes, write_atomically
from calib.robot.urdf_joints import UrdfJoint, path_from_root, read_tree
from calib.robot.urdf_xml import Document, Element, element_tree
from calib.robot.xacro_file import XacroCall, flattened, is_xacro

__all__ = ["SAME", "Urdf", "UrdfJoint"]

FloatArray = NDArray[np.float64]

SAME = 1e-14
"""Entries of two poses that differ by no more than this are the same [m; rotation matrices: 1]."""

_NOT_A_ROTATION = 1e-9


@dataclass(frozen=True, slots=True)
class Urdf:
    """A URDF: its bytes and the kinematic tree they state. Two are equal when their bytes are.

    Attributes:
        data: The file, byte for byte.
        source: Name of the file, for messages; a xacro's with its arguments.
        path: Where it, or the xacro that it was flattened from, was read; or None.
        name: Name of the robot; empty if it has none.
        joints: The joints in the file's order.
        links: Names of the links in the file's order.
    """

    data: bytes = field(repr=False)
    source: str = field(compare=False)
    path: Path | None = field(compare=False)
    name: str = field(compare=False)
    joints: tuple[UrdfJoint, ...] = field(repr=False, compare=False)
    links: tuple[str, ...] = field(repr=False, compare=False)
    _document: Document = field(repr=False, compare=False)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Urdf:
        """Read a URDF file.

        Raises:
            FileError: The file cannot be read.
            UrdfError: It is not a URDF that can be calibrated; the text says where and why.
        """
        path = Path(path)
        data = read_bytes(path, "URDF")
        return cls._from_document(Document.from_bytes(data, path.name), path)

    @classmethod
    def from_bytes(cls, data: bytes, source: str, path: Path | None = None) -> Urdf:
        """Parse the bytes of a URDF.

        Args:
            data: The URDF.
            source: What messages call it.
            path: The file that it comes from, beside which its meshes lie; None if there is none.

        Raises:
            UrdfError: As for `read`.
        """
        return cls._from_document(Document.from_bytes(data, source), path)

    @classmethod
    def _from_document(cls, document: Document, path: Path | None) -> Urdf:
        """Interpret the elements and check the tree."""
        joints, links = read_tree(document)
        name = document.root.attributes.get("name", "")
        return cls(document.data, document.source, path, name, joints, links, document)

    @property
    def encoding(self) -> str:
        """Encoding that decodes `data`, the byte order mark (if any) left out."""
        return "utf-8-sig" if self.data.startswith(b"\xef\xbb\xbf") else self._document.encoding

    @property
    def sha256(self) -> str:
        """SHA-256 of the bytes, in hexadecimal."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def root(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links if link not in children)

    def elements(self) -> AnyElement:
        """The whole file as elements, a tree of its own at each call."""
        return element_tree(self._document)

    def joint(self, name: str) -> UrdfJoint:
        """The joint of that name.

        Raises:
            UrdfError: There is none.
        """
        return self.joints[self._joint_index(name)]

    def chain(self, base: str, tip: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The joints between two links.

        Args:
            base: Name of a link.
            tip: Name of a link.

        Returns:
            Names of the joints from the links' nearest common ancestor down to ``base``, and from
            there down to ``tip``, both in the order from root to leaf. Fixed joints are among them.

        Raises:
            UrdfError: A name is not that of a link.
        """
        for name in (base, tip):
            self._check_link(name)
        up = {joint.child: joint for joint in self.joints}
        to_base, to_tip = path_from_root(base, up), path_from_root(tip, up)
        pairs = zip(to_base, to_tip, strict=False)
        shared = len(list(itertools.takewhile(lambda pair: pair[0] == pair[1], pairs)))
        return to_base[shared:], to_tip[shared:]

    def with_origins(self, origins: Mapping[str, FloatArray]) -> Urdf:
        """The URDF with other joint origins; only the <origin> start tags of those joints change.

        ``xyz`` is rewritten only if the translation changes, ``rpy`` only if the rotation does:
        entries within `SAME` of `UrdfJoint.T_parent_joint` count as unchanged, so that a pose that
        went through another library's rounding leaves the bytes alone. A missing <origin> is added.

        Args:
            origins: Pose of the joint's frame in its parent link, (4, 4) [m], by joint name.

        Returns:
            The new URDF. Numbers are written so that they read back exactly; rotations agree to
            rounding, pitch = +-pi/2 included.

        Raises:
            UrdfError: A name is not that of a joint, or a matrix is not a pose.
        """
        elements = self._document.root.all("joint")
        patches: list[tuple[int, int, bytes]] = []
        for name, T_parent_joint in origins.items():
            index = self._joint_index(name)
            T_new = _pose(T_parent_joint, f"origin of joint '{name}'")
            T_now = self.joints[index].T_parent_joint
            patches += _patch(self._document, elements[index], T_now, T_new)
        if not patches:
            return self
        return Urdf._from_document(self._document.patched(patches), self.path)

    def with_link(self, name: str, parent: str, T_parent_link: FloatArray) -> Urdf:
        """The URDF with a massless link fixed to ``parent``, written just before ``</robot>``.

        Args:
            name: Name of the new link; its joint is called ``<name>_joint``.
            parent: Name of the link that carries it.
            T_parent_link: Pose of the new link in ``parent``, (4, 4) [m].

        Raises:
            UrdfError: ``parent`` is not a link, a name is taken or empty, or the matrix is no pose.
        """
        self._check_link(parent)
        joint_name = f"{name}_joint"
        if not name or name in self.links or joint_name in {joint.name for joint in self.joints}:
            raise UrdfError(
                f"no link can be added to {self.source} as '{name}': that name is empty or taken, "
                f"or the name of its joint, '{joint_name}', is; choose another or use with_origins"
            )
        T = _pose(T_parent_link, f"pose of link '{name}'")
        document = self._document
        link, joint = document.quoted(name), document.quoted(joint_name)
        lines = (
            (0, b"<link name=" + link + b"/>"),
            (0, b"<joint name=" + joint + b' type="fixed">'),
            (1, b"<parent link=" + document.quoted(parent) + b"/>"),
            (1, b"<child link=" + link + b"/>"),
            (1, _origin_tag(T)),
            (0, b"</joint>"),
        )
        close = document.root.close
        outer = document.line_head(close)
        if outer is None:  # </robot> shares its line, and so does the new link
            patch = (close, close, b"".join(line for _, line in lines))
        else:
            inner = document.line_head(document.root.children[-1].start) or outer + b"  "
            step = inner[len(outer) :] if inner.startswith(outer) else b"  "
            before = close - len(outer)
            patch = (before, before, b"".join(inner + step * deep + line for deep, line in lines))
        return Urdf._from_document(document.patched([patch]), self.path)

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the bytes to a file, whole or not at all.

        Raises:
            FileError: The file exists and ``overwrite`` is False, it cannot be written, or its name is a xacro's.
        """
        check_no_xacro(path)
        return write_atomically(path, self.data, overwrite=overwrite)

    def _joint_index(self, name: str) -> int:
        """Where the joint stands in `joints`; UrdfError if there is none."""
        names = [joint.name for joint in self.joints]
        if name in names:
            return names.index(name)
        message = f"{self.source} has no joint '{name}'"
        if name in self.links:
            message += ": that is a link, the name of a joint is wanted"
        message += f"{did_you_mean(name, names)}. Its joints: {choices(names)}"
        raise UrdfError(message)

    def _check_link(self, name: str) -> None:
        """UrdfError unless there is a link of that name."""
        if name in self.links:
            return
        message = f"{self.source} has no link '{name}'"
        for joint in self.joints:
            if joint.name == name:
                message += f": that is a joint, a link is wanted; the joint moves '{joint.child}'"
                break
        else:
            message += did_you_mean(name, self.links)
        message += f". Its links: {choices(self.links)}"
        raise UrdfError(message)


def _pose(matrix: FloatArray, what: str) -> FloatArray:
    """A (4, 4) pose out of what was given; UrdfError if it is none."""
    T = np.asarray(matrix, dtype=np.float64)
    if T.shape == (4, 4) and np.isfinite(T).all() and (T[3] == (0, 0, 0, 1)).all():
        R = T[:3, :3]
        if np.abs(R.T @ R - np.eye(3)).max() <= _NOT_A_ROTATION and np.linalg.det(R) > 0:
            return T
    raise UrdfError(
        f"{what}: {T.tolist()} is no pose; a (4, 4) matrix of a rotation and a translation is wanted"
    )


def _numbers(values: FloatArray) -> str:
    """Numbers that read back exactly, without -0."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def _xyz_rpy(T: FloatArray) -> dict[str, str]:
    """The attributes of an <origin>; Pinocchio's rpy is accurate at pitch = +-pi/2, too."""
    return {"xyz": _numbers(T[:3, 3]), "rpy": _numbers(pin.rpy.matrixToRpy(T[:3, :3]))}


def _origin_tag(T: FloatArray) -> bytes:
    """A whole <origin/>."""
    values = _xyz_rpy(T)
    return f'<origin xyz="{values["xyz"]}" rpy="{values["rpy"]}"/>'.encode()


def _patch(
    document: Document, joint: Element, T_now: FloatArray, T_new: FloatArray
) -> list[tuple[int, int, bytes]]:
    """What to write for a new origin, and over which bytes; empty if nothing changes."""
    changed = {
        "xyz": bool((np.abs(T_new[:3, 3] - T_now[:3, 3]) > SAME).any()),
        "rpy": bool((np.abs(T_new[:3, :3] - T_now[:3, :3]) > SAME).any()),
    }
    if not any(changed.values()):
        return []
    for origin in joint.all("origin"):
        values = {key: text for key, text in _xyz_rpy(T_new).items() if changed[key]}
        return [(origin.start, origin.end, document.start_tag_with(origin, values))]
    margin = document.line_head(joint.children[0].start) or b""
    return [(joint.end, joint.end, margin + _origin_tag(T_new))]


def read_urdf(source: str | Path) -> Urdf:
    """The URDF of a file, of a xacro with the arguments behind it, or of a robot of example-robot-data.

    The ``data`` of a xacro's URDF are the flattened text, its ``path`` is that of the file, and its ``source`` the
    file's name with the arguments.

    Raises:
        FileError: The file cannot be read.
        UrdfError: No such robot, no URDF, or a xacro that cannot be flattened.
    """
    if not is_xacro(source):
        return Urdf.read(find_urdf(source))
    call = XacroCall.parse(source)
    data = flattened(call)
    try:
        return Urdf.from_bytes(data, call.name, call.path)
    except UrdfError as error:
        raise UrdfError(
            f"{str(error).rstrip('.')}. This is about the flattened text: xacro FILE ARGUMENTS > robot.urdf"
        ) from error


def find_urdf(source: str | Path) -> Path:
    """The URDF file that a path or a robot's name means.

    A name is looked for in the file list of the installed ``example-robot-data`` package, as
    ``<name>_robot.urdf`` and then ``<name>.urdf``: that package's own loader returns a UR5 for ``"ur3"``.

    Raises:
        UrdfError: Neither a file nor a known robot.
    """
    path = Path(source)
    if path.suffix or len(path.parts) != 1 or os.path.isfile(path):  # noqa: PTH113  of any length
        return path
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    urdfs = {file.name: Path(str(file.locate())) for file in files if file.suffix == ".urdf"}
    for name in (f"{source}_robot.urdf", f"{source}.urdf"):
        if name in urdfs:
            return urdfs[name]
    known = sorted(name.removesuffix(".urdf").removesuffix("_robot") for name in urdfs)
    raise UrdfError(
        f"'{source}' is neither a file here nor a robot of example-robot-data. Give the path of a URDF or "
        f"xacro, or one of {choices(dict.fromkeys(known), limit=60)}."
    )

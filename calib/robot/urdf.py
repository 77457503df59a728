"""URDF in, URDF out: new joint origins and links, with every other byte of the file kept."""

from __future__ import annotations

import difflib
import hashlib
import importlib.metadata
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from xml.etree.ElementTree import Element as AnyElement

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.errors import UrdfError, choices, did_you_mean
from calib.files import check_no_xacro, read_bytes, write_atomically
from calib.robot.urdf_xml import XACRO_FIX, Document, Element
from calib.robot.xacro_file import XacroCall, flattened, is_xacro
from calib.units import NUMBER, Array

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

SAME = 1e-14  #: Entries of two poses that differ by no more are the same [m; rotation matrices: 1].

_ZERO_AXIS = 1e-9

#: How a comment begins that states the verdict on a corrected URDF.
_VERDICT = "calib verdict: "


def read_only(values: ArrayLike) -> Array:
    """A copy of the values as a float64 array that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint as the URDF states it."""

    name: str  #: Name of the joint.
    type: str  #: One of `JOINT_TYPES`.
    parent: str  #: Name of the parent link.
    child: str  #: Name of the child link.
    xyz: Array  #: Translation of the origin in the parent link, (3,) [m].
    rpy: Array  #: Rotation of the origin about the fixed x, y, z axes, (3,) [rad].
    axis: Array  #: Unit vector in the joint's frame, (3,); (1, 0, 0) for fixed and floating joints.
    mimic: str | None  #: Name of the joint that drives this one, or None.
    lower: float | None  #: Lower limit [rad or m]; None where none is stated or the type has none.
    upper: float | None  #: Upper limit, likewise.
    mimic_multiplier: float = 1.0  #: Factor of the driving joint's value.
    mimic_offset: float = 0.0  #: Added to it [rad or m].

    @property
    def T_parent_joint(self) -> Array:
        """The origin: pose of the joint's frame in the parent link, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = pin.rpy.rpyToMatrix(*self.rpy)
        T[:3, 3] = self.xyz
        return read_only(T)


@dataclass(frozen=True, slots=True)
class Urdf:
    """A URDF: its bytes and the kinematic tree they state. Two are equal when their bytes are."""

    data: bytes = field(repr=False)  #: The file, byte for byte.
    #: Name of the file, for messages; a xacro's with its arguments.
    source: str = field(compare=False)
    #: Where it, or the xacro that it was flattened from, was read; or None.
    path: Path | None = field(compare=False)
    name: str = field(compare=False)  #: Name of the robot; empty if it has none.
    #: The joints in the file's order.
    joints: tuple[UrdfJoint, ...] = field(repr=False, compare=False)
    #: Names of the links in the file's order.
    links: tuple[str, ...] = field(repr=False, compare=False)
    _document: Document = field(repr=False, compare=False)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Urdf:
        """Read a URDF file."""
        return cls.from_bytes(read_bytes(path, "URDF"), Path(path).name, Path(path))

    @classmethod
    def from_bytes(cls, data: bytes, source: str, path: Path | None = None) -> Urdf:
        """Parse the bytes of a URDF; ``path`` is the file that they come from, beside which its meshes lie.

        Raises:
            UrdfError: It is not a URDF that can be calibrated; the text says where and why.
        """
        document = Document.from_bytes(data, source)
        joints, links = _read_tree(document)
        name = document.root.attributes.get("name", "")
        return cls(data, source, path, name, joints, links, document)

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

    @property
    def verdict(self) -> str:
        """The verdict that a comment of the file states, as `with_verdict` wrote it; empty if there is none."""
        stated = [comment.text.strip() for comment in self._document.comments]
        found = [text.removeprefix(_VERDICT) for text in stated if text.startswith(_VERDICT)]
        return found[0] if found else ""

    def elements(self) -> AnyElement:
        """The whole file as elements, a new tree at each call."""
        return self._document.elements()

    def joint(self, name: str) -> UrdfJoint:
        """The joint of that name; UrdfError if there is none."""
        return self.joints[self._joint_index(name)]

    def chain(self, base: str, tip: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The joints, fixed ones included, from two links' nearest common ancestor down to ``base`` and to ``tip``."""
        above = {joint.child: joint for joint in self.joints}
        to_base: list[str] = []
        to_tip: list[str] = []
        for link, path in ((base, to_base), (tip, to_tip)):
            self._check_link(link)
            at = link
            while at in above:
                path.insert(0, above[at].name)
                at = above[at].parent
        while to_base and to_tip and to_base[0] == to_tip[0]:
            del to_base[0], to_tip[0]
        return tuple(to_base), tuple(to_tip)

    def with_origins(self, origins: Mapping[str, Array]) -> Urdf:
        """The URDF with other joint origins; only the <origin> start tags of those joints change.

        ``xyz`` is rewritten only if the translation changes by more than `SAME`, ``rpy`` only if the rotation does.
        Numbers read back exactly; rotations agree to rounding, pitch = +-pi/2 included. A missing <origin> is added.

        Args:
            origins: Pose of the joint's frame in its parent link, (4, 4) [m], by joint name.

        Raises:
            UrdfError: A name is not that of a joint.
        """
        elements = self._document.root.all("joint")
        patches: list[tuple[int, int, bytes]] = []
        for name, T in origins.items():
            joint = elements[self._joint_index(name)]
            differs = np.abs(T - self.joint(name).T_parent_joint) > SAME
            changed = {"xyz": differs[:3, 3].any(), "rpy": differs[:3, :3].any()}
            values = {key: text for key, text in _xyz_rpy(T).items() if changed[key]}
            origin = next(iter(joint.all("origin")), None)
            if values and origin is not None:
                new = self._document.start_tag_with(origin, values)
                patches.append((origin.start, origin.end, new))
            elif values:
                margin = self._document.line_head(joint.children[0].start) or b""
                patches.append((joint.end, joint.end, margin + _origin_tag(T)))
        return self._patched(patches) if patches else self

    def with_link(self, name: str, parent: str, T_parent_link: Array) -> Urdf:
        """The URDF with a massless link fixed to ``parent`` by ``<name>_joint``, written just before ``</robot>``."""
        self._check_link(parent)
        joint_name = f"{name}_joint"
        if not name or name in self.links or joint_name in {joint.name for joint in self.joints}:
            raise UrdfError(
                f"no link can be added to {self.source} as '{name}': that name is empty or taken, "
                f"or the name of its joint, '{joint_name}', is; choose another or use with_origins"
            )
        document = self._document
        link, joint = document.quoted(name), document.quoted(joint_name)
        lines = (
            (0, b"<link name=" + link + b"/>"),
            (0, b"<joint name=" + joint + b' type="fixed">'),
            (1, b"<parent link=" + document.quoted(parent) + b"/>"),
            (1, b"<child link=" + link + b"/>"),
            (1, _origin_tag(T_parent_link)),
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
        return self._patched([patch])

    def with_verdict(self, text: str) -> Urdf:
        """The URDF with a verdict as a comment on a line before ``<robot>``, in place of one that it states already.

        Args:
            text: The verdict and its reason, which `verdict` reads back; empty for a URDF without such a comment.

        Returns:
            The URDF; all its other bytes are those of this one.
        """
        document = self._document
        patches = [
            (comment.start, document.line_after(comment.end), b"")
            for comment in document.comments
            if comment.text.strip().startswith(_VERDICT)
        ]
        if text:
            first = document.root.start
            patches.append((first, first, document.comment(_VERDICT + text)))
        return self._patched(patches) if patches else self

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the bytes to a file, whole or not at all."""
        check_no_xacro(path)
        return write_atomically(path, self.data, overwrite=overwrite)

    def _patched(self, patches: list[tuple[int, int, bytes]]) -> Urdf:
        """The URDF with bytes start to end replaced, for every (start, end, new)."""
        data = self.data
        for start, end, new in sorted(patches, reverse=True):
            data = data[:start] + new + data[end:]
        return Urdf.from_bytes(data, self.source, self.path)

    def _joint_index(self, name: str) -> int:
        """Where the joint stands in `joints`; UrdfError if there is none."""
        names = [joint.name for joint in self.joints]
        if name in names:
            return names.index(name)
        is_link = ": that is a link, the name of a joint is wanted" if name in self.links else ""
        raise UrdfError(
            f"{self.source} has no joint '{name}'{is_link}{did_you_mean(name, names)}. Its joints: {choices(names)}"
        )

    def _check_link(self, name: str) -> None:
        """UrdfError unless there is a link of that name."""
        if name in self.links:
            return
        child = next((joint.child for joint in self.joints if joint.name == name), None)
        hint = did_you_mean(name, self.links)
        if child is not None:
            hint = f": that is a joint, a link is wanted; the joint moves '{child}'"
        raise UrdfError(
            f"{self.source} has no link '{name}'{hint}. Its links: {choices(self.links)}"
        )


def _read_tree(document: Document) -> tuple[tuple[UrdfJoint, ...], tuple[str, ...]]:
    """The joints and the names of the links, both in the file's order."""
    root = document.root
    elements = root.all("joint")
    if root.tag != "robot":
        known = {"sdf": "SDF (Gazebo)", "mujoco": "MJCF (MuJoCo)", "COLLADA": "a COLLADA mesh"}
        looks = f", it looks like {known[root.tag]}" if root.tag in known else ""
        text = f"the outermost element is <{root.tag}>{looks}; a URDF has <robot>"
        raise document.at(root, text)
    if not elements:
        text = "<robot> has no <joint>; a URDF with the joints themselves is wanted"
        raise document.at(root, text)
    links = _unique_names(document, root.all("link"))
    _unique_names(document, elements)
    joints = tuple(_joint(document, element) for element in elements)
    _check_tree(document, joints, links)
    return joints, links


def _unique_names(document: Document, elements: list[Element]) -> tuple[str, ...]:
    """The names of links or joints, which must be there once each."""
    lines: dict[str, int] = {}
    for element in elements:
        name = element.attributes.get("name", "")
        if not name:
            text = f'a <{element.tag}> has no name; give it name="..."'
            raise document.at(element, text)
        if name in lines:
            text = (
                f"a second {element.tag} '{name}', the first is in line {lines[name]}; rename one"
            )
            raise document.at(element, text)
        lines[name] = element.line
    return tuple(lines)


def _joint(document: Document, element: Element) -> UrdfJoint:
    """What a ``<joint>`` states."""
    kind = element.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        text = f" has the type '{kind}'; the types are {choices(JOINT_TYPES)}"
        raise _fault(document, element, text)
    numbers = partial(_numbers, document, element)
    axis, zeros = (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    direction = read_only(axis if kind in ("fixed", "floating") else numbers("axis", "xyz", axis))
    length = float(np.linalg.norm(direction))
    if length < _ZERO_AXIS:
        text = ': the axis is zero; give its direction, xyz="0 0 1" for example'
        raise _fault(document, element, text)
    limits = [np.nan, np.nan]
    if kind in ("revolute", "prismatic"):
        limits = [numbers("limit", key, (np.nan,))[0] for key in ("lower", "upper")]
    lower, upper = (None if np.isnan(value) else value for value in limits)
    return UrdfJoint(
        name=element.attributes["name"],
        type=kind,
        parent=_link(document, element, "parent"),
        child=_link(document, element, "child"),
        xyz=read_only(numbers("origin", "xyz", zeros)),
        rpy=read_only(numbers("origin", "rpy", zeros)),
        axis=read_only(direction / length),
        mimic=_link(document, element, "mimic", "joint") if element.all("mimic") else None,
        lower=lower,
        upper=upper,
        mimic_multiplier=numbers("mimic", "multiplier", (1.0,))[0],
        mimic_offset=numbers("mimic", "offset", (0.0,))[0],
    )


def _fault(
    document: Document, element: Element, text: str, part: Element | None = None
) -> UrdfError:
    """An error about a joint, with the line of one of its parts."""
    return document.at(part or element, f"joint '{element.attributes['name']}'{text}")


def _part(document: Document, element: Element, tag: str) -> Element | None:
    """The joint's child of that name, None without; refused if there are several."""
    found = element.all(tag)
    if len(found) > 1:
        raise _fault(document, element, f" has {len(found)} <{tag}>; keep one")
    return found[0] if found else None


def _link(document: Document, element: Element, tag: str, key: str = "link") -> str:
    """The value of ``<tag key="...">``, which must be there."""
    part = _part(document, element, tag)
    value = part.attributes.get(key, "") if part else ""
    if not value:
        raise _fault(document, element, f' lacks <{tag} {key}="...">')
    return value


def _numbers(
    document: Document, element: Element, tag: str, key: str, default: tuple[float, ...]
) -> tuple[float, ...]:
    """The finite numbers of ``<tag key="...">``, as many as the default, which is for none."""
    part = _part(document, element, tag)
    if part is None or key not in part.attributes:
        return default
    text = part.attributes[key]
    words = re.split("[ \t\r\n]+", text.strip(" \t\r\n"))  # XML's white space only
    if len(words) == len(default) and all(NUMBER.fullmatch(word) for word in words):
        values = tuple(float(word) for word in words)
        if np.isfinite(values).all():
            return values
    wanted = f"{len(default)} finite numbers" if len(default) > 1 else "a finite number"
    xacro = f"; this is xacro, {XACRO_FIX}" if "${" in text or "$(" in text else ""
    raise _fault(document, element, f": {key} of <{tag}> is '{text}', {wanted} wanted{xacro}", part)


def _check_tree(document: Document, joints: tuple[UrdfJoint, ...], links: tuple[str, ...]) -> None:
    """Refuse links that do not exist or have two parents, several roots, and loops."""
    above: dict[str, UrdfJoint] = {}
    for joint, element in zip(joints, document.root.all("joint"), strict=True):
        for link in (joint.parent, joint.child):
            if link not in links:
                text = f"joint '{joint.name}' names the link '{link}', which does not exist"
                raise document.at(element, text + did_you_mean(link, links))
        if joint.child in above:
            text = (
                f"link '{joint.child}' is the child of both '{above[joint.child].name}' and "
                f"'{joint.name}'; a URDF is a tree, a closed loop cannot be written in it"
            )
            raise document.at(element, text)
        above[joint.child] = joint
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise UrdfError(
            f"{document.source} has {len(roots)} root links: {choices(roots)}; join them by fixed "
            "joints so that one is left"
        )
    reached = set(roots)
    while new := {j.child for j in joints if j.parent in reached} - reached:
        reached |= new
    loop = sorted(joint.name for joint in joints if joint.child not in reached)
    if loop:
        raise UrdfError(
            f"{document.source}: the joints {choices(loop)} form a loop; a URDF is a tree"
        )


def _xyz_rpy(T: Array) -> dict[str, str]:
    """The attributes of an <origin>, read back exactly; Pinocchio's rpy is accurate at pitch = +-pi/2, too."""
    values = {"xyz": T[:3, 3], "rpy": pin.rpy.matrixToRpy(T[:3, :3])}
    return {key: " ".join(repr(float(v) + 0.0) for v in value) for key, value in values.items()}


def _origin_tag(T: Array) -> bytes:
    """A whole <origin/>."""
    return '<origin xyz="{xyz}" rpy="{rpy}"/>'.format(**_xyz_rpy(T)).encode()


def read_urdf(source: str | Path) -> Urdf:
    """The URDF of a file, of a xacro with the arguments behind it, or of a robot of example-robot-data."""
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


@lru_cache(maxsize=1)
def robot_data_urdfs() -> dict[str, Path]:
    """The URDF files of the installed example-robot-data by name, from its list of files, which is long."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    return {file.name: Path(str(file.locate())) for file in files if file.suffix == ".urdf"}


def find_urdf(source: str | Path) -> Path:
    """The URDF file that a path, or the name of a robot of example-robot-data, means; UrdfError without.

    ``<name>_robot.urdf`` comes before ``<name>.urdf``: that package's own loader returns a UR5 for ``"ur3"``.
    """
    path = Path(source)
    if path.suffix or len(path.parts) != 1 or os.path.isfile(path):  # noqa: PTH113  of any length
        return path
    urdfs = robot_data_urdfs()
    for name in (f"{source}_robot.urdf", f"{source}.urdf"):
        if name in urdfs:
            return urdfs[name]
    known = sorted({name.removesuffix(".urdf").removesuffix("_robot") for name in urdfs})
    raise UrdfError(
        f"'{source}' is neither a file here nor a robot of example-robot-data{_similar(str(source), known)}. Give "
        f"the path of a URDF or xacro, or one of {choices(known)}."
    )


def _similar(name: str, known: list[str]) -> str:
    """Names of robots like the one given, as the end of a message, none of them as if it were the one that is meant.

    A ``ur10e`` is no ``ur10``: its first link is 53 mm longer.

    Args:
        name: The name given.
        known: The names of the robots that there are.

    Returns:
        Those that begin with the name, or that it begins with; else those that differ by few letters.
    """
    given = name.casefold()
    found = [
        robot
        for robot in known
        if robot.casefold().startswith(given) or given.startswith(robot.casefold())
    ]
    found = found or difflib.get_close_matches(given, known, n=3)
    return f" (similar names there, which may be other robots: {choices(found)})" if found else ""

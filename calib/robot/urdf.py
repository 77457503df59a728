"""URDF in, URDF out: new joint origins and links, with every other byte of the file kept."""

from __future__ import annotations

import difflib
import hashlib
import importlib.metadata
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element as AnyElement

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.basics.files import check_urdf_name, read_bytes, write_atomically
from calib.basics.json_files import parse_json
from calib.basics.values import Value
from calib.errors import CalibError, UrdfError, choices, did_you_mean
from calib.robot import flange
from calib.robot.arm_models import ARMS, named_arm_urdf
from calib.robot.cylinder_urdf import REMARK, dh_urdf
from calib.robot.dh_file import ENDINGS, read_dh_robot, robot_of_json
from calib.robot.dh_rows import DHRobot
from calib.robot.mjcf import Mjcf
from calib.robot.mjcf_files import is_mjcf
from calib.robot.mjcf_urdf import REMARK as MJCF_REMARK, MjcfOrigin, mjcf_urdf
from calib.robot.ur_models import MODELS
from calib.robot.urdf_tree import UrdfJoint, read_tree
from calib.robot.urdf_xml import Document
from calib.robot.xacro_file import XacroCall, flatten, is_xacro

#: Name of the link that carries the target in a corrected URDF, when asked for.
TARGET_LINK = "calib_target"

#: Name of the link that is added at the measurement frame; of several, ``_NAME`` is added.
FRAME_LINK = "calib_frame"

#: Entries of two poses that differ by no more are the same [m; rotation matrices: 1].
SAME = 1e-14

#: The beginning of a comment that states the verdict on a corrected URDF.
_VERDICT = "calib verdict: "

#: The beginning of a comment that states the run of which a corrected URDF is a file.
_RUN = "calib run: "


@dataclass(frozen=True, slots=True)
class Urdf(Value):
    """A URDF: its bytes and the kinematic tree they state. Two are equal when their bytes are."""

    #: The file, byte for byte.
    data: bytes = field(repr=False)
    #: Name of the file, for messages; a xacro's with its arguments.
    source: str = field(compare=False)
    #: The file that it, or the xacro that it was flattened from, was read from; None if it came as bytes.
    path: Path | None = field(compare=False)
    #: Name of the robot; empty if it has none.
    name: str = field(compare=False)
    #: The joints in the file's order.
    joints: tuple[UrdfJoint, ...] = field(repr=False, compare=False)
    #: Names of the links in the file's order.
    links: tuple[str, ...] = field(repr=False, compare=False)
    #: The elements and their positions in the bytes.
    _document: Document = field(repr=False, compare=False)
    #: The DH rows that it was made from, which know their lines in a table; None: a comment may state them.
    _rows: DHRobot | None = field(default=None, repr=False, compare=False)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Urdf:
        """Read a URDF file.

        Raises:
            FileError: It cannot be read.
            UrdfError: It is not a URDF that can be calibrated.
        """
        return cls.from_bytes(read_bytes(path, "URDF"), Path(path).name, Path(path))

    @classmethod
    def from_bytes(cls, data: bytes, source: str, path: Path | None = None) -> Urdf:
        """Parse the bytes of a URDF.

        Args:
            data: The file, byte for byte.
            source: Its name, for messages.
            path: The file that the bytes come from, beside which its meshes lie; None for none.

        Raises:
            UrdfError: It is not a URDF that can be calibrated; the text says where and why.
        """
        document = Document.from_bytes(data, source)
        joints, links = read_tree(document)
        name = document.root.attributes.get("name", "")
        return cls(document.data, source, path, name, joints, links, document)

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
        """The link that no joint has as its child."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links if link not in children)

    @property
    def verdict(self) -> str:
        """The verdict that a comment of the file states, as `with_comments` wrote it; empty if there is none."""
        return self._stated(_VERDICT)

    @property
    def run(self) -> str:
        """The run that a comment of the file states, as `with_comments` wrote it; empty if there is none."""
        return self._stated(_RUN)

    @property
    def dh(self) -> DHRobot | None:
        """The DH rows from which it was made, as a comment of the file states; None for any other URDF.

        A corrected URDF still has the rows from which the nominal one was made.

        Raises:
            UrdfError: The comment was changed, so that it makes no robot.
        """
        if self._rows is not None:
            return self._rows
        for comment in self._document.comments:
            text = comment.text.strip()
            if not text.startswith(REMARK):
                continue
            try:
                stated = parse_json(text.removeprefix(REMARK), self.source)
                return robot_of_json(stated, self.source)
            except CalibError as error:
                raise UrdfError(
                    f"{self.source}: the comment '{REMARK.strip(': ')}' was changed. Remove it, or write the URDF "
                    f"again from its rows. {error}"
                ) from error
        return None

    @property
    def mjcf(self) -> MjcfOrigin | None:
        """The MJCF from which it was made, as a comment of the file states; None for any other URDF.

        Raises:
            UrdfError: The comment was changed.
        """
        text = self._stated(MJCF_REMARK)
        if not text:
            return None
        try:
            stated = parse_json(text, self.source)
            return MjcfOrigin(
                stated["file"], stated["sha256"], stated["refused"], tuple(stated["mass_of_geoms"])
            )
        except (CalibError, KeyError, TypeError) as error:
            raise UrdfError(
                f"{self.source}: the comment '{MJCF_REMARK.strip(': ')}' was changed. Remove it, or read the MJCF "
                "again."
            ) from error

    def elements(self) -> AnyElement:
        """Return the whole file as elements, a new tree at each call."""
        return self._document.elements()

    def joint(self, name: str) -> UrdfJoint:
        """Return the joint of that name; UrdfError if there is none."""
        return self.joints[self._joint_index(name)]

    def chain(self, base: str, tip: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the joints that lead from the nearest common ancestor of two links to each of them.

        Args:
            base: Name of a link.
            tip: Name of a link.

        Returns:
            Names of joints, fixed ones included, from the ancestor down to ``base``, and down to ``tip``.

        Raises:
            UrdfError: There is no such link.
        """
        to_base = self._joints_above(base)
        to_tip = self._joints_above(tip)
        while to_base and to_tip and to_base[0] == to_tip[0]:
            del to_base[0], to_tip[0]
        return tuple(to_base), tuple(to_tip)

    def _joints_above(self, link: str) -> list[str]:
        """Return the names of the joints from the root to a link, in this order; UrdfError if there is no such link."""
        self._check_link(link)
        above = {joint.child: joint for joint in self.joints}
        names: list[str] = []
        while link in above:
            names.insert(0, above[link].name)
            link = above[link].parent
        return names

    def with_origins(self, origins: Mapping[str, Array]) -> Urdf:
        """Return the URDF with other joint origins; only the <origin> start tags of those joints change.

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
            values = {key: text for key, text in origin_attributes(T).items() if changed[key]}
            origin = next(iter(joint.all("origin")), None)
            if values and origin is not None:
                new = self._document.start_tag_with(origin, values)
                patches.append((origin.start, origin.end, new))
            elif values:
                margin = self._document.line_head(joint.children[0].start) or b""
                patches.append((joint.end, joint.end, margin + _origin_tag(T)))
        return self._patched(patches) if patches else self

    def with_link(self, name: str, parent: str, T_parent_link: Array) -> Urdf:
        """Return the URDF with a massless link fixed to another by ``<name>_joint``, written just before ``</robot>``.

        Args:
            name: Name of the new link.
            parent: Name of the link that it is fixed to.
            T_parent_link: Shape (4, 4), [m], its pose in the parent.

        Raises:
            UrdfError: The name is empty or taken, or there is no link ``parent``.
        """
        self._check_link(parent)
        joint_name = f"{name}_joint"
        joint_names = {joint.name for joint in self.joints}
        if not name or name in self.links or joint_name in joint_names:
            raise UrdfError(
                f"no link can be added to {self.source} as '{name}': that name is empty or taken, "
                f"or the name of its joint, '{joint_name}', is; choose another or use with_origins"
            )
        document = self._document
        link = document.quoted(name)
        # Each line with the number of steps that it is indented by.
        lines = [
            (0, b"<link name=" + link + b"/>"),
            (0, b"<joint name=" + document.quoted(joint_name) + b' type="fixed">'),
            (1, b"<parent link=" + document.quoted(parent) + b"/>"),
            (1, b"<child link=" + link + b"/>"),
            (1, _origin_tag(T_parent_link)),
            (0, b"</joint>"),
        ]
        close = document.root.close
        robot_indent = document.line_head(close)
        if robot_indent is None:  # </robot> shares its line
            joined = b"".join(line for _, line in lines)
            return self._patched([(close, close, joined)])
        # As the last element is indented.
        indent = document.line_head(document.root.children[-1].start) or robot_indent + b"  "
        step = b"  "
        if indent.startswith(robot_indent):
            step = indent[len(robot_indent) :]
        indented = b"".join(indent + step * depth + line for depth, line in lines)
        before = close - len(robot_indent)
        return self._patched([(before, before, indented)])

    def joined_with(
        self, elements: str, joint: str, parent: str, child: str, T_parent_child: Array
    ) -> Urdf:
        """Return the URDF with the links and joints of another robot, on a fixed joint, just before ``</robot>``.

        Args:
            elements: The links and joints, as XML.
            joint: Name of the fixed joint.
            parent: Name of the link that the other robot stands on.
            child: Root link of the other robot.
            T_parent_child: Shape (4, 4), [m], its pose in the parent.

        Raises:
            UrdfError: The result is not a URDF that can be calibrated.
        """
        document = self._document
        fixed = b"".join(
            [
                b"<joint name=" + document.quoted(joint) + b' type="fixed">',
                b"<parent link=" + document.quoted(parent) + b"/>",
                b"<child link=" + document.quoted(child) + b"/>",
                _origin_tag(T_parent_child),
                b"</joint>",
            ]
        )
        close = document.root.close
        added = elements.encode(self.encoding, "xmlcharrefreplace") + fixed
        return self._patched([(close, close, added)])

    def with_comments(self, *, run: str, verdict: str) -> Urdf:
        """Return the URDF with a run and a verdict as comments, each on a line before ``<robot>``, in place of its own.

        Args:
            run: The id of a run, which `run` reads back, see `calib.result.calibration.Calibration.run`; empty for no
                such comment.
            verdict: The verdict and its reason, which `verdict` reads back; empty for no such comment.

        Returns:
            The URDF; all other bytes are kept.
        """
        document = self._document
        wanted = b""
        for prefix, text in ((_RUN, run), (_VERDICT, verdict)):
            if text:
                wanted += document.comment(prefix + text)
        patches = [
            (comment.start, document.line_after(comment.end), b"")
            for comment in document.comments
            if comment.text.strip().startswith((_RUN, _VERDICT))
        ]
        if b"".join(self.data[start:end] for start, end, _ in patches) == wanted:
            return self
        first = document.root.start
        return self._patched([*patches, (first, first, wanted)])

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the bytes to a file, whole or not at all.

        Args:
            path: The file.
            overwrite: False to refuse a file that exists.

        Returns:
            The path.

        Raises:
            FileError: It exists and must not be overwritten, has the name of a xacro, or cannot be written.
        """
        check_urdf_name(path)
        return write_atomically(path, self.data, overwrite=overwrite)

    def _stated(self, prefix: str) -> str:
        """Return what the first comment with a prefix states after it; empty if there is none."""
        for comment in self._document.comments:
            text = comment.text.strip()
            if text.startswith(prefix):
                return text.removeprefix(prefix)
        return ""

    def _patched(self, patches: list[tuple[int, int, bytes]]) -> Urdf:
        """Return the URDF with the bytes from start to before end replaced, for every (start, end, new bytes)."""
        return Urdf.from_bytes(self._document.patched(patches), self.source, self.path)

    def _joint_index(self, name: str) -> int:
        """Return the index of a joint in `joints`; UrdfError if there is none of that name."""
        names = [joint.name for joint in self.joints]
        if name in names:
            return names.index(name)
        is_link = ": that is a link, the name of a joint is wanted" if name in self.links else ""
        raise UrdfError(
            f"{self.source} has no joint '{name}'{is_link}{did_you_mean(name, names)}. Its joints: {choices(names)}"
        )

    def _check_link(self, name: str) -> None:
        """Refuse a name that is not that of a link, by an UrdfError that lists the links."""
        if name in self.links:
            return
        child = next((joint.child for joint in self.joints if joint.name == name), None)
        hint = did_you_mean(name, self.links)
        if child is not None:
            hint = f": that is a joint, a link is wanted; the joint moves '{child}'"
        raise UrdfError(
            f"{self.source} has no link '{name}'{hint}. Its links: {choices(self.links)}"
        )


def origin_attributes(T: Array) -> dict[str, str]:
    """Return xyz and rpy of the <origin> of a pose (4, 4) [m], by their names, as text that reads back exactly."""
    # Pinocchio's rpy is accurate also at pitch = +-pi/2.
    rpy = pin.rpy.matrixToRpy(T[:3, :3])
    return {"xyz": _number_text(T[:3, 3]), "rpy": _number_text(rpy)}


def _number_text(values: Array) -> str:
    """Return numbers (k,), without signs of zero, as a text with blanks between them that reads back exactly."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def _origin_tag(T: Array) -> bytes:
    """Return the tag ``<origin xyz="..." rpy="..."/>`` of a pose (4, 4) [m]."""
    return '<origin xyz="{xyz}" rpy="{rpy}"/>'.format(**origin_attributes(T)).encode()


def urdf_of_dh(robot: DHRobot, source: str, path: Path | None = None) -> Urdf:
    """Return the URDF of a robot that DH rows describe; its links are cylinders, seen and checked for collisions.

    Args:
        robot: The robot; the joints of the URDF have the values of its joints, not coupled readings.
        source: Name of the file that has the rows, for messages.
        path: That file; None for none.
    """
    return replace(Urdf.from_bytes(dh_urdf(robot), source, path), _rows=robot)


def urdf_of_mjcf(path: Path) -> Urdf:
    """Return the URDF of a MuJoCo model, whose links are its bodies and sites; see `calib.robot.mjcf_urdf`.

    Raises:
        FileError: A file of it cannot be read.
        UrdfError: It is not a model that calib can take.
    """
    data = mjcf_urdf(Mjcf.read(path))
    try:
        return Urdf.from_bytes(data, path.name, path)
    except UrdfError as error:
        raise UrdfError(f"{error} This is about the URDF that calib makes of the model.") from error


def read_urdf(source: str | Path) -> Urdf:
    """Read the URDF of a file, of a xacro that arguments may follow, or of a robot by its name.

    A file of DH rows or a MuJoCo model (MJCF) is read as the URDF that it states. Names are those of example-robot-data
    and, for arms that it does not have, those of arms of Universal Robots, UFACTORY and Flexiv, such as ``"ur10e"`` and
    ``"xarm6"``.

    Raises:
        FileError: The file cannot be read.
        MeasurementError: It is a table of anything but DH rows, or has a fault.
        ModelError: DH rows make no robot.
        UrdfError: There is no such robot, the xacro has a fault, or it is not a URDF that can be calibrated.
    """
    if is_xacro(source):
        call = XacroCall.parse(source)
        data = flatten(call)
        try:
            return Urdf.from_bytes(data, call.name, call.path)
        except UrdfError as error:
            raise UrdfError(
                f"{str(error).rstrip('.')}. This is about the flattened text: xacro FILE ARGUMENTS > robot.urdf"
            ) from error
    path = find_urdf(source)
    if path is not None:
        if path.suffix.lower() in ENDINGS:
            return urdf_of_dh(read_dh_robot(path), path.name, path)
        data = read_bytes(path, "URDF")
        if is_mjcf(data):
            return urdf_of_mjcf(path)
        return Urdf.from_bytes(data, path.name, path)

    name = str(source)
    if name == flange.NAME:
        return Urdf.from_bytes(flange.flange_urdf(), "the poses of the flange")
    of_arm = named_arm_urdf(name)
    if of_arm is not None:
        data, arm = of_arm
        return Urdf.from_bytes(data, f"the nominal {arm}")
    known = known_robots()
    raise UrdfError(
        f"'{name}' is neither a file here nor a robot whose name calib knows{_similar(name, known)}. Give the path of "
        f"a URDF, a xacro, an MJCF or DH rows, or one of {choices(known)}."
    )


def known_robots() -> list[str]:
    """Return the names of robots that `read_urdf` takes in place of a file, sorted."""
    files = {file.removesuffix(".urdf").removesuffix("_robot") for file in robot_data_urdfs()}
    arms = {model.plain for model in MODELS} | {arm.plain for arm in ARMS}
    return sorted(files | arms | {flange.NAME})


@lru_cache(maxsize=1)
def robot_data_urdfs() -> dict[str, Path]:
    """Return the URDF files of the installed example-robot-data by name, from its list of files, which is long."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    return {file.name: Path(str(file.locate())) for file in files if file.suffix == ".urdf"}


def find_urdf(source: str | Path) -> Path | None:
    """Return the file of a path, or of the name, in any case, of a robot of example-robot-data; None if it has none.

    Whatever has an ending or a folder is taken for a path, whether or not there is such a file.
    ``<name>_robot.urdf`` comes before ``<name>.urdf``: that package's own loader returns a UR5 for ``"ur3"``.
    """
    path = Path(source)
    if path.suffix or len(path.parts) != 1 or os.path.isfile(path):  # noqa: PTH113  of any length
        return path
    urdfs = {name.casefold(): path for name, path in robot_data_urdfs().items()}
    for name in (f"{source}_robot.urdf", f"{source}.urdf"):
        if name.casefold() in urdfs:
            return urdfs[name.casefold()]
    return None


def _similar(name: str, known: list[str]) -> str:
    """Return " (similar names, ...)", the end of a message about an unknown robot; empty if no known name is similar.

    They continue the name given, or it continues them, after a separator; else they differ by few letters.
    """
    given = name.casefold()
    similar = [robot for robot in known if _continues(given, robot) or _continues(robot, given)]
    # Names with other numbers are not proposed: a ur10e is not a ur10, its first link is 53 mm longer.
    numbered = [robot for robot in known if _numbers_in(robot) == _numbers_in(given)]
    similar = similar or difflib.get_close_matches(given, numbered, n=3)
    if not similar:
        return ""
    return f" (similar names, which may be other robots: {choices(similar)})"


def _continues(longer: str, shorter: str) -> bool:
    """Return True if a name is another one, in any case, or that and more after a separator, as ``ur5-limited`` is."""
    end = longer.casefold().removeprefix(shorter.casefold())
    return end == "" or (end != longer.casefold() and not end[0].isalnum())


def _numbers_in(name: str) -> list[str]:
    """Return the numbers in a name with the letters after them, such as ``["10e"]``: robots differ by them."""
    return re.findall(r"\d+[a-z]*", name.casefold())

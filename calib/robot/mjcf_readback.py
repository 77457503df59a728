"""A corrected MJCF as MuJoCo reads it, if it is installed: bodies, joints and sites alone, without meshes.

MuJoCo is given the same files with all else left out, so that neither meshes nor plugins must be there. Settings of the
compiler, defaults, frames and includes are read by MuJoCo.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Collection
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import UrdfError
from calib.robot.mjcf import WORLD, Mjcf
from calib.robot.mjcf_elements import ORIENTATIONS
from calib.robot.mjcf_urdf import urdf_names
from calib.robot.readback import check_close
from calib.robot.robot import Robot

_POSE = ("name", "class", "pos", *ORIENTATIONS)

#: What MuJoCo is given of each element: its attributes.
_KEPT = {
    "mujoco": ("model",),
    "mujocoinclude": (),
    "include": ("file",),
    "compiler": ("angle", "eulerseq", "autolimits", "coordinate"),
    "default": ("class",),
    "worldbody": (),
    "frame": ("childclass", *_POSE),
    "body": ("childclass", "mocap", *_POSE),
    "joint": ("type", "axis", "range", "limited", "ref", *_POSE),
    "freejoint": ("name",),
    "site": ("type", "size", "fromto", *_POSE),
}

#: Bodies have no masses here, which MuJoCo does not allow for those that move.
_ANY_MASS = {"boundmass": "1", "boundinertia": "1"}


def check_by_mujoco(model: Mjcf, robot: Robot, q: Array, expected: Array) -> bool:
    """Compare a model, as MuJoCo reads and moves it, with poses of the model in memory.

    Args:
        model: The model.
        robot: A chain of it.
        q: Shape (N, m), joint readings [rad or m].
        expected: Shape (N, 4, 4), [m], T_base_tip at these.

    Returns:
        True if MuJoCo is installed and agrees; False if it is not installed.

    Raises:
        UrdfError: MuJoCo cannot read it, or has the tip elsewhere.
    """
    if importlib.util.find_spec("mujoco") is None:
        return False
    try:
        poses = poses_by_mujoco(model, robot, q)
    except ValueError as error:
        raise UrdfError(
            f"MuJoCo cannot read the corrected MJCF: {' '.join(str(error).split())}. It is not written. If MuJoCo "
            "reads the original one, please report this with the file."
        ) from error
    check_close("MuJoCo", robot.tip, poses, expected)
    return True


def poses_by_mujoco(model: Mjcf, robot: Robot, q: Array) -> Array:
    """Return T_base_tip (N, 4, 4) [m] at readings q (N, m) [rad or m] as MuJoCo reads and moves a model.

    Args:
        model: The model.
        robot: A chain of it.
        q: Shape (N, m), joint readings [rad or m].

    Raises:
        ValueError: MuJoCo cannot read it.
    """
    import mujoco

    files: dict[str, bytes] = {}
    empty: set[str] = set()  # includes of nothing, which MuJoCo refuses
    for file in reversed(model.files.files[1:]):  # each before those that include it
        kept = _kinematic_elements(file.document.data, empty)
        if len(kept):
            files[file.name] = ElementTree.tostring(kept)
        else:
            empty.add(file.name)
    main = _kinematic_elements(model.files.files[0].document.data, empty)
    main.insert(0, Element("compiler", _ANY_MASS))
    compiled = mujoco.MjModel.from_xml_string(ElementTree.tostring(main).decode(), files)
    data = mujoco.MjData(compiled)
    # MuJoCo numbers the joints as calib does, and sites by their bodies.
    names = [joint.name for body in model.bodies for joint in body.joints]
    order = [WORLD, *(body.name for body in model.bodies)]
    _, _, site_links = urdf_names(model)
    sites = sorted(model.sites, key=lambda site: order.index(site.parent))
    site_of_link = {site_links[site.name]: number for number, site in enumerate(sites)}
    values = robot.urdf_values(q)

    def pose(link: str) -> Array:
        """Return T_world_link (4, 4) [m]."""
        T = np.eye(4)
        if link in site_of_link:
            number = site_of_link[link]
            T[:3, :3] = data.site_xmat[number].reshape(3, 3)
            T[:3, 3] = data.site_xpos[number]
        else:
            number = order.index(link)
            T[:3, :3] = data.xmat[number].reshape(3, 3)
            T[:3, 3] = data.xpos[number]
        return T

    poses = np.empty((len(q), 4, 4))
    for row in range(len(q)):
        for number, name in enumerate(names):
            if name in values:
                data.qpos[compiled.jnt_qposadr[number]] = values[name][row]
        mujoco.mj_kinematics(compiled, data)
        poses[row] = rigid_inverse(pose(robot.base)) @ pose(robot.tip)
    return poses


def _kinematic_elements(data: bytes, empty: Collection[str]) -> Element:
    """Return an XML file of a model with what bears on kinematics alone, without includes of empty files."""
    root = ElementTree.fromstring(data)
    kept = Element(root.tag)
    _copy(root, kept, empty)
    return kept


def _copy(source: Element, target: Element, empty: Collection[str]) -> None:
    """Add to an element the children of another that are kept, and theirs."""
    for child in source:
        if child.tag in _KEPT and child.get("file") not in empty:
            attributes = {key: child.attrib[key] for key in _KEPT[child.tag] if key in child.attrib}
            _copy(child, SubElement(target, child.tag, attributes), empty)

"""A corrected MJCF as MuJoCo reads it, if it is installed: bodies, joints and sites alone, without meshes.

MuJoCo is given the same files with all else left out, so that neither meshes nor plugins must be there. Settings of the
compiler, defaults, frames and includes are read by MuJoCo.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
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
            f"MuJoCo cannot read the corrected MJCF: {' '.join(str(error).split())}. It is not written. If MuJoCo reads "
            "the original one, please report this with the file."
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

    files = {file.name: _kinematic_text(file.document.data) for file in model.files.files[1:]}
    main = _kinematic_text(model.files.files[0].document.data, _ANY_MASS)
    compiled = mujoco.MjModel.from_xml_string(main.decode(), files)
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


def _kinematic_text(data: bytes, compiler: Mapping[str, str] | None = None) -> bytes:
    """Return an XML file of a model with what bears on kinematics alone, and settings of the compiler in front."""
    root = ElementTree.fromstring(data)
    kept = Element(root.tag)
    if compiler:
        SubElement(kept, "compiler", dict(compiler))
    _copy(root, kept)
    return ElementTree.tostring(kept)


def _copy(source: Element, target: Element) -> None:
    """Add to an element the children of another that are kept, and theirs."""
    for child in source:
        if child.tag in _KEPT:
            attributes = {key: child.attrib[key] for key in _KEPT[child.tag] if key in child.attrib}
            _copy(child, SubElement(target, child.tag, attributes))

"""The URDF of a MuJoCo model, in which the rest of calib takes it, and what of the model it keeps in a comment.

Each body is a link, and each site. Each joint stands at the point p of its axis, turned back by its ``ref``, so that
its value is the one of MuJoCo:

    O_1 = T_parent_B Trans(p_1) J_1(-ref_1),    O_i = Trans(p_i - p_(i-1)) J_i(-ref_i)

The body follows on a fixed joint with Trans(-p_k), unless that is the identity.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.json_files import digest
from calib.basics.values import Value
from calib.robot.cylinder_urdf import GREY, origin_tag, rods
from calib.robot.mjcf import WORLD, Mjcf, MjcfBody, MjcfJoint

REMARK = "calib MJCF: "
"""Begins the comment of a URDF that says from which MJCF it was made, as JSON."""

#: The types of URDF by those of MJCF; a hinge without limits is continuous.
_TYPES = {"hinge": "revolute", "slide": "prismatic", "ball": "floating", "free": "floating"}

#: Radius of the rods that links are drawn as, over the length of the longest way from the world.
_RADIUS = 0.02

#: The rods of a smaller robot are drawn as thick as those of a robot of this length [m].
_SHORTEST = 0.1


@dataclass(frozen=True, slots=True)
class MjcfOrigin(Value):
    """The MJCF that a URDF was made from, as the URDF states it."""

    #: Name of the main file.
    file: str
    #: SHA-256 of all files of the model.
    sha256: str
    #: Joints that no chain can pass, and why.
    refused: Mapping[str, str]
    #: Bodies whose masses the geoms alone tell, so that no link has a mass.
    mass_of_geoms: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Names:
    """The joints of the URDF that carry a body or a site."""

    #: The fixed joint that carries it, if it has no joint of its own; the one that follows its joints; or None.
    fixed: str | None
    #: Its own joints.
    moving: tuple[str, ...] = ()


def urdf_names(model: Mjcf) -> tuple[dict[str, Names], dict[str, Names], dict[str, str]]:
    """Return the names that bodies, sites and their joints have in the URDF.

    Args:
        model: The model.

    Returns:
        The joints by the body's name; those by the site's name; and the link of each site, which is its name unless a
        body has that.
    """
    joints = {joint.name for body in model.bodies for joint in body.joints}
    links = {WORLD, *(body.name for body in model.bodies)}

    def free(name: str, taken: set[str]) -> str:
        """Return a name that is not taken, from now on."""
        while name in taken:
            name += "_"
        taken.add(name)
        return name

    bodies = {}
    for body in model.bodies:
        fixed = None
        if not body.joints:
            fixed = free(f"{body.name}_fixed", joints)
        elif body.joints[-1].pos.any():
            fixed = free(f"{body.name}_frame", joints)
        bodies[body.name] = Names(fixed, tuple(joint.name for joint in body.joints))
    sites, site_links = {}, {}
    for site in model.sites:
        name = f"{site.name}_site" if site.name in links else site.name
        site_links[site.name] = free(name, links)
        sites[site.name] = Names(free(f"{site.name}_fixed", joints))
    return bodies, sites, site_links


def motion(joint: MjcfJoint, value: float) -> Array:
    """Return the motion of a joint by a value [rad or m] from where it stands, in its own frame, shape (4, 4), [m]."""
    T = np.eye(4)
    if joint.type == "slide":
        T[:3, 3] = value * joint.axis
    elif joint.type == "hinge":
        T[:3, :3] = Rotation.from_rotvec(value * joint.axis).as_matrix()
    return T


def shift(vector: Array) -> Array:
    """Return the pose of a translation (3,) [m], shape (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = vector
    return T


def mjcf_urdf(model: Mjcf) -> bytes:
    """Return the URDF of a model in UTF-8.

    If the mass of one body that moves is known from its geoms alone, no link has a mass: loads of a part of the masses
    would be wrong.
    """
    bodies, sites, site_links = urdf_names(model)
    parents = {body.name: body.parent for body in model.bodies}
    moving = {WORLD: False}
    for body in model.bodies:
        moving[body.name] = bool(body.joints) or moving[parents[body.name]]
    unknown = [body.name for body in model.bodies if body.mass_of_geoms and moving[body.name]]
    remark = {
        "file": model.files.files[0].path.name,
        "sha256": digest(
            [file.document.data.decode("utf-8", "replace") for file in model.files.files]
        ),
        "refused": {
            **model.refused,
            **{str(sites[site.name].fixed): site.fault for site in model.sites if site.fault},
        },
        "mass_of_geoms": unknown,
    }
    # No comment may hold --.
    remark_json = json.dumps(remark).replace("--", "-\\u002d")
    name = model.files.root.attributes.get("model", "") or model.files.files[0].path.stem
    radius = _rod_radius(model)
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<!-- A MuJoCo model, read by calib: its rods are not the robot's shape. -->",
        f"<!-- {REMARK}{remark_json} -->",
        f"<robot name={quoteattr(name)}>",
        f"  <link name={quoteattr(WORLD)}/>",
    ]
    for body in model.bodies:
        below = [other.T_parent_own[:3, 3] for other in model.bodies if other.parent == body.name]
        lines += _body_lines(body, bodies[body.name], model, below, radius, with_mass=not unknown)
    for site in model.sites:
        link = site_links[site.name]
        fixed = sites[site.name].fixed
        lines.append(f"  <link name={quoteattr(link)}/>")
        lines += _joint_lines(str(fixed), "fixed", site.parent, link, site.T_parent_own)
    return "\n".join([*lines, "</robot>", ""]).encode()


def _body_lines(
    body: MjcfBody,
    names: Names,
    model: Mjcf,
    below: list[Array],
    radius: float,
    *,
    with_mass: bool,
) -> list[str]:
    """Return the lines of a body's link, of its joints, and of the links between them; ``below`` are its children."""
    lines = [f"  <link name={quoteattr(body.name)}>"]
    if with_mass and body.inertial is not None:
        mass, centre = body.inertial
        lines += [
            "    <inertial>",
            f"      {origin_tag(shift(centre))}",
            f'      <mass value="{mass!r}"/>',
            '      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>',
            "    </inertial>",
        ]
    for point in below:
        for rod in rods([np.zeros(3), point], radius):
            shape = f'<cylinder radius="{rod.radius:.6g}" length="{rod.length!r}"/>'
            colour = " ".join(f"{part:g}" for part in (*GREY, 1.0))
            lines += [
                f"    <visual>{origin_tag(rod.T_link_cylinder)}<geometry>{shape}</geometry>",
                f'      <material name=""><color rgba="{colour}"/></material></visual>',
            ]
    lines.append("  </link>")
    if not body.joints:
        return lines + _joint_lines(
            str(names.fixed), "fixed", body.parent, body.name, body.T_parent_own
        )
    parent, T = body.parent, body.T_parent_own
    last = body.joints[-1]
    for joint in body.joints:
        child = body.name
        if joint is not last or names.fixed is not None:
            child = f"{body.name}/{joint.name}"
            lines.append(f"  <link name={quoteattr(child)}/>")
        kind = _TYPES[joint.type]
        if kind == "revolute" and joint.limits is None:
            kind = "continuous"
        origin = T @ shift(joint.pos) @ motion(joint, -joint.ref)
        lines += _joint_lines(joint.name, kind, parent, child, origin, joint, model)
        parent, T = child, shift(-joint.pos)
    if names.fixed is not None:
        lines += _joint_lines(names.fixed, "fixed", parent, body.name, T)
    return lines


def _joint_lines(
    name: str,
    kind: str,
    parent: str,
    child: str,
    origin: Array,
    joint: MjcfJoint | None = None,
    model: Mjcf | None = None,
) -> list[str]:
    """Return the lines of a joint of a URDF; a fixed one has no joint of the model."""
    lines = [
        f'  <joint name={quoteattr(name)} type="{kind}">',
        f"    {origin_tag(origin)}",
        f"    <parent link={quoteattr(parent)}/>",
        f"    <child link={quoteattr(child)}/>",
    ]
    if joint is not None and model is not None and kind not in ("fixed", "floating"):
        axis = " ".join(repr(float(part) + 0.0) for part in joint.axis)
        lines.append(f'    <axis xyz="{axis}"/>')
        limits = ""
        if joint.limits is not None:
            limits = f'lower="{joint.limits[0]!r}" upper="{joint.limits[1]!r}" '
        if kind != "continuous":
            lines.append(f'    <limit {limits}effort="1000" velocity="3.14"/>')
        if joint.name in model.couplings:
            driver, factor, offset = model.couplings[joint.name]
            lines.append(
                f'    <mimic joint={quoteattr(driver)} multiplier="{factor!r}" offset="{offset!r}"/>'
            )
    return [*lines, "  </joint>"]


def _rod_radius(model: Mjcf) -> float:
    """Return the radius of the rods that links are drawn as [m]."""
    reach = {WORLD: 0.0}
    for body in model.bodies:
        reach[body.name] = reach[body.parent] + float(np.linalg.norm(body.T_parent_own[:3, 3]))
    return _RADIUS * max(_SHORTEST, *reach.values())

"""A robot for the Flexible Collision Library: forward kinematics and meshes share no code with what is tested."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import fcl
import numpy as np
import trimesh

from calib.data.cell import Box
from calib.robot.meshes import find_mesh, link_shapes, mesh_folders
from calib.robot.robot import Robot
from calib.show.scene.posed_robot import root_poses


@cache
def bodies(robot: Robot) -> dict[str, tuple[np.ndarray, fcl.CollisionGeometry]]:
    """For each link the pose of its shape there, and the shape as FCL has it, read by trimesh."""
    result = {}
    for shape in link_shapes(robot.urdf, "collision"):
        if shape.mesh is None:
            mesh = trimesh.creation.box(shape.sizes)
        else:
            mesh = trimesh.load(find_mesh(shape.mesh[0], mesh_folders(robot.urdf)), force="mesh")
        geometry = fcl.BVHModel()
        geometry.beginModel(len(mesh.vertices), len(mesh.faces))
        geometry.addSubModel(np.array(mesh.vertices), np.array(mesh.faces))
        geometry.endModel()
        result[shape.link] = shape.T_link_shape, geometry
    return result


def placed(geometry: fcl.CollisionGeometry, T: np.ndarray) -> fcl.CollisionObject:
    return fcl.CollisionObject(geometry, fcl.Transform(T[:3, :3], T[:3, 3]))


def objects(robot: Robot, q: np.ndarray, boxes: Iterable[Box] = ()) -> dict[str, object]:
    """The links, placed by the model of pictures, and the boxes, in the base."""
    at = root_poses(robot, q[None])
    T_base_root = np.linalg.inv(at[robot.base][0])
    found = {k: placed(body, T_base_root @ at[k][0] @ T) for k, (T, body) in bodies(robot).items()}
    return found | {box.name: placed(fcl.Box(*box.size), box.T_base_box) for box in boxes}


def touch(one: fcl.CollisionObject, other: fcl.CollisionObject) -> bool:
    return bool(fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()))

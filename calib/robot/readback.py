"""The corrected URDF, read back and compared with the model in memory.

Two readers that share no code with the writer must find in a corrected URDF what the model in memory has: Pinocchio,
which the model itself is built on, and yourdfpy. A reader that finds another robot in the URDF that was given, or none,
says nothing about the corrections: yourdfpy finds no joint in a file with a default namespace. It is asked again about
the part that states joints and masses (`calib.robot.kinematic_text`).
"""

from __future__ import annotations

import io
import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import UrdfError
from calib.robot.kinematic_text import kinematic_text
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

TOLERANCE = 1e-9  #: A pose read back may differ from the model's by this [m and rad].


def check_written(robot: Robot, expected: Array, q: Array, given: Robot) -> None:
    """Compare a robot's URDF, as Pinocchio and yourdfpy read it, with poses of the model in memory.

    Args:
        robot: The robot with the URDF that is to be written.
        expected: Shape (N, 4, 4), [m], T_base_tip by the model in memory; of several chains one after the other, all
            poses of the first one first.
        q: Shape (N, m), the joint readings of these poses, [rad] or [m], in the order of ``robot.joint_names``.
        given: The robot with the URDF that it was made from, between the same links.

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF, although it reads the URDF that
            was given as the model does.
    """
    read_again = robot.rebuilt(Urdf.from_bytes(robot.urdf.data, "the corrected URDF"))
    expected_of_chains = expected.reshape(-1, len(q), 4, 4)
    for again, chain, nominal, poses in zip(
        read_again.chains, robot.chains, given.chains, expected_of_chains, strict=True
    ):
        check_close("Pinocchio", chain.tip, again.poses(q), poses)
        _check_with_yourdfpy(chain, poses, q, nominal)


def _check_with_yourdfpy(robot: Robot, expected: Array, q: Array, given: Robot) -> None:
    """Raise `UrdfError` if yourdfpy reads a corrected chain otherwise, though it reads the given one as the model does.

    ``expected`` are T_base_tip by the model in memory at readings q (N, m), (N, 4, 4) [m].
    """
    # If it refuses the given file too, the part that states joints and masses counts.
    texts: tuple[Callable[[Urdf], str | bytes], ...] = (lambda urdf: urdf.data, kinematic_text)
    for text_of in texts:
        fault = _fault_by_yourdfpy(robot, text_of(robot.urdf), q, expected)
        if fault is None:
            return
        if _fault_by_yourdfpy(given, text_of(given.urdf), q, given.poses(q)) is None:
            raise fault


def check_close(reader: str, link: str, poses: Array, expected: Array) -> None:
    """Refuse a URDF in which a reader finds a link elsewhere than expected by more than `TOLERANCE`.

    Args:
        reader: Name of the reader, for the message.
        link: Name of the link, for the message.
        poses: Shape (N, 4, 4), [m], poses of the link by the reader.
        expected: Shape (N, 4, 4), [m], poses by the model in memory.

    Raises:
        UrdfError: They differ by more.
    """
    off = np.abs(poses - expected)
    if not off.max() <= TOLERANCE:
        raise UrdfError(
            f"The corrected URDF, read back by {reader}, has '{link}' {off[:, :3, 3].max():.2e} m and "
            f"{off[:, :3, :3].max():.2e} rad away from the model in memory; {TOLERANCE:g} is allowed. It is not "
            "written. Please report this with the URDF."
        )


def _fault_by_yourdfpy(
    robot: Robot, text: str | bytes, q: Array, expected: Array
) -> UrdfError | None:
    """Return what is wrong with a text of a robot's URDF, by yourdfpy's poses at readings q (N, m); None if nothing is.

    ``expected`` are T_base_tip by the model in memory, (N, 4, 4) [m].
    """
    try:
        check_close("yourdfpy", robot.tip, _poses_by_yourdfpy(robot, text, q), expected)
    except UrdfError as error:
        return error
    return None


def _poses_by_yourdfpy(robot: Robot, text: str | bytes, q: Array) -> Array:
    """Return T_base_tip at readings q (N, m) [rad or m] as yourdfpy computes it from a text, (N, 4, 4) [m].

    UrdfError if yourdfpy cannot read the text, or finds no such joints and links.
    """
    model = yourdfpy_model(text, robot.name)
    try:
        # yourdfpy slides by q times the axis as it is written, which may have any length.
        lengths = np.ones(len(robot.joints))
        for i, joint in enumerate(robot.joints):
            if joint.type == "prismatic":
                lengths[i] = np.linalg.norm(model.joint_map[joint.name].axis)
        values = robot.chain_values(q) / lengths
        poses = np.empty((len(values), 4, 4))
        for i, row in enumerate(values):
            by_name = {joint.name: value for joint, value in zip(robot.joints, row, strict=True)}
            model.update_cfg(by_name)
            T_root_base = model.get_transform(robot.base)
            T_root_tip = model.get_transform(robot.tip)
            poses[i] = rigid_inverse(T_root_base) @ T_root_tip
    # Whatever a foreign reader raises about what it did not find.
    except Exception as error:
        raise UrdfError(
            f"yourdfpy does not find the joints and links of the corrected URDF of '{robot.name}', so it is not "
            f"written: {error!r}"
        ) from error
    return poses


def yourdfpy_model(text: str | bytes, name: str) -> Any:  # noqa: ANN401  yourdfpy has no types
    """Return yourdfpy's model of a URDF, in which no joint mimics another.

    Args:
        text: The URDF.
        name: The robot's name, for messages.

    Raises:
        UrdfError: yourdfpy cannot read it.
    """
    import yourdfpy

    data = text if isinstance(text, bytes) else text.encode()
    logger = logging.getLogger("yourdfpy.urdf")
    logger.disabled = True  # because it warns about other parts of the robot, such as mimic joints
    try:
        parsed = yourdfpy.URDF.load(
            io.BytesIO(data),
            build_scene_graph=False,
            load_meshes=False,
            load_collision_meshes=False,
        ).robot
        # Every joint of the chain is given its value, which yourdfpy does not accept for one that mimics another.
        for joint in parsed.joints:
            joint.mimic = None
        return yourdfpy.URDF(parsed, load_meshes=False, load_collision_meshes=False)
    # Whatever a foreign reader raises: a file that it cannot read must not be written.
    except Exception as error:
        raise UrdfError(
            f"yourdfpy cannot read the corrected URDF of '{name}', so it is not written: {error}"
        ) from error
    finally:
        logger.disabled = False

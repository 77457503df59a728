"""The table of images to take: a CSV file, a row for each image, with the file name to save it under.

With the images beside it, `calib detect` finds in it which joint values belong to which.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.tables import Table
from calib.data.columns import EXPECTED, name_columns
from calib.verbs.plan.plan import Plan
from calib.verbs.plan.plan_file import joint_cells

#: A whole number in the name of an image.
_NUMBER = re.compile(r"\d+")


def image_name(number: int) -> str:
    """Return the file name of an image by its number."""
    return f"image_{number:03d}.png"


def distances_and_tilts(plan: Plan) -> tuple[Array, Array]:
    """Return how far the board is expected from the camera, and how much tilted, at each pose.

    Args:
        plan: A plan of K images.

    Returns:
        Distance of the board's centre [m], and angle between the line of sight and its normal [rad], shape (K,) each.
    """
    assert plan.sight is not None
    T_camera_board = plan.sight.board_poses(plan.robot, plan.joints)
    return plan.sight.distances(T_camera_board), plan.sight.tilts(T_camera_board)


def write_image_plan(
    plan: Plan, path: str | Path, *, overwrite: bool = False, first_row: int = 1
) -> Path:
    """Write a plan of images as a CSV table, degrees and millimetres, in the order to drive.

    Args:
        plan: The plan.
        path: The file.
        overwrite: Whether an existing file is replaced.
        first_row: Number of the first image.

    Returns:
        The path of the file.

    Raises:
        FileError: It cannot be written.
    """
    rows = list(_rows(plan, first_row))
    table = [list(rows[0]), *(row.values() for row in rows)]
    return write_atomically(path, csv_bytes(table), overwrite=overwrite)


def next_number(path: str | Path) -> int:
    """Return the number of the next image behind those of a table: one more than the largest in their names.

    Args:
        path: A table with a column ``image``, such as a plan of images or a table of corners; without one, 1.

    Raises:
        FileError: It cannot be read.
    """
    table = Table.read(path)
    named, _ = name_columns(table, (), {})
    if "image" not in named:
        return 1
    numbers = [0]
    for name in table.column(named["image"]):
        digits = _NUMBER.findall(Path(name).stem)
        if digits:
            numbers.append(int(digits[-1]))
    return max(numbers) + 1


def _rows(plan: Plan, first_row: int) -> Iterator[dict[str, str]]:
    """Yield the cells of each row by the headers of their columns, in the order to drive.

    There is no column of row numbers: a table of corners has many rows of an image.
    """
    distances, tilts = distances_and_tilts(plan)
    # A table is read from the foot of the robot to its hand, also where the chain leads the other way.
    backwards = plan.robot.base_moves
    for k, q in enumerate(plan.joints):
        number = first_row + k
        row = {"set": plan.sets[k], "image": image_name(number)}
        joints = list(joint_cells(plan.robot, q).items())
        row |= dict(joints[::-1] if backwards else joints)
        row[f"{EXPECTED}distance [mm]"] = f"{1e3 * distances[k]:.1f}"
        row[f"{EXPECTED}tilt [deg]"] = f"{math.degrees(tilts[k]):.1f}"
        yield row


def coverage(plan: Plan, columns: int = 8, rows: int = 6) -> float:
    """Return the share of the image's cells in which at least one corner is expected.

    Args:
        plan: A plan of images.
        columns: Cells along the image's width.
        rows: Cells along its height.
    """
    sight = plan.sight
    assert sight is not None
    T_camera_board = sight.board_poses(plan.robot, plan.joints)
    u, v = sight.corner_pixels(T_camera_board)
    inside = np.isfinite(u)
    column = np.floor((u[inside] + 0.5) / sight.camera.width * columns)
    row = np.floor((v[inside] + 0.5) / sight.camera.height * rows)
    return len(np.unique(row * columns + column)) / (columns * rows)

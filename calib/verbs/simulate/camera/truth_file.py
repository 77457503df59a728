"""The truth of simulated pictures as JSON in SI units: robot, camera, print, mounts, and the board in each picture.

Errors of camera and print are named as a fit names its estimates of them: what is to be added to what is stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from calib.basics.files import write_atomically
from calib.basics.json_files import json_bytes
from calib.boards.printed import Print
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.verbs.simulate.camera.cell import CameraCell
from calib.verbs.simulate.camera.pictures import Pictures
from calib.verbs.simulate.truth_file import SCHEMA, pose_table, truth_table


def write_camera_truth(pictures: Pictures, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the truth of simulated pictures.

    Args:
        pictures: The pictures, with the cell that they were taken in.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: It cannot be written.
    """
    cell = pictures.cell
    scenario = cell.scenario
    table = truth_table(cell.truth)
    table["parameters"] += list(_image_errors(cell))
    content = {
        "schema": SCHEMA,
        "seed": pictures.seed,
        **table,
        "cameras": [_camera_table(cell.camera, cell.stated)],
        "boards": [_board_table(cell.printed)],
        "instrument": {
            "kind": "pixel",
            "sigma": {"px": pictures.sigma},
            "repeatability_m": 0.0 if scenario.noise is None else scenario.noise.repeatability,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
        },
        "events": {"outliers": list(_outliers(pictures))},
        "pictures": list(_pictures(pictures)),
    }
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def _image_errors(cell: CameraCell) -> Iterator[dict[str, Any]]:
    """Yield the errors of the camera's numbers and of the print: truth less what is stated, by name."""
    lens = LENSES[cell.camera.lens]
    true, stated = cell.camera.values, cell.stated.values
    if true is not None and stated is not None:
        for name, unit, error in zip(lens.names, lens.units, true - stated, strict=True):
            yield {"name": name, "unit": unit, "value": float(error)}
    printed = cell.printed
    for axis, scale, sag in zip("xy", printed.scale, printed.warp, strict=True):
        yield {"name": f"board_scale_{axis}", "unit": "1", "value": scale - 1.0}
        yield {"name": f"board_sag_{axis}", "unit": "m", "value": sag}
    if printed.offsets is not None:
        for corner, offset in enumerate(printed.offsets.tolist()):
            for axis, value in zip("xy", offset, strict=False):
                yield {"name": f"corner_{corner}_{axis}", "unit": "m", "value": value}


def _camera_table(camera: Camera, stated: Camera) -> dict[str, Any]:
    """Return the numbers of a camera as they are, and as they are stated."""
    names = LENSES[camera.lens].names
    assert camera.values is not None
    true = dict(zip(names, camera.values.tolist(), strict=True))
    said = None
    if stated.values is not None:
        said = dict(zip(names, stated.values.tolist(), strict=True))
    return {
        "camera": camera.name,
        "width_px": camera.width,
        "height_px": camera.height,
        "lens": camera.lens,
        "values": true,
        "said_values": said,
    }


def _board_table(printed: Print) -> dict[str, Any]:
    """Return a board as it is described, and its corners as they are."""
    board = printed.board
    return {
        "board": board.name,
        "pattern": board.pattern,
        "columns": board.columns,
        "rows": board.rows,
        "said_square_m": board.square,
        "scale": printed.scale,
        "sag_m": printed.warp,
        "corners_m": printed.corners,
    }


def _outliers(pictures: Pictures) -> Iterator[dict[str, Any]]:
    """Yield row number and displacement of each outlier."""
    for row in pictures.outlier_rows:
        yield {"row": row, "displacement_px": pictures.outliers[row - 1]}


def _pictures(pictures: Pictures) -> Iterator[dict[str, Any]]:
    """Yield the truth of each picture."""
    rows = zip(pictures.images, pictures.sets, pictures.q, pictures.T_camera_board, strict=True)
    for k, (image, name, q, T) in enumerate(rows):
        is_here = pictures.picture == k
        yield {
            "image": image,
            "set": name,
            "joints": q,
            **pose_table(T, "camera_board_"),
            "corners": pictures.corner[is_here],
            "pixels": pictures.true_pixels[is_here],
        }

"""Simulated pictures as `calib simulate` prints them: robot, camera, print and mounts as they really are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.basics.arrays import rigid_inverse
from calib.camera.lenses import LENSES
from calib.numerics.errors import rms
from calib.show.lines import fill, plural, row_ranges
from calib.show.tables import labelled
from calib.verbs.simulate.camera.pictures import OUTLIER, Pictures
from calib.verbs.simulate.camera.scene import view
from calib.verbs.simulate.text import encoder_steps, error_lines, point_mm

#: Columns from a label to its text.
_LABEL = 26


def simulated_pictures_text(pictures: Pictures) -> str:
    """Write what was simulated.

    Args:
        pictures: The pictures, with the cell in which they were taken.

    Returns:
        Pictures and corners, errors of the robot, of the camera and of the print, where both are mounted, and noise, in
        lines of 100 columns.
    """
    robot = pictures.cell.truth.nominal
    title = (
        f"Simulated: robot '{robot.name}', camera on {robot.base}, board on {robot.tip}, "
        f"{_counts(pictures)}."
    )
    labels_and_texts = [
        *_sights(pictures),
        *error_lines(pictures.cell.truth, pictures.q),
        *_camera(pictures),
        *_board(pictures),
        *_disturbances(pictures),
    ]
    lines = [fill(title), ""]
    for label, text in labels_and_texts:
        if text:
            lines.append(labelled(label, text, _LABEL))
    return "\n".join(lines)


def _counts(pictures: Pictures) -> str:
    """Word the number of pictures and of corners."""
    text = f"{plural(len(pictures.picture), 'corner')} in {plural(len(pictures.images), 'picture')}"
    validation = sum(name != "estimate" for name in pictures.sets)
    if validation:
        estimation = len(pictures.images) - validation
        text += f" ({estimation} for estimation, {validation} for validation)"
    return text


def _sights(pictures: Pictures) -> Iterator[tuple[str, str]]:
    """Yield label and text of what the pictures show."""
    corners = len(pictures.cell.printed.corners)
    fewest = np.bincount(pictures.picture, minlength=len(pictures.images)).min()
    _, tilt, fill_share = view(pictures.cell.scene, pictures.T_camera_board)
    seen = np.unique(pictures.picture)
    tilts = np.rad2deg(tilt[seen])
    fills = 100.0 * fill_share[seen]
    yield "Corners in a picture", f"{fewest} to {corners} of {corners}"
    yield (
        "Board in the pictures",
        (
            f"tilted by {tilts.min():.0f} to {tilts.max():.0f} deg, spans {fills.min():.0f} to "
            f"{fills.max():.0f} % of the image"
        ),
    )


def _camera(pictures: Pictures) -> Iterator[tuple[str, str]]:
    """Yield label and text of the camera's true numbers and of its mount."""
    cell = pictures.cell
    camera = cell.camera
    assert camera.values is not None
    names = LENSES[camera.lens].names
    size = f"{camera.width} x {camera.height} px, {camera.lens}"
    yield "Camera", f"{size}; true {_numbers(names, camera.values.tolist())}"
    stated = "nothing but the size"
    if cell.stated.values is not None:
        stated = _numbers(names, cell.stated.values.tolist())
    yield "  stated", stated
    T_base_camera = rigid_inverse(cell.truth.T_frame_base[0])
    yield "  mounted", f"at {point_mm(T_base_camera[:3, 3])} mm in {cell.truth.nominal.base}"


def _numbers(names: tuple[str, ...], values: list[float]) -> str:
    """Word a lens's numbers with six significant digits."""
    return ", ".join(f"{name} {value:.6g}" for name, value in zip(names, values, strict=True))


def _board(pictures: Pictures) -> Iterator[tuple[str, str]]:
    """Yield label and text of the board as printed and of its mount."""
    cell = pictures.cell
    printed, board = cell.printed, cell.printed.board
    pattern = f"{board.pattern} of {board.columns} x {board.rows}, {1e3 * board.square:g} mm"
    scale_x, scale_y = (100.0 * (scale - 1.0) for scale in printed.scale)
    sag_x, sag_y = (1e3 * sag for sag in printed.warp)
    text = (
        f"{pattern}; printed {scale_x:+.2f} % wide and {scale_y:+.2f} % high, sags by {sag_x:.2f} mm along x and "
        f"{sag_y:.2f} mm along y"
    )
    if printed.offsets is not None:
        text += f", corners {1e6 * rms(printed.offsets[:, :2].ravel()):.0f} um rms off"
    yield "Board", text
    middle = cell.truth.T_tip_target[0] @ np.append(board.centre, 1.0)
    yield "  mounted", f"its middle at {point_mm(middle[:3])} mm in {cell.truth.nominal.tip}"


def _disturbances(pictures: Pictures) -> Iterator[tuple[str, str]]:
    """Yield label and text of noise, repeatability, encoder steps and outliers; the text is empty without one."""
    scenario = pictures.cell.scenario
    yield "Noise of a corner", f"{pictures.sigma:g} px along u and along v, in a table (-o)"
    if scenario.noise is not None and scenario.noise.repeatability:
        yield "Repeatability", f"{1e6 * scenario.noise.repeatability:g} um per coordinate"
    yield "Encoder steps", encoder_steps(scenario)
    if pictures.outlier_rows:
        yield f"Outliers of {OUTLIER:g} px", f"rows {row_ranges(pictures.outlier_rows)}"

"""Pictures of a calibration: which pose of its data is shown, and where the page goes."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

import numpy as np

from calib.identify.calibration import Calibration
from calib.model.robot import rigid_inverse
from calib.show.scene import View, write_view


def view_of(calibration: Calibration) -> View:
    """The view of a calibration at one pose of its data.

    The pose is the one where the nominal robot is furthest off, of the validation rows if there are any, outliers
    aside.
    """
    c, m = calibration, calibration.measurements
    good = c.scores <= c.flag_limit
    chosen = m.validation & good if np.any(m.validation & good) else good
    chosen = chosen if np.any(chosen) else np.ones(len(m), dtype=bool)
    error = np.where(chosen, np.linalg.norm(c.residual_nominal, axis=1), -1.0)
    index = int(np.argmax(error))
    T_base_frame = rigid_inverse(c.T_frame_base)
    measured = m.points @ T_base_frame[:3, :3].T + T_base_frame[:3, 3]
    target = c.nominal_cell.target
    T_frame_nominal = c.nominal_cell.T_frame_base
    assert target is not None  # registration leaves out neither
    assert T_frame_nominal is not None
    word = "validation" if m.validation[index] else "estimation"
    return View(
        nominal=c.nominal,
        calibrated=c.robot,
        q=m.joints_for(c.nominal.joint_names)[index],
        nominal_target=target,
        calibrated_target=c.target,
        measured=measured,
        index=index,
        pose_name=f"row {m.rows[index]} ({word})",
        title=f"{c.nominal.name}: nominal and calibrated",
        # Its error in the picture is then that of the tables, not where each of the two finds the tracker.
        T_base_nominal=T_base_frame @ T_frame_nominal,
    )


def write_page(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a self-contained page that shows both robots.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_view(view_of(calibration), path, overwrite=overwrite)


def show(calibration: Calibration) -> Path:
    """Open the picture of a calibration in the browser.

    Returns:
        The page, in a temporary folder of its own.
    """
    page = write_page(calibration, Path(tempfile.mkdtemp(prefix="calib-")) / "view.html")
    webbrowser.open(page.as_uri())
    return page

"""Pictures of a calibration: which pose of its data is shown, and where the page goes."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.identify.calibration import Calibration
from calib.model.robot import rigid_inverse
from calib.show.scene import View, write_view


def view_of(calibration: Calibration) -> View:
    """The view of a calibration at one pose of its data.

    The pose is the one where the nominal robot is furthest off, of the validation rows if there are any, outliers
    aside.
    """
    c, m = calibration, calibration.measurements
    places, seen = _measured_places(c)
    # Distances and planes tell no position: then the two robots stand there without a measured point.
    shown = seen if np.any(seen) else np.any(c.used, axis=1)
    good = (c.scores <= c.flag_limit) & shown
    chosen = m.validation & good if np.any(m.validation & good) else good
    chosen = chosen if np.any(chosen) else shown
    error = np.where(chosen, np.linalg.norm(c.residual_nominal[:, :3], axis=1), -1.0)
    row = int(np.argmax(error))
    target, group = m.targets[row], m.groups[row]
    t, f = c.setup.targets.index(target), c.setup.groups.index(group)
    T_base_frame = rigid_inverse(c.setup.T_frame_base[f])
    word = "validation" if m.validation[row] else "estimation"
    return View(
        nominal=c.nominal,
        calibrated=c.robot,
        q=m.joints_for(c.nominal.joint_names)[row],
        nominal_target=c.nominal_setup.T_tip_target[t, :3, 3],
        calibrated_target=c.setup.T_tip_target[t, :3, 3],
        measured=places[seen],
        index=int(np.sum(seen[:row])) if seen[row] else None,
        pose_name=f"row {m.rows[row]} ({word})",
        title=f"{c.nominal.name}: nominal and calibrated",
        # Its error in the picture is then that of the tables, not where each of the two finds the tracker.
        T_base_nominal=T_base_frame @ c.nominal_setup.T_frame_base[f],
    )


def _measured_places(c: Calibration) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where the target was seen, in the base, shape (N, 3), [m], and for which rows that is known, shape (N,).

    A target in a socket was where its set-up's frame stands.
    """
    m = c.measurements
    frame = np.array([c.setup.groups.index(group) for group in m.groups])
    into_base = np.array([rigid_inverse(T) for T in c.setup.T_frame_base])[frame]
    points = np.nan_to_num(m.points)
    places = np.einsum("nij,nj->ni", into_base[:, :3, :3], points) + into_base[:, :3, 3]
    return places, m.of_kind("point", "pose", "fixed")


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

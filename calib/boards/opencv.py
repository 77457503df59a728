"""OpenCV, which is imported only where a board is drawn or a picture is read."""

from __future__ import annotations

import importlib
from typing import Any

from calib.errors import CalibError


def opencv() -> Any:  # noqa: ANN401  a module without types
    """Import OpenCV.

    Returns:
        The module ``cv2``, with ``cv2.aruco``.

    Raises:
        CalibError: It is not installed, or its version has no ArUco boards.
    """
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError as error:
        raise CalibError(
            "Boards are drawn and found with OpenCV, which is not installed: pip install 'robot-calib[camera]'"
        ) from error
    if not hasattr(cv2, "aruco") or not hasattr(cv2.aruco, "CharucoDetector"):
        raise CalibError(
            f"OpenCV {cv2.__version__} is too old to find boards; 4.8 or newer does: "
            "pip install --upgrade opencv-python-headless"
        )
    return cv2
